"""Predictions as torch modules, and fitted networks as ONNX files in the units of `predict`.

A module maps `q` (n, n_joints), rad or m, and `wrench` (n, 6), N and N m at the TCP, base frame,
both float64, to the deflection (n, 3), m, base frame, float64; n is free. Encoding,
standardisation and physics are inside it, in float64; networks run in float32, as in `predict`.
Each family assembles its module in `_torch_module()`.
"""

from __future__ import annotations

import copy
import logging
import warnings
from collections.abc import Iterable, Iterator, Sequence
from contextlib import contextmanager
from importlib.metadata import version
from pathlib import Path

import numpy as np
import torch

from stiff_models.fitted_model import FittedModel
from stiff_models.io.model_file import key_of
from stiff_models.networks.encoded_model import AngleEncoding, Scaler, encoded_joints
from stiff_models.physics.full_vjm import FullVjm, spring_columns
from stiff_models.physics.multi_segment_vjm import MultiSegmentVjm
from stiff_models.physics.vjm import VirtualJointModel
from stiff_protocols.contract.errors import ConfigError, NotFittedError
from stiff_protocols.contract.extras import require
from stiff_protocols.contract.files import written_whole
from stiff_protocols.contract.types import FloatArray, Robot
from stiff_protocols.kinematics.chain_formulas import Chain, Component

_UNITS = "q: rad (m of prismatic joints); wrench: N, N m at the TCP; deflection: m; base frame"


class TorchJacobian(torch.nn.Module):
    """Geometric Jacobian at the TCP, base frame, differentiable, in the dtype of its input."""

    def __init__(self, robot: Robot, columns: list[int] | None = None) -> None:
        """Store the constants of `robot`.

        `columns` are numbers of springs among `virtual_jacobian`'s six per joint; None: the joints
        themselves.
        """
        super().__init__()
        self.chain, self.columns = Chain.of(robot, _cos_sin), columns

    def forward(self, q: torch.Tensor) -> torch.Tensor:
        """Return (n, 6, n_springs): rows 0..2 translation [m/rad or m/m], rows 3..5 rotation."""
        if self.columns is None:
            return _stacked(self.chain.jacobian(q.unbind(dim=1)), q).reshape(-1, 6, q.shape[1])
        rows = _stacked(self.chain.virtual_jacobian(q.unbind(dim=1)), q)
        return rows.reshape(-1, 6, 6 * q.shape[1])[:, :, self.columns]


def _cos_sin(angle: torch.Tensor) -> tuple[torch.Tensor, torch.Tensor]:
    return torch.cos(angle), torch.sin(angle)


def _stacked(components: Sequence[Component], q: torch.Tensor) -> torch.Tensor:
    """Return components, some of which may be plain numbers, as (n, n_components)."""
    # a sum, not `expand`: with a stride of zero, torch.export treats n as a constant
    zero = torch.zeros_like(q[:, 0])
    return torch.stack([zero + component for component in components], dim=1)


def _register(module: torch.nn.Module, **constants: FloatArray) -> None:
    """Give a module float64 buffers of these names."""
    for name, values in constants.items():
        module.register_buffer(name, torch.tensor(values, dtype=torch.float64))


class EncodedNetwork(torch.nn.Module):
    """A network with its encoding (`encoded_model.encode`) and its two scalers.

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
        angle_encoding: AngleEncoding,
        input_scaler: Scaler,
        output_scaler: Scaler,
    ) -> None:
        """Store the parts."""
        super().__init__()
        self.network = network
        turned = encoded_joints(robot, angle_encoding)
        self.turned = turned.nonzero()[0].tolist()
        self.unchanged = (~turned).nonzero()[0].tolist()
        _register(self, mean=input_scaler.mean, scale=input_scaler.scale)
        _register(self, output_mean=output_scaler.mean, output_scale=output_scaler.scale)

    def forward(self, q: torch.Tensor, wrench: torch.Tensor) -> torch.Tensor:
        """Return the (n, k) output."""
        features = (self._encoded(q, wrench) - self.mean) / self.scale
        output: torch.Tensor = self.network(features.to(torch.float32))
        return output.to(torch.float64) * self.output_scale + self.output_mean

    def _encoded(self, q: torch.Tensor, wrench: torch.Tensor) -> torch.Tensor:
        if not self.turned:
            return torch.cat([q, wrench], dim=1)
        angles = q[:, self.turned]
        parts = [torch.sin(angles), torch.cos(angles)]
        if self.unchanged:
            parts.append(q[:, self.unchanged])
        return torch.cat([*parts, wrench], dim=1)


class Springs(torch.nn.Module):
    """Base of virtual springs whose turns under a load move the TCP."""

    def __init__(self, robot: Robot, columns: list[int] | None = None) -> None:
        """Store the constants of `robot`; `columns` as in `TorchJacobian`."""
        super().__init__()
        self.jacobian = TorchJacobian(robot, columns)

    def turn(self, q: torch.Tensor, load: torch.Tensor) -> torch.Tensor:
        """Return the springs' (n, n_springs) turns [rad or m] under the load's torques."""
        raise NotImplementedError

    def forward(self, q: torch.Tensor, wrench: torch.Tensor) -> torch.Tensor:
        """Return the deflection."""
        rows = self.jacobian(q)
        turn = self.turn(q, (wrench[:, None, :] @ rows)[:, 0])
        shift: torch.Tensor = rows[:, :3] @ turn[:, :, None]
        return shift[:, :, 0]


class LinearSprings(Springs):
    """Linear virtual springs, ``d = J_v diag(c) J^T w``: `vjm`, `vjm-full`."""

    compliance: torch.Tensor

    def __init__(
        self, robot: Robot, compliance: FloatArray, columns: list[int] | None = None
    ) -> None:
        """Store the springs' compliances."""
        super().__init__(robot, columns)
        _register(self, compliance=compliance)

    def turn(self, q: torch.Tensor, load: torch.Tensor) -> torch.Tensor:
        """Return the springs' turns."""
        return load * self.compliance


