"""Compute fits: fit, predict, and only then read the measurements.

`fit_and_predict` may run in another process. `score` runs in the process of the run. It receives
predictions from there, never a metric.
"""

from __future__ import annotations

import warnings
from collections.abc import Callable, Generator, Iterable, Mapping, Set
from dataclasses import dataclass, field, replace
from typing import Literal

import numpy as np

from stiff_bench.plan.fits import FitTask
from stiff_bench.plan.options import Choice
from stiff_bench.run.fit import FitOutcome, Fitted, attempted, fit_and_predict, unrepeated
from stiff_bench.run.progress import Display
from stiff_models.model_catalog import REFERENCE_MODEL, model_info
from stiff_protocols.contract.errors import StiffBenchError
from stiff_protocols.contract.evaluation import FitInput
from stiff_protocols.contract.plugin import ModelInfo
from stiff_protocols.contract.record import PATH_ERROR, FitResult
from stiff_protocols.contract.types import FloatArray
from stiff_protocols.scoring.sanity import check_prediction

Rerun = Literal["missing", "failed", "all"]
REUSED_STATUSES: Mapping[Rerun, Set[str]] = {
    "missing": {"ok", "failed"},
    "failed": {"ok"},
    "all": frozenset(),
}
"""Statuses of stored results that are reused; skipped fits are always tried again."""


@dataclass(eq=False, kw_only=True)
class Execution:
    """Compute the fits of a run in this process, one after another; subclasses do more.

    Attributes:
        rerun: fits that are computed again although their results are stored.
        facts: entries for the manifest.
        at_once: number of fits computed in parallel, as far as it is known.
        machines: environments of other machines that took part, by their addresses.
    """

    rerun: Rerun = "missing"
    facts: Mapping[str, str] = field(default_factory=dict)
    at_once: int = 1
    machines: dict[str, Mapping[str, str]] = field(default_factory=dict)

    def results(
        self, tasks: Iterable[FitTask], run_id: str, display: Display
    ) -> Generator[FitResult, None, None]:
        """Yield the result of every fit as it ends, in any order.

        A task is taken from `tasks` when its turn comes. Closing the generator ends what runs.

        Raises:
            ConfigError: no cluster answers at this address, or it has stopped.
        """
        for task in tasks:
            display.start(task)
            yield compute_fit(task, run_id, self.fit)

    def fit(self, model: Choice[ModelInfo], given: FitInput) -> FitOutcome:
        """Return the outcome of a fit."""
        return fit_and_predict(model, given)


def compute_fit(
    task: FitTask,
    run_id: str,
    fit: Callable[[Choice[ModelInfo], FitInput], FitOutcome] = fit_and_predict,
) -> FitResult:
    """Fit, predict and score; an error of the model gives a failed result.

    A model that cannot be used on this machine gives a skipped result.
    """
    given = fit_input(task)
    return score(task, given, run_id, fit(task.model, given))


def fit_input(task: FitTask) -> FitInput:
    """Return the input of a fit, without the deflections that it is scored on."""
    return task.fit_input(
        chooses_epoch=task.chooses_epoch, seed=task.fit.model_seed, coverage=task.fit.coverage
    )


def score(task: FitTask, given: FitInput, run_id: str, outcome: FitOutcome) -> FitResult:
    """Score the outcome of a fit; impossible predictions give a failed result with the reason."""
    if (fitted := outcome.fitted) is not None:
        scored, failure, cause, messages = attempted(lambda: _scored(task, given, run_id, fitted))
        outcome = replace(outcome, warnings=unrepeated((*outcome.warnings, *messages)))
        if scored is not None:
            return replace(scored, warnings=outcome.warnings)
        outcome = replace(outcome, failure=failure, cause=cause)
    return FitResult(
        fit=task.fit,
        presentation=task.presentation,
        run_id=run_id,
        status="failed" if outcome.cause else "skipped",
        failure=outcome.failure,
        n_splits=task.n_splits,
        cause=outcome.cause,
        log=outcome.log,
        warnings=outcome.warnings,
    )


def _scored(task: FitTask, given: FitInput, run_id: str, fitted: Fitted) -> FitResult:
    """Return the result; the measurements at the reported rows are read last."""
    reference = reference_values(task, given)
    prediction = task.prediction(fitted.predicted, fitted.commands, fitted.interval, reference)
    check_prediction(prediction.predicted, len(given.q))
    diagnostics = dict(fitted.diagnostics)
    if fitted.path_commands is not None:
        diagnostics[PATH_ERROR] = 1000.0 * task.path_error(fitted.path_commands)
    return FitResult(
        fit=task.fit,
        presentation=task.presentation,
        run_id=run_id,
        status="ok",
        prediction=prediction,
        cost=fitted.cost,
        calibration_samples=fitted.calibration_samples,
        diagnostics=diagnostics,
        n_train=len(task.training_rows),
        n_labels=len(given.train),
        n_poses=len(np.unique(task.data.samples.pose_id[task.training_rows])),
        n_splits=task.n_splits,
        chosen=fitted.chosen,
        curves=fitted.curves,
    )


def reference_values(task: FitTask, given: FitInput) -> FloatArray | None:
    """Return the scored values of the reference model, fitted to the whole training side.

    It takes a millisecond. None: these data do not identify the model.
    """
    model = model_info(REFERENCE_MODEL).load()()
    train = given.train if given.validation is None else task.data.samples.take(task.training_rows)
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")
            model.fit(train, robot=given.robot, seed=given.seed)
            q, wrench = given.q, given.wrench
            commands = task.protocol.commanded(model.predict, given.robot, q, wrench)
            return task.scored(np.asarray(model.predict(commands, wrench)), commands)
    except StiffBenchError:
        return None
