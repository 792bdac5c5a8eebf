"""Computes one cell: fit, predict, and only then look at what was measured.

`fit_and_predict` may run in another process. `score` runs in the run's own, and believes nothing
that comes from there before it has seen that it can be true.
"""

from __future__ import annotations

import warnings
from dataclasses import replace

import numpy as np

from stiff_bench.plan.cells import CellTask
from stiff_bench.run.fit import (
    CURVE_POINTS,
    FitOutcome,
    FitTask,
    Fitted,
    attempted,
    commands_of,
    fit_and_predict,
    unrepeated,
)
from stiff_models.model_catalog import REFERENCE_MODEL, model_info
from stiff_protocols.contract.errors import ModelError, StiffBenchError
from stiff_protocols.contract.interfaces import CorrectsPaths
from stiff_protocols.contract.record import CellResult
from stiff_protocols.contract.types import FloatArray, IntArray, Interval, Prediction, Samples
from stiff_protocols.scoring.sanity import check_prediction, check_units, warn_of_rows


def compute_cell(task: CellTask, run_id: str) -> CellResult:
    """Fit, predict and score one cell here; what goes wrong in the model becomes a failed result.

    A model that cannot be used on this machine gives a skipped result.
    """
    return score(task, run_id, fit_and_predict(fit_task(task)))


def fit_task(task: CellTask) -> FitTask:
    """Return what the model is given: nothing that it is scored on."""
    samples, rows = task.data.samples, task.split.reported
    train, validation = _training_side(task, chooses_epoch=task.chooses_epoch)
    return FitTask(
        model=task.model,
        train=train,
        validation=validation,
        robot=task.data.robot,
        q=samples.q[rows],
        wrench=task.split.told_wrench(samples),
        seed=task.cell.model_seed,
        coverage=task.cell.coverage,
        source=task.source and task.source.without_truth(),
        paths=task.paths,
    )


def score(task: CellTask, run_id: str, outcome: FitOutcome) -> CellResult:
    """Score what a fit came to; what cannot be true becomes a failed result that says so."""
    if (fitted := outcome.fitted) is None:
        result = unfinished(task, run_id, outcome.failure, outcome.cause, outcome.log)
        return replace(result, warnings=outcome.warnings)
    scored, failure, cause, warned = attempted(lambda: _scored(task, run_id, fitted))
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


def _scored(task: CellTask, run_id: str, fitted: Fitted) -> CellResult:
    """Return the result; what was measured at the reported rows is looked at last."""
    given = fit_task(task)
    _check(fitted, given)
    warn_of_rows(given.train)
    check_units(fitted.of_training, given.train.deflection[given.rows_for_units])
    predicted, interval = np.asarray(fitted.predicted, dtype=np.float64), fitted.interval
    reference = _reference(task, given)
    measured = task.data.samples.deflection[task.split.reported]
    if fitted.commands is not None:
        # what was predicted, less the change of the deflection from the path to the command
        removed = _removed(task, fitted.commands)
        if interval is not None and fitted.at_commands is not None:
            shift = removed - fitted.at_commands
            interval = Interval(interval.lower + shift, interval.upper + shift, interval.coverage)
        predicted = removed
    known = _known(task, given.wrench)
    rows = task.split.reported
    prediction = Prediction(rows, predicted, measured, interval, reference, known)
    of_training = _training_rows(task)
    return CellResult(
        cell=task.cell,
        shown=task.shown,
        run_id=run_id,
        status="ok",
        prediction=prediction,
        cost=fitted.cost,
        calibration_samples=fitted.calibration_samples,
        diagnostics=fitted.diagnostics,
        n_train=len(of_training),
        n_labels=len(given.train),
        n_poses=len(np.unique(task.data.samples.pose_id[of_training])),
        n_splits=task.n_splits,
        chosen=fitted.chosen,
        curves=fitted.curves,
    )


def _check(fitted: Fitted, given: FitTask) -> None:
    """Raise ModelError unless what a model said has the shapes of what it was asked."""
    n = len(given.q)
    check_prediction(fitted.predicted, n)
    check_prediction(fitted.of_training, len(given.rows_for_units))
    if (fitted.commands is None) != (given.paths is None):
        raise ModelError("the fit sent commands of tool paths that nobody asked for, or none")
    if fitted.commands is not None:
        commands = np.asarray(fitted.commands)
        if commands.shape != given.q.shape or not np.isfinite(commands).all():
            raise ModelError(f"the fit sent commands of shape {commands.shape}, or no finite ones")
    if fitted.interval is not None:
        if given.coverage is None or len(fitted.interval.lower) != n:
            n_sent = len(fitted.interval.lower)
            raise ModelError(f"the fit sent {n_sent} intervals for {n} predictions")
        if fitted.interval.coverage != given.coverage:
            raise ModelError(f"the fit sent intervals of coverage {fitted.interval.coverage:g}")
        if fitted.commands is not None:
            check_prediction(np.asarray(fitted.at_commands), n)
    seconds = [value for value in fitted.cost[:-1] if value is not None]
    if not np.isfinite(seconds).all() or min(seconds) < 0.0 or (fitted.cost.memory_bytes or 0) < 0:
        raise ModelError(f"the fit sent costs that nothing can have: {fitted.cost}")
    if not 0 <= fitted.calibration_samples <= len(given.train):
        raise ModelError(f"the fit sent {fitted.calibration_samples} calibration samples")
    for name, curve in fitted.curves.items():
        if curve.shape[1:] != (3,) or len(curve) > CURVE_POINTS:
            raise ModelError(f"the fit sent a curve {name!r} of shape {curve.shape}")


def _reference(task: CellTask, given: FitTask) -> FloatArray | None:
    """Return what the reference model predicts that learned from the whole training side.

    Of tool paths, how much of the error its commands remove. It takes a millisecond; None where
    these data do not identify it.
    """
    model = model_info(REFERENCE_MODEL).load()()
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")
            train, _ = _training_side(task, chooses_epoch=False)
            model.fit(train, robot=given.robot, seed=given.seed)
            q, wrench = given.q, given.wrench
            commands = commands_of(given.paths, model.predict, given.robot, q, wrench)
            if commands is not None:
                return _removed(task, commands)
            return np.asarray(model.predict(q, wrench))
    except StiffBenchError:
        return None


def _removed(task: CellTask, commands: FloatArray) -> FloatArray:
    """Return (n, 3) how much of the path error [m] commands remove, as the robot itself answers."""
    assert task.paths is not None  # else there are no commands
    protocol: CorrectsPaths = task.paths.make()
    return protocol.removed(commands, task.data, task.split.reported)


def _known(task: CellTask, wrench: FloatArray) -> dict[str, FloatArray]:
    """Return what the simulation knows of the reported rows; nothing of loads that it never had."""
    rows = task.split.reported
    if not np.array_equal(wrench, task.data.samples.wrench[rows]):
        return {}
    return {name: deflection[rows] for name, deflection in task.data.known.items()}


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
