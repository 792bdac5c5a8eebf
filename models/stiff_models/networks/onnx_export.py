"""Predictions as torch modules, and fitted networks as ONNX files in the units of `predict`.

A module maps `q` (n, n_joints), rad or m, and `wrench` (n, 6), N and N m at the TCP, base frame,
both float64, to the deflection (n, 3), m, base frame, float64; n is free. Encoding,
standardisation and physics are inside it, in float64; networks run in float32, as in `predict`. A
family puts its module together in `_torch_module()`; a third party may read the parts as a recipe.
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
from stiff_models.networks.encoded_model import AngleEncoding, Scaler
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
    """A network with `stiff_models.networks.encoded_model.encode` and the two scalers around it.

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


class SpringsModule(torch.nn.Module):
    """Linear virtual springs at the joints, ``d = J_v diag(c) J^T w``: `vjm`, `vjm-full`."""

    compliance: torch.Tensor

    def __init__(self, robot: Robot, columns: list[int], compliance: FloatArray) -> None:
        """Take the constants of `robot`, and the springs' compliances.

        `columns` are the springs' numbers among `virtual_jacobian`'s six a joint in a row.
        """
        super().__init__()
        self.chain = Chain.of(robot, _cos_sin)
        self.columns = columns
        self.register_buffer("compliance", torch.tensor(compliance, dtype=torch.float64))

    def forward(self, q: torch.Tensor, wrench: torch.Tensor) -> torch.Tensor:
        """Return the deflection."""
        rows = _stacked(self.chain.virtual_jacobian(q.unbind(dim=1)), q)
        rows = rows.reshape(-1, 6, 6 * q.shape[1])[:, :, self.columns]
        turn = (wrench[:, None, :] @ rows)[:, 0] * self.compliance
        return _moved(rows, turn)


class SegmentsModule(torch.nn.Module):
    """Piecewise linear joint springs under gravity's preload: `vjm-multisegment`."""

    slopes: torch.Tensor
    edges: torch.Tensor
    widths: torch.Tensor

    def __init__(
        self, robot: Robot, breakpoints: FloatArray, slopes: FloatArray, *, gravity: bool
    ) -> None:
        """Take the constants of `robot`, breakpoints and slopes as of `segment_torques`."""
        super().__init__()
        self.chain = Chain.of(robot, _cos_sin)
        self.jacobian = TorchJacobian(robot)
        self.gravity = gravity
        edges = np.pad(breakpoints, ((0, 0), (1, 0)))
        widths = np.diff(edges, axis=1, append=np.inf)
        for name, values in (("slopes", slopes), ("edges", edges), ("widths", widths)):
            self.register_buffer(name, torch.tensor(values, dtype=torch.float64))

    def forward(self, q: torch.Tensor, wrench: torch.Tensor) -> torch.Tensor:
        """Return the deflection."""
        rows = self.jacobian(q)
        load = (wrench[:, None, :] @ rows)[:, 0]
        preload = torch.zeros_like(load)
        if self.gravity:
            preload = _stacked(self.chain.gravity_torque(q.unbind(dim=1)), q)
        return _moved(rows, self._turn(preload + load) - self._turn(preload))

    def _turn(self, torque: torch.Tensor) -> torch.Tensor:
        """Return the joints' turns [rad or m] under (n, n_joints) torques."""
        beyond = (torque.abs()[:, :, None] - self.edges).clamp_min(0.0)
        parts = torch.minimum(beyond, self.widths) * self.slopes
        return torch.sign(torque) * parts.sum(dim=2)


def _moved(rows: torch.Tensor, turn: torch.Tensor) -> torch.Tensor:
    """Return the (n, 3) shift of the TCP by (n, k) turns of springs with (n, 6, k) Jacobians."""
    shift: torch.Tensor = rows[:, :3] @ turn[:, :, None]
    return shift[:, :, 0]