class SegmentedSprings(Springs):
    """Piecewise linear joint springs under gravity's preload: `vjm-multisegment`."""

    slopes: torch.Tensor
    edges: torch.Tensor
    widths: torch.Tensor

    def __init__(self, fitted: MultiSegmentVjm) -> None:
        """Store breakpoints and slopes."""
        super().__init__(fitted.robot_)
        self.gravity = fitted.gravity
        edges = np.pad(fitted.breakpoints_, ((0, 0), (1, 0)))
        widths = np.diff(edges, axis=1, append=np.inf)
        _register(self, slopes=fitted.slopes_, edges=edges, widths=widths)

    def turn(self, q: torch.Tensor, load: torch.Tensor) -> torch.Tensor:
        """Return the joints' turns, loaded minus unloaded."""
        preload = torch.zeros_like(load)
        if self.gravity:
            preload = _stacked(self.jacobian.chain.gravity_torque(q.unbind(dim=1)), q)
        return self._phi(preload + load) - self._phi(preload)

    def _phi(self, torque: torch.Tensor) -> torch.Tensor:
        beyond = (torque.abs()[:, :, None] - self.edges).clamp_min(0.0)
        parts = torch.minimum(beyond, self.widths) * self.slopes
        return torch.sign(torque) * parts.sum(dim=2)


def physics_module(fitted: FittedModel) -> torch.nn.Module:
    """Return the prediction of a fitted virtual joint model; ConfigError for other physics."""
    if isinstance(fitted, VirtualJointModel):
        return LinearSprings(fitted.robot_, fitted.springs_.compliance)
    if isinstance(fitted, FullVjm):
        columns = spring_columns(fitted.robot_, fitted.springs)
        return LinearSprings(fitted.robot_, fitted.compliance_, columns)
    if isinstance(fitted, MultiSegmentVjm):
        return SegmentedSprings(fitted)
    raise ConfigError(f"{key_of(fitted)} has no ONNX form (valid: vjm, vjm-full, vjm-multisegment)")


class Difference(torch.nn.Module):
    """Change of a network's outputs by fine-tuning."""

    def __init__(self, network: torch.nn.Module, before: torch.nn.Module) -> None:
        """Store the network before and after fine-tuning."""
        super().__init__()
        self.network, self.before = network, before

    def forward(self, inputs: torch.Tensor) -> torch.Tensor:
        """Return the difference of both networks' (n, k) outputs."""
        changed: torch.Tensor = self.network(inputs) - self.before(inputs)
        return changed


class SumOf(torch.nn.Module):
    """The sum of its parts' predictions: physics and a learned residual."""

    def __init__(self, parts: Iterable[torch.nn.Module]) -> None:
        """Store the parts."""
        super().__init__()
        self.parts = torch.nn.ModuleList(parts)

    def forward(self, q: torch.Tensor, wrench: torch.Tensor) -> torch.Tensor:
        """Return the deflection."""
        return torch.stack([part(q, wrench) for part in self.parts]).sum(dim=0)


class MeanOf(SumOf):
    """The mean of its parts' predictions: an ensemble."""

    def forward(self, q: torch.Tensor, wrench: torch.Tensor) -> torch.Tensor:
        """Return the deflection."""
        return super().forward(q, wrench) / len(self.parts)


def export_onnx(model: FittedModel, path: Path) -> None:
    """Write the prediction of a fitted network as an ONNX file, completely or not at all.

    An existing file is replaced.

    Raises:
        ConfigError: the family has no network, or a package of `stiffbench[onnx]` is missing.
        NotFittedError: `fit` was not called.
        StoreError: the file cannot be written.
    """
    if not hasattr(model, "_torch_module"):
        raise ConfigError(
            f"{key_of(model)} cannot be written as ONNX: it is not a network (valid: mlp, "
            "mlp-pretrained, ft-mlp, dt-cnn, adann-2r, compliance-net, deep-ensemble, residual-mlp)"
        )
    if not hasattr(model, "robot_"):
        raise NotFittedError(f"{type(model).__name__}: call fit before export_onnx")
    require("ONNX", "onnx", "onnxscript")
    module = copy.deepcopy(model._torch_module()).to("cpu").eval()
    robot = model.robot_
    rows = {0: torch.export.Dim("n")}
    example = tuple(torch.ones(3, width, dtype=torch.float64) for width in (robot.n_joints, 6))
    with _quiet_exporter():
        # a separate step: the ONNX exporter would silently fall back to a fixed n
        graph = torch.export.export(module, example, dynamic_shapes=(rows, rows))
        program = torch.onnx.export(
            graph,
            dynamo=True,
            verbose=False,
            input_names=["q", "wrench"],
            output_names=["deflection"],
            dynamic_shapes=(rows, rows),
        )
    assert program is not None  # only the old exporter returns None
    program.model.metadata_props.update(
        {"made_by": f"stiffbench {version('stiffbench')}", "robot": robot.name, "units": _UNITS}
    )
    with written_whole(path) as temporary:
        program.save(temporary)


@contextmanager
def _quiet_exporter() -> Iterator[None]:
    """Suppress the exporter's messages about its internals and optional packages."""
    level = logging.root.manager.disable
    logging.disable(logging.WARNING)
    try:
        with warnings.catch_warnings(action="ignore"):
            yield
    finally:
        logging.disable(level)
