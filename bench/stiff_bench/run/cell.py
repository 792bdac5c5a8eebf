"""Computes cells: fit, predict, and only then look at what was measured.

`fit_and_predict` may run in another process. `score` runs in the run's own, on what comes from
there: predictions, and never a metric.
"""

from __future__ import annotations

import warnings
from collections.abc import Generator, Iterable, Mapping, Set
from dataclasses import dataclass, field, replace
from typing import Literal

import numpy as np

from stiff_bench.plan.cells import CellTask
from stiff_bench.run.fit import FitOutcome, Fitted, attempted, fit_and_predict, unrepeated
from stiff_bench.run.progress import Display
from stiff_models.model_catalog import REFERENCE_MODEL, model_info
from stiff_protocols.contract.errors import StiffBenchError
from stiff_protocols.contract.evaluation import FitInput
from stiff_protocols.contract.record import PATH_ERROR, CellResult
from stiff_protocols.contract.types import FloatArray
from stiff_protocols.scoring.sanity import check_prediction

Rerun = Literal["missing", "failed", "all"]
COUNTING: Mapping[Rerun, Set[str]] = {
    "missing": {"ok", "failed"},
    "failed": {"ok"},
    "all": frozenset(),
}
"""Statuses of the stored results that stand; what was skipped is always looked at again."""


@dataclass(eq=False, kw_only=True)
class Execution:
    """How the cells of a run are computed: here, one after another, unless a subclass does more.

    Attributes:
        rerun: which cells are computed though their results are there.
        facts: what a manifest says of it.
        at_once: how many cells are computed side by side, as far as that is known.
        machines: environments of other machines that took part, by their addresses.
    """

    rerun: Rerun = "missing"
    facts: Mapping[str, str] = field(default_factory=dict)
    at_once: int = 1
    machines: dict[str, Mapping[str, str]] = field(default_factory=dict)

    def results(
        self, tasks: Iterable[CellTask], run_id: str, display: Display
    ) -> Generator[CellResult, None, None]:
        """Yield the result of every cell as it ends, in any order.

        A task is taken from `tasks` when its turn comes. Closing the generator ends what runs.

        Raises:
            ConfigError: there is no cluster of this address, or it has gone.
        """
        for task in tasks:
            display.start(task)
            yield compute_cell(task, run_id)


def compute_cell(task: CellTask, run_id: str) -> CellResult:
    """Fit, predict and score one cell here; what goes wrong in the model becomes a failed result.

    A model that cannot be used on this machine gives a skipped result.
    """
    given = fit_input(task)
    return score(task, given, run_id, fit_and_predict(task.model, given))


def fit_input(task: CellTask) -> FitInput:
    """Return what the fit of a cell sees and is asked: no deflection that it is scored on."""
    return task.fit_input(
        chooses_epoch=task.chooses_epoch, seed=task.cell.model_seed, coverage=task.cell.coverage
    )


def score(task: CellTask, given: FitInput, run_id: str, outcome: FitOutcome) -> CellResult:
    """Score what a fit came to; what cannot be true becomes a failed result that says so."""
    if (fitted := outcome.fitted) is not None:
        scored, failure, cause, warned = attempted(lambda: _scored(task, given, run_id, fitted))
        outcome = replace(outcome, warnings=unrepeated((*outcome.warnings, *warned)))
        if scored is not None:
            return replace(scored, warnings=outcome.warnings)
        outcome = replace(outcome, failure=failure, cause=cause)
    return CellResult(
        cell=task.cell,
        shown=task.shown,
        run_id=run_id,
        status="failed" if outcome.cause else "skipped",
        failure=outcome.failure,
        n_splits=task.n_splits,
        cause=outcome.cause,
        log=outcome.log,
        warnings=outcome.warnings,
    )


def _scored(task: CellTask, given: FitInput, run_id: str, fitted: Fitted) -> CellResult:
    """Return the result; what was measured at the reported rows is looked at last."""
    reference = reference_values(task, given)
    prediction = task.prediction(fitted.predicted, fitted.commands, fitted.interval, reference)
    check_prediction(prediction.predicted, len(given.q))
    diagnostics = dict(fitted.diagnostics)
    if fitted.path_commands is not None:
        diagnostics[PATH_ERROR] = 1000.0 * task.path_error(fitted.path_commands)
    return CellResult(
        cell=task.cell,
        shown=task.shown,
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


def reference_values(task: CellTask, given: FitInput) -> FloatArray | None:
    """Return the scored values of the reference model, which learns from the whole training side.

    It takes a millisecond; None: these data do not identify it.
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
