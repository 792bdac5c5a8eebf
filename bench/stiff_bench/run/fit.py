"""Fits a model and has it predict: all that happens where its code runs.

A `FitInput` has no deflection that the model is scored on, so that a model that looks around in a
process of its own finds none.
"""

from __future__ import annotations

import random
import sys
import time
import traceback
import warnings
from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass, field
from typing import TypeVar

import numpy as np

from stiff_bench.console import printing_to_stderr
from stiff_bench.plan.cells import made_model
from stiff_bench.plan.options import Choice
from stiff_bench.run.costs import MemoryMeter, latency, throughput
from stiff_protocols.contract.errors import (
    ModelError,
    StiffBenchError,
    StiffBenchWarning,
    TooFewToCalibrate,
    said_by,
    warn,
)
from stiff_protocols.contract.evaluation import FitInput
from stiff_protocols.contract.plugin import ModelInfo
from stiff_protocols.contract.record import Cost
from stiff_protocols.contract.stiffness_model import (
    StiffnessModel,
    interval_at_tcp,
    offers,
    optional,
)
from stiff_protocols.contract.types import (
    Deflection,
    FloatArray,
    IntArray,
    Interval,
)
from stiff_protocols.scoring.conformal import SplitConformal
from stiff_protocols.scoring.sanity import check_prediction, check_units, warn_of_rows

ROWS_FOR_UNITS = 256
"""How many training rows are predicted to see that a model predicts m: enough, and soon done."""
CURVE_POINTS = 60
"""Of a training that are stored: enough for a figure, and little beside the predictions."""
LONGEST_MESSAGE, MOST_WARNINGS = 2000, 100
"""Of a failure or warning, characters; and how many warnings of a cell are kept."""
_Found = TypeVar("_Found")


