"""Fit a model and compute its predictions, in the process where its code runs.

A `FitInput` contains no deflection that the model is scored on. So a model in a separate process
cannot read the test labels.
"""

from __future__ import annotations

import random
import statistics
import sys
import time
import traceback
import warnings
from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass, field
from functools import partial
from typing import TypeVar

import numpy as np

from stiff_bench.console import printing_to_stderr
from stiff_bench.plan.fits import made_model
from stiff_bench.plan.options import Choice
from stiff_bench.run.machine import MemoryMeter
from stiff_protocols.contract.errors import (
    ModelError,
    StiffBenchError,
    StiffBenchWarning,
    TooFewToCalibrate,
    describe_error,
    warn,
)
from stiff_protocols.contract.evaluation import FitInput
from stiff_protocols.contract.plugin import ModelInfo
from stiff_protocols.contract.record import Cost
from stiff_protocols.contract.stiffness_model import (
    StiffnessModel,
    check_readings,
    interval_at_points,
    interval_at_tcp,
    offers,
    optional,
    predicted_readings,
)
from stiff_protocols.contract.types import (
    Deflection,
    FloatArray,
    IntArray,
    Interval,
)
from stiff_protocols.scoring.conformal import SplitConformal
from stiff_protocols.scoring.sanity import (
    check_prediction,
    check_rows_apart,
    check_units,
    warn_of_rows,
)

ROWS_FOR_UNITS = 256
"""Number of training rows predicted to check that a model predicts m."""
CURVE_POINTS = 60
"""Number of stored points per training curve: enough for a figure."""
LONGEST_MESSAGE, MOST_WARNINGS = 2000, 100
"""Characters of a failure or warning; number of stored warnings per fit."""
MOST_SINGLE_PREDICTIONS = 21
ROWS_AT_ONCE = 1024
SECONDS = 0.1
"""A model that takes longer in total is not called again."""
SHORTEST = 1e-9  # a coarse clock may show no difference
_Result = TypeVar("_Result")


@dataclass(frozen=True, eq=False)
class Fitted:
    """Predictions of a fitted model, with their costs.

    Attributes:
        predicted: (n, 3) m, at the commands.
        commands: (n, n_joints) rad or m at which deflections are predicted: the requested ones,
            unless the protocol corrects them with predictions.
        cost: cost of the fit and the predictions.
        interval: intervals of the predictions; None: no intervals.
        calibration_samples: number of samples that split-conformal intervals come from; else 0.
        diagnostics, chosen, curves: as in `FitResult`.
        path_commands: (n, n_joints) rad or m, corrected, at the points of tool paths; None: not
            requested.
    """

    predicted: FloatArray
    commands: FloatArray
    cost: Cost
    interval: Interval | None = None
    calibration_samples: int = 0
    diagnostics: Mapping[str, float] = field(default_factory=dict)
    chosen: Mapping[str, str] = field(default_factory=dict)
    curves: Mapping[str, FloatArray] = field(default_factory=dict)
    path_commands: FloatArray | None = None


@dataclass(frozen=True, eq=False)
class FitOutcome:
    """Outcome of a fit: predictions, or the reason for their absence.

    Attributes:
        fitted: the predictions; None if it failed, or the model cannot be used on this machine.
        failure: the reason, in a sentence.
        cause: the kind of a failure, in one or two words: "SIGKILL", "timed out"; else "".
        warnings: the texts of the warnings.
        log: the last lines that the process of a failed fit printed.
    """

    fitted: Fitted | None = None
    failure: str = ""
    cause: str = ""
    warnings: tuple[str, ...] = ()
    log: tuple[str, ...] = ()


def fit_and_predict(model: Choice[ModelInfo], given: FitInput) -> FitOutcome:
    """Fit a model and predict; an error of the model gives a failure."""
    _seed_global_numbers(given.seed)
    with printing_to_stderr():
        result, failure, cause, messages = attempted(
            lambda: model.missing() or _fitted(model, given)
        )
    if isinstance(result, Fitted):
        return FitOutcome(result, warnings=messages)
    return FitOutcome(failure=result or failure, cause=cause, warnings=messages)


