"""Computes one cell: fit, predict, and only then look at what was measured."""

from __future__ import annotations

import random
import sys
import time
import traceback
import warnings
from dataclasses import replace

import numpy as np

from stiff_bench.console import printing_to_stderr
from stiff_bench.plan.cells import CellTask
from stiff_bench.run.costs import MemoryMeter, latency, throughput
from stiff_models.catalog import REFERENCE_MODEL, model_info
from stiff_protocols.contract.errors import (
    ModelError,
    StiffBenchError,
    StiffBenchWarning,
    TooFewToCalibrate,
    said_by,
)
from stiff_protocols.contract.interfaces import (
    ChoosesOptions,
    KeepsCurves,
    PredictsInterval,
    ReportsDiagnostics,
    StiffnessModel,
)
from stiff_protocols.contract.record import CellResult, Cost
from stiff_protocols.contract.types import (
    Deflection,
    FloatArray,
    IntArray,
    Interval,
    Prediction,
    Samples,
)
from stiff_protocols.scoring.conformal import SplitConformal
from stiff_protocols.scoring.metrics import metric_records
from stiff_protocols.scoring.sanity import check_prediction, check_units, warn_of_rows

ROWS_FOR_UNITS = 256
"""How many training rows are predicted to see that a model predicts m: enough, and soon done."""
CURVE_POINTS = 200
"""Of a training that are stored: more than a figure's width shows."""
LONGEST_MESSAGE, MOST_WARNINGS = 2000, 100
"""Of a failure or warning, characters; and how many warnings of a cell are kept."""


def compute_cell(task: CellTask, run_id: str) -> CellResult:
    """Fit, predict and score one cell; what goes wrong in the model becomes a failed result.

    Every metric is stored, whichever a table shows; those of intervals where there are intervals.
    A model that cannot be used on this machine gives a skipped result.
    """
    _seed_global_numbers(task.cell.model_seed)
    with printing_to_stderr(), warnings.catch_warnings(record=True) as caught:
        warnings.simplefilter("always")
        warnings.simplefilter("ignore", DeprecationWarning)
        try:
            if missing := task.model.missing():
                result = unfinished(task, run_id, missing)
            else:
                result = _fit_predict_score(task, run_id)
        except StiffBenchError as error:
            result = unfinished(task, run_id, short(str(error)), type(error).__name__)
        except (Exception, SystemExit) as error:  # a plugin's costs that cell alone
            where = traceback.extract_tb(error.__traceback__)[-1]
            reason = f"{short(said_by(error))} ({where.filename}:{where.lineno})"
            result = unfinished(task, run_id, reason, type(error).__name__)
    messages = dict.fromkeys(short(str(warning.message)) for warning in caught)
    return replace(result, warnings=tuple(messages)[:MOST_WARNINGS])


def _seed_global_numbers(seed: int) -> None:
    """Give a model that draws from global random numbers the same ones wherever the cell runs."""
    random.seed(seed)
    np.random.seed(seed)  # noqa: NPY002
    if (torch := sys.modules.get("torch")) is not None:
        torch.manual_seed(seed)


def short(text: str) -> str:
    """Return a message that a model may have made megabytes long, cut to what people read."""
    return text if len(text) <= LONGEST_MESSAGE else f"{text[:LONGEST_MESSAGE]} [...]"


def unfinished(
    task: CellTask, run_id: str, reason: str, cause: str = "", log: tuple[str, ...] = ()
) -> CellResult:
    """Return the row of a cell without numbers: failed for a cause, or skipped."""
    return CellResult(
        cell=task.cell,
        shown=task.shown,
        run_id=run_id,
        status="failed" if cause else "skipped",
        failure=reason,
        n_splits=task.n_splits,
        cause=cause,
        log=log,
    )


def _fit_predict_score(task: CellTask, run_id: str) -> CellResult:
    """Fit and predict, and only then look at what was measured at the reported rows."""
    train, validation = _training_side(task, chooses_epoch=task.chooses_epoch)
    reported = task.split.reported
    q, wrench = task.data.samples.q[reported], task.split.told_wrench(task.data.samples)
    model = task.make()
    memory = MemoryMeter()
    start = time.perf_counter()
    model.fit(train, robot=task.data.robot, validation=validation, seed=task.cell.model_seed)
    fitted = time.perf_counter()
    predicted = np.asarray(model.predict(q, wrench))
    predict_s = time.perf_counter() - fitted
    memory_bytes = memory.rise()
    check_prediction(predicted, len(q))
    _check_units(model, train)
    warn_of_rows(train)
    diagnostics = model.diagnostics_ if isinstance(model, ReportsDiagnostics) else {}
    diagnostics = {str(name): float(value) for name, value in diagnostics.items()}
    chosen = model.best_params_ if isinstance(model, ChoosesOptions) else {}
    intervals = _interval_source(task, model, train, validation)
    asked = q
    if task.paths is not None:
        asked = task.paths.commanded(_checked(model), task.data, reported)
    interval = None
    if intervals is not None and task.cell.coverage is not None:
        interval = intervals.predict_interval(asked, wrench, task.cell.coverage)
        if not isinstance(interval, Interval):
            wrong = type(interval).__name__
            raise ModelError(f"predict_interval returned {wrong}, expected Interval")
        if task.paths is not None:
            predicted = np.asarray(model.predict(asked, wrench))
    cost = Cost(  # measured last: how often it asks the model depends on the machine's speed
        fit_s=fitted - start,
        predict_s=predict_s,
        latency_s=latency(model, q, wrench),
        throughput_per_s=throughput(model, q, wrench, predict_s),
        memory_bytes=memory_bytes,
    )
    curves = model.curves_ if isinstance(model, KeepsCurves) else {}
    reference = _reference(task, q, wrench)
    measured = task.data.samples.deflection[reported]
    if task.paths is not None:
        # what was predicted, less the change of the deflection from the path to the command
        removed = task.paths.removed(asked, task.data, reported)
        if interval is not None:
            shift = removed - predicted
            interval = Interval(interval.lower + shift, interval.upper + shift, interval.coverage)
        predicted = removed
    known = _known(task, wrench)
    prediction = Prediction(reported, predicted, measured, interval, reference, known)
    n_calibrated = len(intervals.residuals_) if isinstance(intervals, SplitConformal) else 0
    of_training = _training_rows(task)
    return CellResult(
        cell=task.cell,
        shown=task.shown,
        run_id=run_id,
        status="ok",
        records=metric_records(prediction, cost),
        prediction=prediction,
        cost=cost,
        calibration_samples=n_calibrated,
        diagnostics=diagnostics,
        n_train=len(of_training),
        n_labels=len(train),
        n_poses=len(np.unique(task.data.samples.pose_id[of_training])),
        n_splits=task.n_splits,
        chosen={name: str(value) for name, value in chosen.items()},
        curves={str(name): _thinned(name, curve) for name, curve in curves.items()},
    )


