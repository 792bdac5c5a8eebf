"""What `bench fit`, `bench predict` and `bench export` do."""

from __future__ import annotations

import warnings
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

from stiff_bench.console import say
from stiff_bench.plan.request import RunPlan, loaded
from stiff_bench.run.progress import display
from stiff_bench.tables.units import counted
from stiff_datasets.measured.load_file import read_loads, write_predictions
from stiff_models import load
from stiff_models.io.saved import key_of, save
from stiff_protocols.contract.errors import ConfigError, DataError, StiffBenchError, StoreError
from stiff_protocols.contract.files import refuse_existing
from stiff_protocols.contract.interfaces import (
    ChecksRobot,
    ChoosesEpoch,
    PredictsInterval,
    ReportsDiagnostics,
)
from stiff_protocols.contract.types import frozen_array


def fit_model(plan: RunPlan) -> str:
    """Fit the model of a plan to all samples of its data set, save it, and return what was saved.

    Args:
        plan: of one model and one data set; its output is the file.

    Raises:
        ConfigError: there are several of them, or the model cannot be used here.
        DataError: the data cannot be read.
        ModelError: the model cannot be fitted, or is not one that can be saved.
        StoreError: the file cannot be written, or exists.
    """
    _check_new_file(plan.output)
    if len(plan.models) != 1:
        raise ConfigError(f"--model: {len(plan.models)} models; a file holds one model")
    (chosen,), (dataset,) = plan.models, plan.datasets
    if why := chosen.missing():
        raise ConfigError(f"{chosen.info.key!r} cannot be used here: {why}")
    model = chosen.make()
    key_of(model)  # before the work, not after it
    data = loaded(dataset)
    if isinstance(model, ChecksRobot):
        model.check_robot(data.robot)
    with _warnings_said(), display():
        model.fit(data.samples, robot=data.robot, validation=None, seed=plan.seed)
    save(model, plan.output)
    options = f", {chosen.options_text}" if chosen.options_text else ""
    lines = [
        f"{plan.output}: {chosen.info.key}{options}, fitted to all {len(data.samples)} samples of "
        f"{dataset.info.key} ({dataset.info.label}), robot {data.robot.name}, seed {plan.seed}",
        *(f"- {caveat}" for caveat in dataset.info.caveats),
        "- No sample was held out, so nothing here says how well it predicts; `bench run` does.",
    ]
    if isinstance(model, ChoosesEpoch) and model.chooses_epoch():
        lines.append("- No rows to choose an epoch by: the last one was kept.")
    if isinstance(model, ReportsDiagnostics):
        lines += [f"- {name}: {value:.4g}" for name, value in model.diagnostics_.items()]
    return "\n".join(lines)


def predict_file(model_file: Path, loads: Path, output: Path, coverage: float | None) -> str:
    """Predict the deflections of a file's rows, write them, and return how many.

    Raises:
        ConfigError: intervals are asked for and the model has none of its own.
        DataError: the model file or the loads cannot be read.
        StoreError: the output cannot be written, or exists.
    """
    _check_new_file(output)
    model = load(model_file)
    with _blamed_on(model_file):
        table = read_loads(loads, model.robot_)
    for oddity in table.oddities:
        say(f"warning: {oddity}")
    if coverage is not None and not isinstance(model, PredictsInterval):
        raise ConfigError(
            f"--coverage {coverage:g}: {key_of(model)} has no intervals of its own (those of "
            "`bench run` come from samples that were held out)"
        )
    interval = None
    with _blamed_on(model_file):
        if coverage is not None and isinstance(model, PredictsInterval):
            interval = model.predict_interval(table.q, table.wrench, coverage)
        predicted = model.predict(table.q, table.wrench)
        deflection = frozen_array(predicted, "the prediction", (len(table.q), 3))
    write_predictions(output, table, deflection, interval)
    rows = counted(len(table.q), "row")
    return f"{output}: {rows} predicted by {key_of(model)} for robot {model.robot_.name}"


def export_file(model_file: Path, output: Path) -> str:
    """Write a saved network as ONNX and return what its inputs and outputs are.

    Raises:
        ConfigError: the model is no network, or a package is missing.
        DataError: the model file cannot be read.
        StoreError: the output cannot be written, or exists.
    """
    _check_new_file(output)
    model = load(model_file)
    from stiff_models.networks.onnx_export import export_onnx

    export_onnx(model, output)
    robot = model.robot_
    return (
        f"{output}: {key_of(model)} for robot {robot.name}; inputs q (n, {robot.n_joints}) rad or "
        "m, wrench (n, 6) N and N m at the TCP; output deflection (n, 3) m; base frame, float64"
    )


def _check_new_file(path: Path) -> None:
    """See that a file can be written, before the work is done."""
    refuse_existing(path)
    if not path.parent.is_dir():
        raise StoreError(f"{path}: cannot be written: no folder {path.parent}")


@contextmanager
def _blamed_on(model_file: Path) -> Iterator[None]:
    """Make one clear error of whatever a model from a crafted file raises.

    Raises:
        DataError: it raised something; the message names the file.
    """
    try:
        yield
    except Exception as error:
        kind = "" if isinstance(error, StiffBenchError) else f"{type(error).__name__}: "
        raise DataError(f"{model_file}: its model cannot predict: {kind}{error}") from error


@contextmanager
def _warnings_said() -> Iterator[None]:
    """Say each warning once, in a line."""
    with warnings.catch_warnings(record=True) as caught:
        warnings.simplefilter("always")
        warnings.simplefilter("ignore", DeprecationWarning)
        yield
    for message in dict.fromkeys(str(warning.message) for warning in caught):
        say(f"warning: {message}")