def attempted(work: Callable[[], _Result]) -> tuple[_Result | None, str, str, tuple[str, ...]]:
    """Return the result of work that may fail, the failure, its cause, and the warnings."""
    result, failure, cause = None, "", ""
    with warnings.catch_warnings(record=True) as caught:
        warnings.simplefilter("always")
        warnings.simplefilter("ignore", DeprecationWarning)
        try:
            result = work()
        except StiffBenchError as error:
            failure, cause = short(str(error)), type(error).__name__
        except (Exception, SystemExit) as error:  # a plugin's error costs only this fit
            where = traceback.extract_tb(error.__traceback__)[-1]
            failure = f"{short(describe_error(error))} ({where.filename}:{where.lineno})"
            cause = type(error).__name__
    return result, failure, cause, unrepeated(str(warning.message) for warning in caught)


def unrepeated(messages: Iterable[str]) -> tuple[str, ...]:
    """Return each warning once, shortened, at most `MOST_WARNINGS`."""
    return tuple(dict.fromkeys(map(short, messages)))[:MOST_WARNINGS]


def short(text: str) -> str:
    """Return a message cut to `LONGEST_MESSAGE` characters; a model may write megabytes."""
    return text if len(text) <= LONGEST_MESSAGE else f"{text[:LONGEST_MESSAGE]} [...]"


def _seed_global_numbers(seed: int) -> None:
    """Seed the global random numbers, so that a fit draws the same ones everywhere."""
    random.seed(seed)
    np.random.seed(seed)  # noqa: NPY002
    if (torch := sys.modules.get("torch")) is not None:
        torch.manual_seed(seed)


def _fitted(choice: Choice[ModelInfo], given: FitInput) -> Fitted:
    model = made_model(choice, given.source)
    q, wrench = given.q, given.wrench
    memory = MemoryMeter()
    check_readings(model, given.train)
    start = time.perf_counter()
    returned = model.fit(
        given.train, robot=given.robot, validation=given.validation, seed=given.seed
    )
    fitted = time.perf_counter()
    if returned is not model:
        raise ModelError(f"fit returned {type(returned).__name__}: end fit with return self")
    predict_rows = optional(model, "predict_reading") if given.of_readings else model.predict
    answer = predict_rows(q, wrench)
    predict_s = time.perf_counter() - fitted
    memory_bytes = memory.rise()
    predicted = _checked(lambda *_: answer)(q, wrench)
    check_rows_apart(predict_rows, q, wrench, predicted)
    if given.levers.size:
        at_points = partial(predicted_readings, model, levers=given.levers)
        predicted = _checked(at_points)(q, wrench)
    predict, predict_tcp = map(_checked, (model.predict, optional(model, "predict_at_tcp")))
    training = given.train.take(_spread_rows(len(given.train), ROWS_FOR_UNITS))
    check_units(predict(training.q, training.wrench), training.deflection)
    diagnostics = getattr(model, "diagnostics_", {})
    diagnostics = {str(name): float(value) for name, value in diagnostics.items()}
    chosen = getattr(model, "best_params_", {})
    intervals = _interval_source(choice, given, model)
    protocol = given.make_protocol()
    commands = protocol.commanded(predict_tcp, given.robot, q, wrench)
    if commands is not q:
        predicted = predict_tcp(commands, wrench)
    interval = None
    if intervals is not None and given.coverage is not None:
        interval = intervals.predict_interval(commands, wrench, given.coverage)
        _check_interval(interval, len(q), given.coverage)
        centre = intervals.model_ if isinstance(intervals, SplitConformal) else model
        interval = interval_at_points(centre, interval, commands, wrench, given.levers)
        if commands is not q:
            interval = interval_at_tcp(centre, interval, commands, wrench)
    path_commands = None
    if given.path_q is not None and given.path_wrench is not None:
        path_commands = protocol.path_commands(
            predict_tcp, given.robot, given.path_q, given.path_wrench
        )
    warn_of_rows(given.train)
    cost = Cost(  # measured last: the number of calls depends on the machine's speed
        fit_s=fitted - start,
        predict_s=predict_s,
        latency_s=_latency(model, q, wrench),
        throughput_per_s=_throughput(model, q, wrench, predict_s),
        memory_bytes=memory_bytes,
    )
    curves = getattr(model, "curves_", {})
    return Fitted(
        predicted=predicted,
        commands=commands,
        cost=cost,
        interval=interval,
        calibration_samples=(
            len(intervals.residuals_) if isinstance(intervals, SplitConformal) else 0
        ),
        diagnostics=diagnostics,
        chosen={str(name): str(value) for name, value in chosen.items()},
        curves={str(name): _thinned(name, curve) for name, curve in curves.items()},
        path_commands=path_commands,
    )


