"""Split-conformal intervals for any model: how wrong is it on poses that it did not learn from?

The training side is divided by pose. A copy of the model is fitted to one part; the absolute
errors s_1 .. s_n on the other part give, for each axis alone, the half width of the interval: with
``k = ceil(c (n + 1))`` the k-th smallest of them. A new pose then lies inside with a probability
of c to c + 1/(n + 1), whatever the model (Lei et al. 2018, Distribution-free predictive inference
for regression, theorem 2.2).

That holds for exchangeable errors. The rows of one pose are not: so each calibration pose gives one
row, drawn at random (Dunn, Wasserman and Ramdas 2023, Distribution-free prediction sets for
two-layer hierarchical models, "subsampling once").
"""

from __future__ import annotations

import math
import warnings
from dataclasses import KW_ONLY, dataclass
from typing import Self

import numpy as np
from sklearn.base import BaseEstimator, clone

from stiff_protocols.contract.errors import ModelError, NotFittedError, TooFewToCalibrate
from stiff_protocols.contract.extras import require
from stiff_protocols.contract.interfaces import StiffnessModel
from stiff_protocols.contract.training_range import TrainingRange
from stiff_protocols.contract.types import AXES, FloatArray, Interval, Robot, Samples
from stiff_protocols.scoring.sanity import check_prediction
from stiff_protocols.splits.generators import inner_validation

SHARE = 0.25  # of the training side's poses
ROUNDING = 1e-12
"""1 - 0.9 is a little less than 0.1 in floating point, which would cost a calibration sample."""


def calibration_samples_needed(coverage: float) -> int:
    """Return how many calibration samples a finite interval needs: c / (1 - c), rounded up."""
    return math.ceil(1.0 / (1.0 - coverage + ROUNDING)) - 1


@dataclass(eq=False, repr=False)
class SplitConformal(BaseEstimator):  # type: ignore[misc]
    """A model with split-conformal intervals.

    Attributes:
        model: what is copied and fitted; it is left as it is.
        coverage: probability (0..1) that an interval is to have, of each axis alone.
        share: of the training poses that are calibrated on; more where `coverage` needs
            more, but never more than half.
        model_: the copy, fitted to the other poses.
        residuals_: (n, 3) m, absolute errors on one row of each calibration pose.
    """

    model: StiffnessModel
    _: KW_ONLY
    coverage: float = 0.9
    share: float = SHARE

    def fit(
        self, train: Samples, *, robot: Robot, validation: Samples | None = None, seed: int = 0
    ) -> Self:
        """Divide `train` by pose, fit a copy of the model to one part, calibrate on the other.

        `validation` is given to the model as it is, never calibrated on; `seed` is of the division
        and of the model.

        Raises:
            TooFewToCalibrate: `coverage` needs more calibration samples than half of the poses.
            ConfigError: crepes is not installed.
        """
        require("a split-conformal interval", "crepes")
        part = inner_validation(train, np.arange(len(train)), self._fraction(train), seed)
        self.model_ = clone(self.model)
        learned = train.take(part.train)
        self.model_.fit(learned, robot=robot, validation=validation, seed=seed)
        self.training_range_ = TrainingRange.of(learned)
        shuffled = np.random.default_rng(seed).permutation(part.validation)
        _, one_a_pose = np.unique(train.pose_id[shuffled], return_index=True)
        calibration = train.take(shuffled[one_a_pose])
        self.residuals_ = np.abs(
            self.predict(calibration.q, calibration.wrench) - calibration.deflection
        )
        return self

    def predict(self, q: FloatArray, wrench: FloatArray) -> FloatArray:
        """Return the (n, 3) deflection [m] by the copy that the intervals are centred on."""
        if not hasattr(self, "model_"):
            raise NotFittedError("SplitConformal: call fit before predict")
        predicted = np.asarray(self.model_.predict(q, wrench))
        check_prediction(predicted, len(q))
        return predicted

    def predict_interval(self, q: FloatArray, wrench: FloatArray, coverage: float) -> Interval:
        """Return where each deflection lies with probability `coverage`, axis by axis.

        `coverage` (0..1) may differ from what `fit` was prepared for. Beyond the range of what
        the copy learned from they are wider, as `TrainingRange.widened` says.

        Raises:
            NotFittedError: `fit` was not called.
            ModelError: `coverage` needs more calibration samples than there are.
        """
        if not hasattr(self, "residuals_"):
            raise NotFittedError("SplitConformal: call fit before predict_interval")
        needed = calibration_samples_needed(coverage)
        if len(self.residuals_) < needed:
            raise ModelError(
                f"coverage {coverage:g} needs at least {needed} calibration samples, "
                f"there are {len(self.residuals_)}"
            )

        def within(q: FloatArray, wrench: FloatArray) -> Interval:
            predicted = self.predict(q, wrench)
            bounds = [
                _bounds(predicted[:, axis], self.residuals_[:, axis], coverage)
                for axis in range(len(AXES))
            ]
            lower, upper = np.stack(bounds, axis=-1)
            return Interval(lower, upper, coverage)

        return self.training_range_.widened(within, q, wrench)

    def _fraction(self, train: Samples) -> float:
        """Return the share of the poses to calibrate on."""
        poses = len(np.unique(train.pose_id))
        needed = calibration_samples_needed(self.coverage)
        if needed > poses // 2:
            raise TooFewToCalibrate(
                f"coverage {self.coverage:g} needs at least {needed} calibration samples of "
                f"different poses; half of the {poses} training poses are {poses // 2}"
            )
        count = min(max(math.ceil(self.share * poses), needed), poses // 2)
        return (count - 0.5) / poses  # the division rounds up, and must not round past `count`


def _bounds(predicted: FloatArray, residuals: FloatArray, coverage: float) -> FloatArray:
    with warnings.catch_warnings():  # crepes changes the filters of the whole process on import
        from crepes import ConformalRegressor
    regressor = ConformalRegressor().fit(residuals)
    return np.asarray(regressor.predict_int(predicted, confidence=coverage - ROUNDING).T)
