"""`gp`, `vjm-gp`: a Gaussian process from pose and load to deflection, or to its residual."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Annotated, Self

import numpy as np
from annotated_types import Ge

from stiff_models.networks.encoded_model import EncodedModel
from stiff_models.physics.vjm import OnPhysics
from stiff_models.regressors.calibrated_process import CalibratedProcess
from stiff_models.regressors.gaussian_process import Covariance, GaussianProcess, Kernel, Search
from stiff_protocols.contract.types import AXES, FloatArray, Robot, Samples


@dataclass(kw_only=True, eq=False, repr=False)
class GaussianProcessModel(CalibratedProcess, EncodedModel):
    """Gaussian-process regression, one process per axis.

    Attributes:
        kernel: covariance function of the standardised samples.
        ard: one length scale per feature; else all features share one.
        restarts: searches for the hyperparameters from random starts, after the first.
        search_rows: most training rows of the search (drawn at random); the process itself always
            uses all rows.
        processes_: one `GaussianProcess` per axis.
    """

    kernel: Kernel = "matern"
    ard: bool = True
    restarts: Annotated[int, Ge(0)] = 1
    search_rows: Annotated[int, Ge(2)] = 1000

    def _for_a_fold(self) -> Self:
        """Return an unfitted copy that is faster to fit, with one search."""
        copy: Self = super()._for_a_fold().set_params(restarts=0)
        return copy

    def _fit(self, train: Samples, robot: Robot, validation: Samples | None, seed: int) -> None:
        inputs, targets = self._trained_rows(robot, train)
        start, search = self._start(inputs.shape[1]), self._search(seed)
        self.processes_ = tuple(
            GaussianProcess.of(search.likeliest(start, inputs, axis, least=least), inputs, axis)
            for axis, least in zip(targets.T, self._least_noise(), strict=True)
        )
        self.diagnostics_ = self._noise_in_mm()

    def covariance(
        self, q: FloatArray, wrench: FloatArray, other_q: FloatArray, other_wrench: FloatArray
    ) -> FloatArray:
        """Return the covariance of deflections as `StiffnessModel`; errors as in `predict`."""
        first = self._features(self.robot_, *self._checked(q, wrench))
        second = self._features(self.robot_, *self._checked(other_q, other_wrench))
        scale = (self.calibration_ * self.output_scaler_.scale)[:, None, None] ** 2
        return np.stack([process.between(first, second) for process in self.processes_]) * scale

    def noise_variance(self) -> FloatArray:
        """Return the (3,) variances of a measured deflection's error, m²."""
        noise = np.array([process.covariance.noise for process in self.processes_])
        noise *= (self.calibration_ * self.output_scaler_.scale) ** 2
        return np.asarray(np.maximum(noise, self.instrument_noise_**2))

    def _predict(self, q: FloatArray, wrench: FloatArray) -> FloatArray:
        inputs = self._features(self.robot_, q, wrench)
        means = np.stack([process.mean(inputs) for process in self.processes_], axis=1)
        return self.output_scaler_.undo(means)

    def _uncalibrated(self, q: FloatArray, wrench: FloatArray) -> tuple[FloatArray, FloatArray]:
        inputs = self._features(self.robot_, q, wrench)
        deviations = np.stack([process.deviation(inputs) for process in self.processes_], axis=1)
        return self._predict(q, wrench), np.asarray(deviations * self.output_scaler_.scale)

    def _noise_in_mm(self) -> dict[str, float]:
        """Return the standard deviation of each axis' noise, by name and unit."""
        return {
            f"noise {axis.upper()} [mm]": float(np.sqrt(process.covariance.noise) * size * 1e3)
            for axis, process, size in zip(
                AXES, self.processes_, self.output_scaler_.scale, strict=True
            )
        }

    def _least_noise(self) -> FloatArray:
        """Return the (3,) variance of the instrument's noise, standardised."""
        return np.asarray((self.instrument_noise_ / self.output_scaler_.scale) ** 2)

    def _search(self, seed: int) -> Search:
        return Search(restarts=self.restarts, rows=self.search_rows, seed=seed)

    def _start(self, n_features: int) -> Covariance:
        """Return the search's start."""
        return Covariance(
            self.kernel,
            variance=1.0,
            # standardised samples lie about sqrt(2 n_features) apart
            lengths=np.full(n_features if self.ard else 1, np.sqrt(n_features)),
            noise=0.1,
            jitter=1e-10,
        )


@dataclass(kw_only=True, eq=False, repr=False)
class VjmGp(OnPhysics, GaussianProcessModel):
    """Physics plus a Gaussian-process residual."""
