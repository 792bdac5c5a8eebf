"""`gp`: a Gaussian process from pose and load to deflection, one an axis."""

from __future__ import annotations

import warnings
from collections.abc import Iterator
from dataclasses import dataclass
from typing import Annotated, Any, Self

import numpy as np
from annotated_types import Ge, Gt
from sklearn.base import clone

from stiff_models.base import left_out_fifths, normal_interval
from stiff_models.regressors.gaussian_process import Covariance, GaussianProcess, Kernel, Search
from stiff_models.regressors.standardised_model import StandardisedModel
from stiff_protocols.contract.errors import ModelError, StiffBenchWarning
from stiff_protocols.contract.types import AXES, FloatArray, Interval, Robot, Samples

FEWEST_POSES = 10
"""Fewer are not divided: two of eight poses hold no standard deviation."""
TRACKER_NOISE = 1e-5
"""m, standard deviation of a laser tracker's readings: of data whose card states no noise."""
ONE_DEVIATION = 0.6826894921370859
"""Coverage of a normal interval that reaches one standard deviation to either side."""


@dataclass(kw_only=True, eq=False, repr=False)
class GaussianProcessModel(StandardisedModel):
    """Gaussian-process regression, one process an axis.

    Hyperparameters that are the likeliest ones for a hundred samples make the process too sure of
    itself. So it is fitted again without each fifth of the poses, and its standard deviations are
    multiplied by the root mean square of the errors there, in units of the deviations there. These
    are widened beyond the fold's training range, as every interval is. They are never below the
    instrument's.

    Attributes:
        kernel: "matern" (Matern 5/2) or "rbf" (squared exponential).
        ard: one length scale per feature; else all features share one.
        restarts: searches for the hyperparameters from random starts, after the first.
        search_rows: training rows that the search uses at most (drawn at random); the
            process itself always learns from all of them.
        instrument_noise_mm: the least standard deviation of a measured deflection an axis, mm, that
            is looked for; None: what the data card states (`Samples.instrument_noise`), else 0.01,
            a laser tracker's. Without it the likelihood finds 2e-5 mm in few samples. What
            repeats differ by is found there.
        instrument_noise_: m, what was taken.
        processes_: one `GaussianProcess` an axis, or what predicts as it does.
        calibration_: (3,) what the standard deviations of each axis are multiplied by.
    """

    kernel: Kernel = "matern"
    ard: bool = True
    restarts: Annotated[int, Ge(0)] = 1
    search_rows: Annotated[int, Ge(2)] = 1000
    instrument_noise_mm: Annotated[float, Gt(0.0)] | None = None

    def fit(
        self, train: Samples, *, robot: Robot, validation: Samples | None = None, seed: int = 0
    ) -> Self:
        """Fit as `FittedModel.fit` says, and again without each fifth of the poses."""
        super().fit(train, robot=robot, validation=validation, seed=seed)
        self.calibration_ = np.ones(len(AXES))
        if errors := list(self._errors_of_folds(train, robot, validation, seed)):
            self.calibration_ = np.sqrt((np.vstack(errors) ** 2).mean(axis=0))
        return self

    def _errors_of_folds(
        self, train: Samples, robot: Robot, validation: Samples | None, seed: int
    ) -> Iterator[FloatArray]:
        """Yield the (n, 3) errors at poses that were left out, in half widths of one deviation."""
        n_poses = len(np.unique(train.pose_id))
        if n_poses < FEWEST_POSES:
            return
        for learned, left_out in left_out_fifths(train, seed):
            copy = self._for_a_fold()
            with warnings.catch_warnings():
                warnings.simplefilter("ignore", StiffBenchWarning)  # the whole fit has had its say
                try:
                    super(GaussianProcessModel, copy).fit(
                        learned, robot=robot, validation=validation, seed=seed
                    )
                except ModelError:  # too few poses are left for the physics
                    continue
            # as wide as an interval is there: beyond the fold's training range, too
            copy.calibration_ = np.ones(len(AXES))
            found = copy.predict_interval(left_out.q, left_out.wrench, ONE_DEVIATION)
            middle = (found.lower + found.upper) / 2.0
            yield 2.0 * (middle - left_out.deflection) / (found.upper - found.lower)

    def _for_a_fold(self) -> Self:
        """Return an unfitted copy that is fitted sooner: one search is enough there."""
        copy: Self = clone(self).set_params(restarts=0)
        return copy

    def _fit(self, train: Samples, robot: Robot, validation: Samples | None, seed: int) -> None:
        inputs, targets = self._standardised(robot, train)
        start, search = self._start(inputs.shape[1]), self._search(seed)
        self.processes_: tuple[Any, ...] = tuple(
            GaussianProcess.of(search.likeliest(start, inputs, axis, least=least), inputs, axis)
            for axis, least in zip(targets.T, self._least_noise(train), strict=True)
        )
        self.diagnostics_ = self._noise_in_mm()

    def predict_interval(self, q: FloatArray, wrench: FloatArray, coverage: float) -> Interval:
        """Return the central interval of each axis' predictive normal, its noise included.

        Arguments and errors as of `predict`; `coverage` (0..1) is of each axis alone. Beyond the
        training range it is wider, as `TrainingRange.widened` says.
        """

        def within(q: FloatArray, wrench: FloatArray) -> Interval:
            deviation = self._deviations(q, wrench) * self.calibration_
            deviation = np.maximum(deviation, self.instrument_noise_)
            return normal_interval(self._predict(q, wrench), deviation, coverage)

        return self.training_range_.widened(within, *self._checked(q, wrench))

    def covariance(
        self, q: FloatArray, wrench: FloatArray, other_q: FloatArray, other_wrench: FloatArray
    ) -> FloatArray:
        """Return how deflections go together, as `PredictsCovariance` says; errors as `predict`."""
        first = self._inputs(self.robot_, *self._checked(q, wrench))
        second = self._inputs(self.robot_, *self._checked(other_q, other_wrench))
        scale = (self.calibration_ * self.output_scaler_.scale)[:, None, None] ** 2
        return np.stack([one.between(first, second) for one in self.processes_]) * scale

    def noise_variance(self) -> FloatArray:
        """Return (3,) the variance of a measured deflection's own error, m²."""
        noise = np.array([one.noise for one in self.processes_])
        noise *= (self.calibration_ * self.output_scaler_.scale) ** 2
        return np.asarray(np.maximum(noise, self.instrument_noise_**2))

    def _predict(self, q: FloatArray, wrench: FloatArray) -> FloatArray:
        inputs = self._inputs(self.robot_, q, wrench)
        means = np.stack([process.mean(inputs) for process in self.processes_], axis=1)
        return self.output_scaler_.undo(means)

    def _deviations(self, q: FloatArray, wrench: FloatArray) -> FloatArray:
        """Return the predictive standard deviations (n, 3) m, before their calibration."""
        inputs = self._inputs(self.robot_, q, wrench)
        found = np.stack([process.deviation(inputs) for process in self.processes_], axis=1)
        return np.asarray(found * self.output_scaler_.scale)

    def _noise_in_mm(self) -> dict[str, float]:
        """Return the standard deviation of each axis' noise, by name and unit."""
        return {
            f"noise {axis.upper()} [mm]": float(np.sqrt(process.noise) * size * 1e3)
            for axis, process, size in zip(
                AXES, self.processes_, self.output_scaler_.scale, strict=True
            )
        }

    def _least_noise(self, train: Samples) -> FloatArray:
        """Take the instrument's noise, and return its (3,) variance, standardised."""
        given = self.instrument_noise_mm
        stated = train.instrument_noise or TRACKER_NOISE
        self.instrument_noise_ = stated if given is None else given / 1000.0
        return np.asarray((self.instrument_noise_ / self.output_scaler_.scale) ** 2)

    def _search(self, seed: int) -> Search:
        return Search(restarts=self.restarts, rows=self.search_rows, seed=seed)

    def _start(self, n_features: int, *, noise: bool = True) -> Covariance:
        """Return where the search starts; without `noise` the process interpolates."""
        return Covariance(
            self.kernel,
            variance=1.0,
            # standardised samples lie about sqrt(2 n_features) apart
            lengths=np.full(n_features if self.ard else 1, np.sqrt(n_features)),
            noise=0.1 if noise else 0.0,
            jitter=1e-10 if noise else 1e-8,
        )