@dataclass(frozen=True, eq=False)
class Fitted:
    """The answers of a fitted model.

    Attributes:
        predicted: (n, 3) m, at the commands.
        commands: (n, n_joints) rad or m at which deflections are predicted: those that it was
            asked for, unless the protocol corrects them with predictions.
        cost: of the fit and the predictions.
        interval: of the predictions; None: no intervals.
        calibration_samples: that split-conformal intervals come from; else 0.
        diagnostics, chosen, curves: as in `CellResult`.
        path_commands: (n, n_joints) rad or m, corrected, of the points of tool paths; None: it was
            asked for none.
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
    """The end of a fit: answers, or why there are none.

    Attributes:
        fitted: None where it failed, or the model cannot be used on this machine.
        failure: why there is none, in a sentence.
        cause: of a failure, in a word or two that count it: "SIGKILL", "timed out"; else "".
        warnings: what was warned of.
        log: the last lines that a failed fit's own process printed.
    """

    fitted: Fitted | None = None
    failure: str = ""
    cause: str = ""
    warnings: tuple[str, ...] = ()
    log: tuple[str, ...] = ()


def fit_and_predict(model: Choice[ModelInfo], given: FitInput) -> FitOutcome:
    """Fit a model and ask it for predictions; what goes wrong in it becomes a failure."""
    _seed_global_numbers(given.seed)
    with printing_to_stderr():
        result, failure, cause, warned = attempted(lambda: model.missing() or _fitted(model, given))
    if isinstance(result, Fitted):
        return FitOutcome(result, warnings=warned)
    return FitOutcome(failure=result or failure, cause=cause, warnings=warned)


def attempted(work: Callable[[], _Found]) -> tuple[_Found | None, str, str, tuple[str, ...]]:
    """Return what work that may fail returns, why it failed, the cause, and its warnings."""
    result, failure, cause = None, "", ""
    with warnings.catch_warnings(record=True) as caught:
        warnings.simplefilter("always")
        warnings.simplefilter("ignore", DeprecationWarning)
        try:
            result = work()
        except StiffBenchError as error:
            failure, cause = short(str(error)), type(error).__name__
        except (Exception, SystemExit) as error:  # a plugin's costs that cell alone
            where = traceback.extract_tb(error.__traceback__)[-1]
            failure = f"{short(said_by(error))} ({where.filename}:{where.lineno})"
            cause = type(error).__name__
    return result, failure, cause, unrepeated(str(warning.message) for warning in caught)


def unrepeated(messages: Iterable[str]) -> tuple[str, ...]:
    """Return each warning once, short, and not too many."""
    return tuple(dict.fromkeys(map(short, messages)))[:MOST_WARNINGS]


def short(text: str) -> str:
    """Return a message that a model may have made megabytes long, cut to what people read."""
    return text if len(text) <= LONGEST_MESSAGE else f"{text[:LONGEST_MESSAGE]} [...]"


def _seed_global_numbers(seed: int) -> None:
    """Give a model that draws from global random numbers the same ones wherever the cell runs."""
    random.seed(seed)
    np.random.seed(seed)  # noqa: NPY002
    if (torch := sys.modules.get("torch")) is not None:
        torch.manual_seed(seed)


def _fitted(choice: Choice[ModelInfo], given: FitInput) -> Fitted:
    model = made_model(choice, given.source)
    q, wrench = given.q, given.wrench
    memory = MemoryMeter()
    start = time.perf_counter()
    model.fit(given.train, robot=given.robot, validation=given.validation, seed=given.seed)
    fitted = time.perf_counter()
    answer = model.predict(q, wrench)
    predict_s = time.perf_counter() - fitted
    memory_bytes = memory.rise()
    predicted = _checked(lambda *_: answer)(q, wrench)
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
        if commands is not q:
            centre = intervals.model_ if isinstance(intervals, SplitConformal) else model
            interval = interval_at_tcp(centre, interval, commands, wrench)
    path_commands = None
    if given.path_q is not None and given.path_wrench is not None:
        path_commands = protocol.path_commands(
            predict_tcp, given.robot, given.path_q, given.path_wrench
        )
    warn_of_rows(given.train)
    cost = Cost(  # measured last: how often it asks the model depends on the machine's speed
        fit_s=fitted - start,
        predict_s=predict_s,
        latency_s=latency(model, q, wrench),
        throughput_per_s=throughput(model, q, wrench, predict_s),
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


def _check_interval(interval: Interval, n: int, coverage: float) -> None:
    if not isinstance(interval, Interval):
        wrong = type(interval).__name__
        raise ModelError(f"predict_interval returned {wrong}, expected Interval")
    if (len(interval.lower), interval.coverage) != (n, coverage):
        given = f"{len(interval.lower)} intervals of coverage {interval.coverage:g}"
        wanted = f"{n} of coverage {coverage:g}"
        raise ModelError(f"predict_interval returned {given}, expected {wanted}")


def _checked(predict: Deflection) -> Deflection:
    """Return a function whose predictions are seen to be (n, 3) finite numbers."""

    def checked(q: FloatArray, wrench: FloatArray) -> FloatArray:
        predicted = predict(q, wrench)
        check_prediction(predicted, len(q))
        return np.array(predicted, dtype=np.float64)

    return checked


def _thinned(name: str, curve: FloatArray) -> FloatArray:
    """Return a curve of at most `CURVE_POINTS` points, first and last among them."""
    try:
        points = np.asarray(curve, dtype=np.float64)
    except (TypeError, ValueError):
        points = np.empty(0)
    if points.ndim != 2 or points.shape[1] != 3:
        raise ModelError(f"curves_[{name!r}] is no (n, 3) array of step, loss, validation loss")
    return points[_spread_rows(len(points), CURVE_POINTS)]


def _interval_source(
    choice: Choice[ModelInfo], given: FitInput, model: StiffnessModel
) -> StiffnessModel | SplitConformal | None:
    """Return what will give the intervals: the model itself, or a second fit on fewer rows.

    None where there are none to give: not asked for, or the training side is too small for the
    coverage, which is a warning and leaves the point predictions alone.
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
    """Return at most `most` row numbers, the first and the last among them."""
    return np.linspace(0, n_rows - 1, min(n_rows, most)).round().astype(np.int64)
