"""`gp`: a Gaussian process from pose and load to deflection, one an axis."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from typing import Annotated, Protocol

import numpy as np
from annotated_types import Ge

from stiff_models.base import normal_interval
from stiff_models.regressors.gaussian_process import Covariance, GaussianProcess, Kernel, Search
from stiff_models.regressors.standardised_model import StandardisedModel
from stiff_protocols.contract.types import AXES, FloatArray, Interval, Robot, Samples


class AxisProcess(Protocol):
    """What predicts the deflection along an axis, standardised."""

    @property
    def noise(self) -> float:
        """Variance of a measured output's own error."""

    def between(self, inputs: FloatArray, others: FloatArray) -> FloatArray:
        """Return the (n, m) covariance at two sets of inputs, noise excluded."""


@dataclass(kw_only=True, eq=False, repr=False)
class GaussianProcessModel(StandardisedModel):
    """Gaussian-process regression, one process an axis.

    Attributes:
        kernel: "matern" (Matern 5/2) or "rbf" (squared exponential).
        ard: one length scale per feature; else all features share one.
        restarts: searches for the hyperparameters from random starts, after the first.
        search_rows: training rows that the search uses at most (drawn at random); the
            process itself always learns from all of them.
        processes_: one an axis.
    """

    kernel: Kernel = "matern"
    ard: bool = True
    restarts: Annotated[int, Ge(0)] = 1
    search_rows: Annotated[int, Ge(2)] = 1000

    def _fit(self, train: Samples, robot: Robot, validation: Samples | None, seed: int) -> None:
        inputs, targets = self._standardised(robot, train)
        start, search = self._start(inputs.shape[1]), self._search(seed)
        self.processes_ = tuple(
            GaussianProcess.of(search.likeliest(start, inputs, axis), inputs, axis)
            for axis in targets.T
        )
        self.diagnostics_ = noise_in_mm(self.processes_, self.output_scaler_.scale)

    def predict_interval(self, q: FloatArray, wrench: FloatArray, coverage: float) -> Interval:
        """Return the central interval of each axis' predictive normal, its noise included.

        Arguments and errors as of `predict`; `coverage` (0..1) is of each axis alone.
        """
        q, wrench = self._checked(q, wrench)
        inputs, scaler = self._inputs(self.robot_, q, wrench), self.output_scaler_
        mean, deviation = scaler.undo(self._means(inputs)), self._deviations(inputs) * scaler.scale
        return normal_interval(mean, deviation, coverage)

    def covariance(
        self, q: FloatArray, wrench: FloatArray, other_q: FloatArray, other_wrench: FloatArray
    ) -> FloatArray:
        """Return how deflections go together, as `PredictsCovariance` says; errors as `predict`."""
        first = self._inputs(self.robot_, *self._checked(q, wrench))
        second = self._inputs(self.robot_, *self._checked(other_q, other_wrench))
        scale = self.output_scaler_.scale[:, None, None] ** 2
        return np.stack([one.between(first, second) for one in self._of_axes()]) * scale

    def noise_variance(self) -> FloatArray:
        """Return (3,) the variance of a measured deflection's own error, m²."""
        noise = np.array([one.noise for one in self._of_axes()])
        return np.asarray(noise * self.output_scaler_.scale**2)

    def _of_axes(self) -> Sequence[AxisProcess]:
        """Return what predicts each axis."""
        return self.processes_

    def _predict(self, q: FloatArray, wrench: FloatArray) -> FloatArray:
        return self.output_scaler_.undo(self._means(self._inputs(self.robot_, q, wrench)))

    def _means(self, inputs: FloatArray) -> FloatArray:
        """The predictive means (n, 3), standardised."""
        return np.stack([process.mean(inputs) for process in self.processes_], axis=1)

    def _deviations(self, inputs: FloatArray) -> FloatArray:
        """The predictive standard deviations (n, 3), standardised."""
        return np.stack([process.deviation(inputs) for process in self.processes_], axis=1)

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


def noise_in_mm(processes: Iterable[GaussianProcess], scale: FloatArray) -> dict[str, float]:
    """Standard deviation of each axis' noise; `scale` (3,) m is what targets were divided by."""
    return {
        f"noise {axis.upper()} [mm]": float(np.sqrt(process.covariance.noise) * size * 1e3)
        for axis, process, size in zip(AXES, processes, scale, strict=True)
    }
