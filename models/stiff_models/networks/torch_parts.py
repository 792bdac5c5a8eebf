"""The parts of a prediction as torch modules: what a family puts together for export.

Each maps float64 `q` (n, n_joints), rad or m, and `wrench` (n, 6), N and N m, to float64 (n, 3) m,
base frame. A family returns one from `_torch_module()`; a third party may read them as a recipe.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence

import torch

from stiff_models.networks.features import AngleEncoding, Scaler
from stiff_models.physics.chain import Chain, Component
from stiff_protocols.contract.types import FloatArray, Robot


class TorchJacobian(torch.nn.Module):
    """Geometric Jacobian at the TCP, base frame, differentiable, in the dtype of its input."""

    def __init__(self, robot: Robot) -> None:
        """Take the constants of `robot`."""
        super().__init__()
        self.chain = Chain.of(robot, _cos_sin)

    def forward(self, q: torch.Tensor) -> torch.Tensor:
        """Return (n, 6, n_joints): rows 0..2 translation [m/rad or m/m], rows 3..5 rotation."""
        return _stacked(self.chain.jacobian(q.unbind(dim=1)), q).reshape(-1, 6, q.shape[1])


def _cos_sin(angle: torch.Tensor) -> tuple[torch.Tensor, torch.Tensor]:
    return torch.cos(angle), torch.sin(angle)


def _stacked(components: Sequence[Component], q: torch.Tensor) -> torch.Tensor:
    """Return components, of which some may be plain numbers, as (n, n_components)."""
    # a sum, not `expand`: a stride of zero makes torch.export take n for a constant
    zero = torch.zeros_like(q[:, 0])
    return torch.stack([zero + component for component in components], dim=1)


class EncodedNetwork(torch.nn.Module):
    """A network with `stiff_models.networks.features.encode` and the two scalers around it.

    Features are computed in float64 and the network, (n, n_features) -> (n, k), runs in float32,
    as in `predict`; the output has the unit of `output_scaler`.
    """

    mean: torch.Tensor
    scale: torch.Tensor
    output_mean: torch.Tensor
    output_scale: torch.Tensor

    def __init__(
        self,
        robot: Robot,
        network: torch.nn.Module,
        *,
        angle_encoding: AngleEncoding,
        input_scaler: Scaler,
        output_scaler: Scaler,
    ) -> None:
        """Store the parts."""
        super().__init__()
        self.network = network
        self.raw = angle_encoding == "raw"
        self.turning = robot.turns.nonzero()[0].tolist()
        self.sliding = (~robot.turns).nonzero()[0].tolist()
        for name, values in (
            ("mean", input_scaler.mean),
            ("scale", input_scaler.scale),
            ("output_mean", output_scaler.mean),
            ("output_scale", output_scaler.scale),
        ):
            self.register_buffer(name, torch.tensor(values, dtype=torch.float64))

    def forward(self, q: torch.Tensor, wrench: torch.Tensor) -> torch.Tensor:
        """Return the (n, k) output."""
        features = (self._encoded(q, wrench) - self.mean) / self.scale
        output: torch.Tensor = self.network(features.to(torch.float32))
        return output.to(torch.float64) * self.output_scale + self.output_mean

    def _encoded(self, q: torch.Tensor, wrench: torch.Tensor) -> torch.Tensor:
        if self.raw:
            return torch.cat([q, wrench], dim=1)
        angles = q[:, self.turning]
        parts = [torch.sin(angles), torch.cos(angles)]
        if self.sliding:
            parts.append(q[:, self.sliding])
        return torch.cat([*parts, wrench], dim=1)


class VjmModule(torch.nn.Module):
    """Linear joint springs: ``d = J_v diag(c) J^T w``, the virtual joint model."""

    def __init__(self, robot: Robot, compliance: FloatArray) -> None:
        """Take the constants of `robot` and `compliance` (n_joints,), rad/(N m) or m/N."""
        super().__init__()
        self.chain = Chain.of(robot, _cos_sin)
        self.compliance: list[float] = compliance.tolist()

    def forward(self, q: torch.Tensor, wrench: torch.Tensor) -> torch.Tensor:
        """Return the deflection."""
        components = q.unbind(dim=1), wrench.unbind(dim=1)
        return _stacked(self.chain.deflection(*components, self.compliance), q)


class SumOf(torch.nn.Module):
    """The sum of what its parts predict: physics and a learned residual."""

    def __init__(self, parts: Iterable[torch.nn.Module]) -> None:
        """Store the parts."""
        super().__init__()
        self.parts = torch.nn.ModuleList(parts)

    def forward(self, q: torch.Tensor, wrench: torch.Tensor) -> torch.Tensor:
        """Return the deflection."""
        return torch.stack([part(q, wrench) for part in self.parts]).sum(dim=0)


class MeanOf(SumOf):
    """The mean of what its parts predict: an ensemble."""

    def forward(self, q: torch.Tensor, wrench: torch.Tensor) -> torch.Tensor:
        """Return the deflection."""
        return super().forward(q, wrench) / len(self.parts)
