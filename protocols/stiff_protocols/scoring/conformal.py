"""Split-conformal intervals for any model, from its errors at left-out poses.

The training side is divided by pose. A copy of the model is fitted to one part. The absolute errors
s_1 .. s_n on the other part give the half width of the interval per axis: with
``k = ceil(c (n + 1))`` the k-th smallest of them. A new pose then lies inside with a probability
of c to c + 1/(n + 1), for any model (Lei et al. 2018, Distribution-free predictive inference for
regression, theorem 2.2). Each error counts in units of `TrainingRange.stretch`: errors may be
larger far from training poses, and intervals there are wider by this factor.

This requires exchangeable errors. The rows of a pose are not exchangeable, so each calibration pose
gives one row, drawn at random (Dunn, Wasserman and Ramdas 2023, Distribution-free prediction sets
for two-layer hierarchical models, "subsampling once").
"""

from __future__ import annotations

import math
from dataclasses import KW_ONLY, dataclass
from typing import Self

import numpy as np

from stiff_protocols.contract.errors import ModelError, NotFittedError, TooFewToCalibrate
from stiff_protocols.contract.stiffness_model import StiffnessModel, predicted_readings
from stiff_protocols.contract.training_range import TrainingRange
from stiff_protocols.contract.types import (
    AXES,
    Deflection,
    FloatArray,
    Interval,
    Robot,
    Samples,
)
from stiff_protocols.scoring.sanity import check_prediction
from stiff_protocols.splits.generators import inner_validation

SHARE = 0.25
"""Share of the training poses for calibration; more if the coverage requires it, up to half."""
ROUNDING = 1e-12
"""1 - 0.9 is a little less than 0.1 in floating point, which would cost a calibration sample."""


def calibration_samples_needed(coverage: float) -> int:
    """Return how many calibration samples a finite interval needs: c / (1 - c), rounded up."""
    return math.ceil(1.0 / (1.0 - coverage + ROUNDING)) - 1


@dataclass(eq=False, repr=False)
class SplitConformal(StiffnessModel):
    """A model with split-conformal intervals.

    Attributes:
        model: model to copy and fit; it is not changed.
        coverage: probability (0..1) of an interval, per axis.
        model_: the copy, fitted to the other poses.
        residuals_: (n, 3) m, absolute errors on one row of each calibration pose, over
            `TrainingRange.stretch`. Of readings along directions, the largest on each axis.
    """

    model: StiffnessModel
    _: KW_ONLY
    coverage: float = 0.9

    def fit(
        self, train: Samples, *, robot: Robot, validation: Samples | None = None, seed: int = 0
    ) -> Self:
        """Divide `train` by pose, fit a copy of the model to one part, calibrate on the other.

        The model gets `validation` unchanged; it is never used for calibration. `seed` determines
        the division and the model.

        Raises:
            TooFewToCalibrate: `coverage` needs more calibration samples than half of the poses.
        """
        from sklearn.base import clone  # slow, and few runs have intervals

        part = inner_validation(train, np.arange(len(train)), self._fraction(train), seed)
        self.model_ = clone(self.model)
        learned = train.take(part.train)
        self.model_.fit(learned, robot=robot, validation=validation, seed=seed)
        self.training_range_ = TrainingRange.of(learned, robot)
        shuffled = np.random.default_rng(seed).permutation(part.validation)
        _, one_a_pose = np.unique(train.pose_id[shuffled], return_index=True)
        calibration = train.take(shuffled[one_a_pose])
        loads, levers = (calibration.q, calibration.wrench), calibration.levers
        if levers.size:
            predicted = predicted_readings(self.model_, *loads, levers)
        else:
            predicted = self.predict(*loads)
        error = np.abs(predicted - calibration.deflection)
        if calibration.directions.size:  # an axis may err as much as a reading
            read = calibration.read(predicted) - calibration.values
            largest = np.abs(read).max(axis=1, keepdims=True)
            error = np.repeat(largest, len(AXES), axis=1)
        stretch = self.training_range_.stretch(calibration.q, calibration.wrench)
        self.residuals_ = error / stretch[:, None]
        return self

    def predict(self, q: FloatArray, wrench: FloatArray) -> FloatArray:
        """Return the (n, 3) deflection [m] by the copy that the intervals are centred on."""
        if not hasattr(self, "model_"):
            raise NotFittedError("SplitConformal: call fit before predict")
        predicted = np.asarray(self.model_.predict(q, wrench))
        check_prediction(predicted, len(q))
        return predicted

    def predict_interval(self, q: FloatArray, wrench: FloatArray, coverage: float) -> Interval:
        """Return each deflection's interval of probability `coverage`, axis by axis.

        `coverage` (0..1) may differ from the option. Intervals are wider away from the training
        samples; see `TrainingRange.widened`.

        Raises:
            NotFittedError: `fit` was not called.
            ModelError: `coverage` needs more calibration samples than there are.
        """
        if not hasattr(self, "residuals_"):
            raise NotFittedError("SplitConformal: call fit before predict_interval")
        return conformal_interval(
            self.predict, self.training_range_, self.residuals_, q, wrench, coverage
        )

    def _fraction(self, train: Samples) -> float:
        """Return the share of the poses to calibrate on."""
        poses = len(np.unique(train.pose_id))
        needed = calibration_samples_needed(self.coverage)
        if needed > poses // 2:
            raise TooFewToCalibrate(
                f"coverage {self.coverage:g} needs at least {needed} calibration samples of "
                f"different poses; half of the {poses} training poses are {poses // 2}"
            )
        count = min(max(math.ceil(SHARE * poses), needed), poses // 2)
        return (count - 0.5) / poses  # the division rounds up, and must not round past `count`


def conformal_interval(
    predict: Deflection,
    training_range: TrainingRange,
    residuals: FloatArray,
    q: FloatArray,
    wrench: FloatArray,
    coverage: float,
) -> Interval:
    """Return split-conformal intervals around predictions, m, per axis.

    Args:
        predict: (n, n_joints) q and (n, 6) wrench -> (n, 3) deflections, m.
        training_range: of the samples that `predict` learned from; far from them intervals are
            wider.
        residuals: (n_calibration, 3) errors at left-out poses, m, as `SplitConformal.residuals_`.
        q: (n, n_joints) rad or m.
        wrench: (n, 6) N and N m at the TCP, base frame.
        coverage: probability (0..1) on each axis.

    Raises:
        ModelError: `coverage` needs more residuals than there are.
    """
    needed = calibration_samples_needed(coverage)
    if len(residuals) < needed:
        raise ModelError(
            f"coverage {coverage:g} needs at least {needed} calibration samples, "
            f"there are {len(residuals)}"
        )

    def within(q: FloatArray, wrench: FloatArray) -> Interval:
        predicted = predict(q, wrench)
        return Interval(predicted - half, predicted + half, coverage)

    rank = math.ceil(coverage * (len(residuals) + 1) - ROUNDING)
    half = np.sort(residuals, axis=0)[rank - 1]
    return training_range.widened(within, q, wrench)