def _latency(model: StiffnessModel, q: FloatArray, wrench: FloatArray) -> float:
    """Return the median wall time [s] of predicting one row; `q` and `wrench` hold some rows."""
    times: list[float] = []
    rows = [slice(i, i + 1) for i in range(min(len(q), MOST_SINGLE_PREDICTIONS))]
    while len(times) < MOST_SINGLE_PREDICTIONS and sum(times) < SECONDS:
        row = rows[len(times) % len(rows)]
        times.append(_seconds(partial(model.predict, q[row], wrench[row])))
    return statistics.median(times)


def _throughput(
    model: StiffnessModel, q: FloatArray, wrench: FloatArray, predict_s: float
) -> float:
    """Return the rows per second of a large call; calls grow up to 1,024 rows.

    The (n, n_joints) and (n, 6) rows are repeated. Predicting them once took `predict_s`. A slow
    model is not called with more rows.
    """
    seconds, times = predict_s, 1
    enough = -(-ROWS_AT_ONCE // len(q))
    while times < enough and seconds < SECONDS / 2:
        # twice the rows take at most about twice the time, so no call takes much longer than that
        times = min(2 * times, enough)
        many = [np.tile(rows, (times, 1)) for rows in (q, wrench)]
        seconds = _seconds(partial(model.predict, *many))
    return times * len(q) / max(seconds, SHORTEST)


def _seconds(call: Callable[[], object]) -> float:
    start = time.perf_counter()
    call()
    return max(time.perf_counter() - start, SHORTEST)


def _check_interval(interval: Interval, n: int, coverage: float) -> None:
    if not isinstance(interval, Interval):
        type_name = type(interval).__name__
        raise ModelError(f"predict_interval returned {type_name}, expected Interval")
    if (len(interval.lower), interval.coverage) != (n, coverage):
        returned = f"{len(interval.lower)} intervals of coverage {interval.coverage:g}"
        expected = f"{n} of coverage {coverage:g}"
        raise ModelError(f"predict_interval returned {returned}, expected {expected}")


def _checked(predict: Deflection) -> Deflection:
    """Return a function that checks its predictions: (n, 3) finite numbers."""

    def checked(q: FloatArray, wrench: FloatArray) -> FloatArray:
        predicted = predict(q, wrench)
        check_prediction(predicted, len(q))
        return np.array(predicted, dtype=np.float64)

    return checked


def _thinned(name: str, curve: FloatArray) -> FloatArray:
    """Return at most `CURVE_POINTS` points of a curve, with the first and the last."""
    try:
        points = np.asarray(curve, dtype=np.float64)
    except (TypeError, ValueError):
        points = np.empty(0)
    if points.ndim != 2 or points.shape[1] != 3:
        raise ModelError(f"curves_[{name!r}] is not an (n, 3) array of step, loss, validation loss")
    return points[_spread_rows(len(points), CURVE_POINTS)]


def _interval_source(
    choice: Choice[ModelInfo], given: FitInput, model: StiffnessModel
) -> StiffnessModel | SplitConformal | None:
    """Return the source of the intervals: the model itself, or a second fit on fewer rows.

    None: intervals are not requested, or the training side is too small for the coverage. The
    latter is a warning; the point predictions stay the same.
    """
    if given.coverage is None:
        return None
    if offers(model, "predict_interval"):
        return model
    conformal = SplitConformal(made_model(choice, given.source), coverage=given.coverage)
    with warnings.catch_warnings(record=True) as caught:
        warnings.simplefilter("always", StiffBenchWarning)
        try:
            conformal.fit(
                given.train, robot=given.robot, validation=given.validation, seed=given.seed
            )
        except TooFewToCalibrate as error:
            source, messages = None, [f"no intervals: {error}"]
        else:  # it learned from fewer rows
            source, messages = conformal, [f"fit for the intervals: {w.message}" for w in caught]
    for message in dict.fromkeys(messages):
        warn(message, stacklevel=1)
    return source


def _spread_rows(n_rows: int, most: int) -> IntArray:
    """Return at most `most` row numbers, with the first and the last."""
    return np.linspace(0, n_rows - 1, min(n_rows, most)).round().astype(np.int64)