def _checked(model: StiffnessModel) -> Deflection:
    """Return a model's predictions, each seen to be (n, 3) finite numbers."""

    def predict(q: FloatArray, wrench: FloatArray) -> FloatArray:
        predicted = np.asarray(model.predict(q, wrench))
        check_prediction(predicted, len(q))
        return predicted

    return predict


def _thinned(name: str, curve: FloatArray) -> FloatArray:
    """Return a curve of at most `CURVE_POINTS` points, first and last among them."""
    try:
        points = np.asarray(curve, dtype=np.float64)
    except (TypeError, ValueError):
        points = np.empty(0)
    if points.ndim != 2 or points.shape[1] != 3:
        raise ModelError(f"curves_[{name!r}] is no (n, 3) array of step, loss, validation loss")
    return points[_spread_rows(len(points), CURVE_POINTS)]


def _reference(task: CellTask, q: FloatArray, wrench: FloatArray) -> FloatArray | None:
    """Return what the reference model predicts that learned from the whole training side.

    Of tool paths, how much of the error its commands remove. It takes a millisecond; None where
    these data do not identify it.
    """
    model = model_info(REFERENCE_MODEL).load()()
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")
            train, _ = _training_side(task, chooses_epoch=False)
            model.fit(train, robot=task.data.robot, seed=task.cell.model_seed)
            if task.paths is not None:
                rows = task.split.reported
                commands = task.paths.commanded(model.predict, task.data, rows)
                return task.paths.removed(commands, task.data, rows)
            return np.asarray(model.predict(q, wrench))
    except StiffBenchError:
        return None


def _known(task: CellTask, wrench: FloatArray) -> dict[str, FloatArray]:
    """Return what the simulation knows of the reported rows; nothing of loads that it never had."""
    rows = task.split.reported
    if not np.array_equal(wrench, task.data.samples.wrench[rows]):
        return {}
    return {name: deflection[rows] for name, deflection in task.data.known.items()}


def _interval_source(
    task: CellTask, model: StiffnessModel, train: Samples, validation: Samples | None
) -> PredictsInterval | None:
    """Return what will give the intervals: the model itself, or a second fit on fewer rows.

    None where there are none to give: not asked for, or the training side is too small for the
    coverage, which is a warning and leaves the point predictions alone.
    """
    if task.cell.coverage is None:
        return None
    if isinstance(model, PredictsInterval):
        return model
    conformal = SplitConformal(task.make(), coverage=task.cell.coverage)
    with warnings.catch_warnings(record=True) as caught:
        warnings.simplefilter("always", StiffBenchWarning)
        try:
            conformal.fit(
                train, robot=task.data.robot, validation=validation, seed=task.cell.model_seed
            )
        except TooFewToCalibrate as error:
            found, messages = None, [f"no intervals: {error}"]
        else:  # it learned from fewer rows
            found, messages = conformal, [f"fit for the intervals: {w.message}" for w in caught]
    for message in dict.fromkeys(messages):
        warnings.warn(message, StiffBenchWarning, stacklevel=1)
    return found


def _spread_rows(n_rows: int, most: int) -> IntArray:
    """Return at most so many row numbers, the first and the last among them."""
    return np.linspace(0, n_rows - 1, min(n_rows, most)).round().astype(np.int64)


def _check_units(model: StiffnessModel, train: Samples) -> None:
    some = train.take(_spread_rows(len(train), ROWS_FOR_UNITS))
    predicted = np.asarray(model.predict(some.q, some.wrench))
    check_prediction(predicted, len(some))
    check_units(predicted, some.deflection)


def _training_side(task: CellTask, *, chooses_epoch: bool) -> tuple[Samples, Samples | None]:
    """Return training and validation samples.

    A model that chooses no epoch has no use for validation rows; it learns from all of the
    training side instead.
    """
    samples, split = task.data.samples, task.split
    if chooses_epoch:
        validation = samples.take(split.validation) if len(split.validation) else None
        return samples.take(split.train), validation
    return samples.take(_training_rows(task)), None


def _training_rows(task: CellTask) -> IntArray:
    """Return the rows of the training side, those that choose an epoch too.

    Where the validation rows are the test rows, nobody learns from them.
    """
    split = task.split
    if task.shown.selects_on_test:
        return split.train
    return np.sort(np.concatenate([split.train, split.validation]))