def physics_module(fitted: FittedModel) -> torch.nn.Module:
    """Return the prediction of a fitted virtual joint model; ConfigError for other physics."""
    if isinstance(fitted, VirtualJointModel):
        own = np.arange(0, 6 * fitted.robot_.n_joints, 6) + np.where(fitted.robot_.turns, 2, 5)
        return SpringsModule(fitted.robot_, own.tolist(), fitted.springs_.compliance)
    if isinstance(fitted, FullVjm):
        columns = spring_columns(fitted.robot_, fitted.springs)
        return SpringsModule(fitted.robot_, columns, fitted.compliance_)
    if isinstance(fitted, MultiSegmentVjm):
        return SegmentsModule(
            fitted.robot_, fitted.breakpoints_, fitted.slopes_, gravity=fitted.gravity
        )
    raise ConfigError(f"{key_of(fitted)} has no ONNX form (valid: vjm, vjm-full, vjm-multisegment)")


class Difference(torch.nn.Module):
    """Change of a network's outputs by fine-tuning."""

    def __init__(self, network: torch.nn.Module, before: torch.nn.Module) -> None:
        """Store the network, and what it was before."""
        super().__init__()
        self.network, self.before = network, before

    def forward(self, inputs: torch.Tensor) -> torch.Tensor:
        """Return the difference of both networks' (n, k) outputs."""
        changed: torch.Tensor = self.network(inputs) - self.before(inputs)
        return changed


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


def export_onnx(model: FittedModel, path: Path) -> None:
    """Write the prediction of a fitted network as an ONNX file, whole or not at all.

    A file that exists is replaced.

    Raises:
        ConfigError: the family holds no network, or a package of `stiffbench[onnx]` is missing.
        NotFittedError: `fit` was not called.
        StoreError: the file cannot be written.
    """
    if not hasattr(model, "_torch_module"):
        raise ConfigError(
            f"{key_of(model)} cannot be written as ONNX: it is no network (valid: mlp, "
            "mlp-pretrained, ft-mlp, dt-cnn, adann-2r, compliance-net, deep-ensemble, residual-mlp)"
        )
    if not hasattr(model, "robot_"):
        raise NotFittedError(f"{type(model).__name__}: call fit before export_onnx")
    require("ONNX", "onnx", "onnxscript")
    module = copy.deepcopy(model._torch_module()).to("cpu").eval()
    _write(module, model, path)


def _write(module: torch.nn.Module, model: FittedModel, path: Path) -> None:
    robot = model.robot_
    rows = {0: torch.export.Dim("n")}
    example = tuple(torch.ones(3, width, dtype=torch.float64) for width in (robot.n_joints, 6))
    with _quiet_exporter():
        # a step of its own: the ONNX exporter would fall back to a fixed n without a word
        graph = torch.export.export(module, example, dynamic_shapes=(rows, rows))
        program = torch.onnx.export(
            graph,
            dynamo=True,
            verbose=False,
            input_names=["q", "wrench"],
            output_names=["deflection"],
            dynamic_shapes=(rows, rows),
        )
    assert program is not None  # only the exporter of old returns None
    program.model.metadata_props.update(
        {"made_by": f"stiffbench {version('stiffbench')}", "robot": robot.name, "units": _UNITS}
    )
    with written_whole(path) as temporary:
        program.save(temporary)


@contextmanager
def _quiet_exporter() -> Iterator[None]:
    """Keep what the exporter says of its own inside and of packages it can do without."""
    logs = [logging.getLogger(name) for name in ("torch.onnx", "onnxscript")]
    levels = [log.level for log in logs]
    for log in logs:
        log.setLevel(logging.ERROR)
    try:
        with warnings.catch_warnings():
            for category in (UserWarning, FutureWarning, DeprecationWarning):
                warnings.simplefilter("ignore", category)
            yield
    finally:
        for log, level in zip(logs, levels, strict=True):
            log.setLevel(level)
