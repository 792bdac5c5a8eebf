"""Computes one cell: fit, predict, and only then look at what was measured.

`fit_and_predict` may run in another process. `score` runs in the run's own, on what comes from
there: predictions, and never a metric.
"""

from __future__ import annotations

import warnings
from dataclasses import replace

import numpy as np

from stiff_bench.plan.cells import CellTask
from stiff_bench.run.fit import FitOutcome, Fitted, attempted, fit_and_predict, unrepeated
from stiff_models.model_catalog import REFERENCE_MODEL, model_info
from stiff_protocols.contract.errors import StiffBenchError
from stiff_protocols.contract.evaluation import FitInput
from stiff_protocols.contract.record import CellResult
from stiff_protocols.contract.types import FloatArray
from stiff_protocols.scoring.sanity import check_prediction


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
    if (fitted := outcome.fitted) is None:
        result = unfinished(task, run_id, outcome.failure, outcome.cause, outcome.log)
        return replace(result, warnings=outcome.warnings)
    scored, failure, cause, warned = attempted(lambda: _scored(task, given, run_id, fitted))
    result = scored or unfinished(task, run_id, failure, cause, outcome.log)
    return replace(result, warnings=unrepeated((*outcome.warnings, *warned)))


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


def _scored(task: CellTask, given: FitInput, run_id: str, fitted: Fitted) -> CellResult:
    """Return the result; what was measured at the reported rows is looked at last."""
    reference = _reference(task, given)
    prediction = task.prediction(fitted.predicted, fitted.commands, fitted.interval, reference)
    check_prediction(prediction.predicted, len(given.q))
    return CellResult(
        cell=task.cell,
        shown=task.shown,
        run_id=run_id,
        status="ok",
        prediction=prediction,
        cost=fitted.cost,
        calibration_samples=fitted.calibration_samples,
        diagnostics=fitted.diagnostics,
        n_train=len(task.training_rows),
        n_labels=len(given.train),
        n_poses=len(np.unique(task.data.samples.pose_id[task.training_rows])),
        n_splits=task.n_splits,
        chosen=fitted.chosen,
        curves=fitted.curves,
    )


def _reference(task: CellTask, given: FitInput) -> FloatArray | None:
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
