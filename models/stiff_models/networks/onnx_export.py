"""Fitted networks as ONNX files: the whole prediction, in the units of `predict`.

Inputs `q` (n, n_joints), rad or m, and `wrench` (n, 6), N and N m at the TCP, base frame, both
float64 ("double"); output `deflection` (n, 3), m, base frame, float64; n is free. Encoding,
standardisation and physics are inside the graph, in float64; networks run in float32, as here.
"""

from __future__ import annotations

import copy
import logging
import warnings
from collections.abc import Iterator
from contextlib import contextmanager
from importlib.metadata import version
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from stiff_models.io.saved import key_of
from stiff_protocols.contract.errors import ConfigError, ModelError, NotFittedError
from stiff_protocols.contract.extras import require
from stiff_protocols.contract.files import written_whole

if TYPE_CHECKING:
    import torch

    from stiff_models.base import FittedModel

_CHECKED_ROWS = 8
_UNITS = "q: rad (m of prismatic joints); wrench: N, N m at the TCP; deflection: m; base frame"


def export_onnx(model: FittedModel, path: Path) -> None:
    """Write the prediction of a fitted network as an ONNX file, whole or not at all.

    A file that exists is replaced.

    Raises:
        ConfigError: the family holds no network, or a package of `stiffbench[onnx]` is missing.
        ModelError: the family's module is not what it predicts.
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
    _compare(module, model)
    _write(module, model, path)


def _compare(module: torch.nn.Module, model: FittedModel) -> None:
    """See that the module leaves nothing out of `predict`."""
    import torch

    chance = np.random.default_rng(0)
    robot, shape = model.robot_, (_CHECKED_ROWS, model.robot_.n_joints)
    q = chance.uniform(np.maximum(robot.lower, -np.pi), np.minimum(robot.upper, np.pi), shape)
    wrench = chance.normal(scale=50.0, size=(_CHECKED_ROWS, 6))
    with torch.no_grad():
        exported = module(torch.from_numpy(q), torch.from_numpy(wrench)).numpy()
    expected = model.predict(q, wrench)
    if not np.allclose(exported, expected, rtol=1e-3, atol=1e-6):
        raise ModelError(
            f"{type(model).__name__}: the torch module that would be written predicts something "
            f"else, by up to {np.abs(exported - expected).max():.2g} m"
        )


def _write(module: torch.nn.Module, model: FittedModel, path: Path) -> None:
    import torch

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
