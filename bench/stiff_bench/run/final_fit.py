"""Fit a model to a whole data set, as `bench fit` does, without test samples."""

from __future__ import annotations

import warnings
from typing import Any

import numpy as np

from stiff_bench.plan.fits import DEFAULT_COVERAGE, uses_validation
from stiff_bench.plan.options import Choice
from stiff_protocols.contract.errors import ConfigError, ModelError, StiffBenchWarning
from stiff_protocols.contract.evaluation import training_side
from stiff_protocols.contract.plugin import ModelInfo
from stiff_protocols.contract.stiffness_model import check_readings, optional, predicted_readings
from stiff_protocols.contract.training_range import TrainingRange
from stiff_protocols.contract.types import AXES, FloatArray, Robot, Samples
from stiff_protocols.scoring.conformal import SplitConformal
from stiff_protocols.scoring.cross_validated import CrossValidatedError
from stiff_protocols.scoring.sanity import check_prediction
from stiff_protocols.splits.generators import inner_validation

VALIDATION_FRACTION = 0.2
"""Share of the poses that choose the epoch; the protocols' default."""


def final_fit(
    choice: Choice[ModelInfo], samples: Samples, robot: Robot, *, seed: int = 0
) -> tuple[Any, str]:
    """Return a new fitted model, and a note on its number of epochs.

    The note is "" for models that choose no epoch.

    Raises:
        ConfigError: the model cannot be used here, or not for this robot.
        ModelError: the samples cannot be fitted.
    """
    if reason := choice.missing():
        raise ConfigError(f"{choice.name!r} cannot be used here: {reason}")
    model = choice.make()
    optional(model, "check_robot")(robot)
    check_readings(model, samples)
    train, validation = _training_side(choice, samples, seed)
    note = ""
    if validation is not None:
        note = (
            f"{len(validation)} samples of {len(set(validation.pose_id))} poses chose the "
            f"number of epochs; the model is fitted to {len(train)} samples"
        )
    elif uses_validation(choice.info, model):
        note = "a single pose leaves no samples to choose the epoch; the last epoch is used"
    model.fit(train, robot=robot, validation=validation, seed=seed)
    training_range = TrainingRange.of(train, robot)
    for name, value in (("robot_", robot), ("training_range_", training_range)):
        if not hasattr(model, name):  # a plugin's model need not have them
            setattr(model, name, value)
    return model, note


def left_out_errors(
    choice: Choice[ModelInfo], samples: Samples, robot: Robot, *, seed: int = 0
) -> FloatArray:
    """Return the (n, 3) errors of a second fit at poses that it did not learn from, m.

    They are `SplitConformal.residuals_`, the source of intervals for models without intervals.
    A quarter of the poses is left out, or up to half if 90 % intervals need them.

    Raises:
        StiffBenchError: the remaining samples cannot be fitted.
    """
    train, validation = _training_side(choice, samples, seed)
    half = len(np.unique(train.pose_id)) // 2
    if not half:
        return np.empty((0, len(AXES)))
    model = SplitConformal(choice.make(), coverage=min(DEFAULT_COVERAGE, half / (half + 1.0)))
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", StiffBenchWarning)  # those of the whole fit were shown
        model.fit(train, robot=robot, validation=validation, seed=seed)
    return model.residuals_


def cross_validated_error(
    choice: Choice[ModelInfo], samples: Samples, robot: Robot, *, seed: int = 0
) -> CrossValidatedError:
    """Return the error of a model at poses that its fits left out.

    Each fifth of the poses is predicted by a model that is fitted to the other poses as in
    `final_fit`. Readings are compared with `predict_reading`. With fewer than five poses, each
    pose is left out in turn.

    Raises:
        ModelError: the samples have only one pose.
        StiffBenchError: the remaining samples cannot be fitted.
    """
    from stiff_models.pose_folds import left_out_fifths  # scikit-learn is slow to import

    if len(np.unique(samples.pose_id)) < 2:
        raise ModelError("one pose, expected at least two for a cross-validated error")
    errors = []
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", StiffBenchWarning)  # those of the whole fit were shown
        for learned, left_out in left_out_fifths(samples, seed):
            model = choice.make()
            train, validation = _training_side(choice, learned, seed)
            model.fit(train, robot=robot, validation=validation, seed=seed)
            predicted = predicted_readings(model, left_out.q, left_out.wrench, left_out.levers)
            check_prediction(predicted, len(left_out))
            errors.append(left_out.seen(predicted) - left_out.deflection)
    return CrossValidatedError.of(np.concatenate(errors), len(errors))


def _training_side(
    choice: Choice[ModelInfo], samples: Samples, seed: int
) -> tuple[Samples, Samples | None]:
    """Return the samples to learn from, and the samples that choose the epoch (None: unused)."""
    chooses = uses_validation(choice.info, choice.make())
    split = inner_validation(samples, np.arange(len(samples)), VALIDATION_FRACTION, seed)
    return training_side(samples, split, chooses_epoch=chooses)
