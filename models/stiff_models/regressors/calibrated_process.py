"""Calibrate intervals of Gaussian processes at left-out poses."""

from __future__ import annotations

import warnings
from abc import abstractmethod
from collections.abc import Iterator
from dataclasses import dataclass
from typing import Annotated, Self

import numpy as np
from annotated_types import Gt

from stiff_models.fitted_model import NormalModel
from stiff_models.pose_folds import left_out_fifths
from stiff_protocols.contract.errors import ModelError, StiffBenchWarning
from stiff_protocols.contract.types import AXES, FloatArray, Robot, Samples

FEWEST_POSES = 10
"""Fewer poses are not divided: two of eight poses do not give a standard deviation."""
TRACKER_NOISE = 1e-5
"""m, standard deviation of a laser tracker's readings, for data whose card states no noise."""
ONE_DEVIATION = 0.6826894921370859
"""Coverage of a normal interval that reaches one standard deviation to either side."""


@dataclass(kw_only=True, eq=False, repr=False)
class CalibratedProcess(NormalModel):
    """Base of the families with calibrated standard deviations; list it before other bases.

    The process is fitted again without each fifth of the poses. Its standard deviations are
    multiplied by the root mean square of the left-out errors, in units of the deviations there.
    Those deviations are widened beyond the fold's training range. Standard deviations are never
    below the instrument's.

    Attributes:
        instrument_noise_mm: least standard deviation of a measured deflection per axis, mm. None:
            the value of the data card (`Samples.instrument_noise`), else 0.01, a laser tracker's.
            Without a bound the likelihood finds 2e-5 mm in few samples. The repeats' differences
            are included.
        instrument_noise_: used value, m.
        calibration_: (3,) factors on the standard deviations of each axis.
    """

    instrument_noise_mm: Annotated[float, Gt(0.0)] | None = None

    def fit(
        self, train: Samples, *, robot: Robot, validation: Samples | None = None, seed: int = 0
    ) -> Self:
        """Fit as `FittedModel.fit`, and again without each fifth of the poses."""
        given = self.instrument_noise_mm
        stated = train.instrument_noise or TRACKER_NOISE
        self.instrument_noise_ = stated if given is None else given / 1000.0
        super().fit(train, robot=robot, validation=validation, seed=seed)
        self.calibration_ = np.ones(len(AXES))
        if errors := list(self._errors_of_folds(train, robot, validation, seed)):
            self.calibration_ = np.sqrt((np.vstack(errors) ** 2).mean(axis=0))
        return self

    def _errors_of_folds(
        self, train: Samples, robot: Robot, validation: Samples | None, seed: int
    ) -> Iterator[FloatArray]:
        """Yield the (n, 3) errors at left-out poses, in half widths of one deviation."""
        n_poses = len(np.unique(train.pose_id))
        if n_poses < FEWEST_POSES:
            return
        for learned, left_out in left_out_fifths(train, seed):
            copy = self._for_a_fold()
            copy.instrument_noise_ = self.instrument_noise_
            with warnings.catch_warnings():
                warnings.simplefilter("ignore", StiffBenchWarning)  # the whole fit already warned
                try:
                    super(CalibratedProcess, copy).fit(
                        learned, robot=robot, validation=validation, seed=seed
                    )
                except ModelError:  # too few poses are left for the physics
                    continue
            # widened as the intervals are, beyond the fold's training range, too
            copy.calibration_ = np.ones(len(AXES))
            interval = copy.predict_interval(left_out.q, left_out.wrench, ONE_DEVIATION)
            error = (interval.lower + interval.upper) / 2.0 - left_out.deflection
            yield 2.0 * error / (interval.upper - interval.lower)

    def _for_a_fold(self) -> Self:
        """Return an unfitted copy, which may be faster to fit."""
        from sklearn.base import clone  # slow, and a fitted model does not need it

        copy: Self = clone(self)
        return copy

    def _mean_and_deviation(
        self, q: FloatArray, wrench: FloatArray
    ) -> tuple[FloatArray, FloatArray]:
        mean, deviation = self._uncalibrated(q, wrench)
        return mean, np.maximum(deviation * self.calibration_, self.instrument_noise_)

    @abstractmethod
    def _uncalibrated(self, q: FloatArray, wrench: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Return (n, 3) m twice: the prediction, and its standard deviation before calibration."""
