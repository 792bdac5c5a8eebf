"""`mf-gp`: co-kriging of a simulated virtual joint model (low fidelity) and the measurements."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Annotated, Self

import numpy as np
from annotated_types import Ge

from stiff_models.regressors.gaussian_process import Covariance, GaussianProcess, Search
from stiff_models.regressors.gp_model import GaussianProcessModel
from stiff_models.transfer.source_domain import PoseDesign, WrenchDesign, drawn_from
from stiff_models.transfer.source_model import SourceModel
from stiff_protocols.contract.types import AXES, FloatArray, Robot, Samples


def fit_co_kriging(
    low: Covariance,
    delta: Covariance,
    simulated: tuple[FloatArray, FloatArray],
    measured: tuple[FloatArray, FloatArray],
    search: Search,
    *,
    least: float = 0.0,
) -> GaussianProcess:
    """Fit the low fidelity, then the high fidelity with the low one as its trend.

    The search starts from `low`, the covariance of the low fidelity, and from `delta`, the
    covariance of the difference, whose noise is at least `least`. `simulated` and `measured` are
    (n, n_features) inputs and (n,) outputs of the low and the high fidelity. Errors are the same as
    for `GaussianProcess`.
    """
    low_process = GaussianProcess.of(search.likeliest(low, *simulated), *simulated)
    difference = search.likeliest(delta, *measured, low_process.mean(measured[0]), least=least)
    return GaussianProcess.of(difference, *measured, low_process)


@dataclass(kw_only=True, eq=False, repr=False)
class MultiFidelityGp(SourceModel, GaussianProcessModel):
    """Two-fidelity co-kriging, one process per axis.

    Its few simulated samples should lie near the measured samples. So the default source is a Sobol
    design over the training samples' ranges. With another robot's source the low fidelity is that
    robot's VJM, over its own samples' ranges.

    Attributes:
        source_samples: number of simulated samples, drawn at random from the simulated design with
            one wrench per pose, at most the design's number of poses. The training samples' poses
            and loads are added.
    """

    source_poses: PoseDesign = "sobol"
    source_wrenches: WrenchDesign = "sobol"
    restarts: Annotated[int, Ge(0)] = 0
    source_samples: Annotated[int, Ge(1)] = 256

    _low_starts: tuple[Covariance, ...] = field(default=(), init=False)

    def _for_a_fold(self) -> Self:
        copy = super()._for_a_fold()
        # simulated samples of nearly the same springs: the search ends after a few steps
        copy._low_starts = tuple(level.trend.covariance for level in self.processes_)
        return copy

    def _fit(self, train: Samples, robot: Robot, validation: Samples | None, seed: int) -> None:
        inputs, targets = self._trained_rows(robot, train)
        origin = self._origin(train, robot)
        teacher = self._teacher(origin.samples, origin.robot)
        drawn_q, drawn_wrench = drawn_from(
            self._design(origin.samples, origin.robot, seed),
            self.source_samples,
            np.random.default_rng(seed),
        )
        # nested designs: the low fidelity is also simulated at the measured samples
        q, wrench = np.vstack([drawn_q, train.q]), np.vstack([drawn_wrench, train.wrench])
        cheap_inputs = self._features(robot, q, wrench)
        cheap = self.output_scaler_.apply(teacher(q, wrench))
        lows = self._low_starts or (self._start(inputs.shape[1], noise=False),) * len(AXES)
        levels = tuple(
            fit_co_kriging(
                lows[axis],
                self._start(inputs.shape[1]),
                (cheap_inputs, cheap[:, axis]),
                (inputs, targets[:, axis]),
                self._search(seed),
                least=least,
            )
            for axis, least in enumerate(self._least_noise())
        )
        self.processes_ = levels
        rho = {f"rho {a.upper()}": level.rho for a, level in zip(AXES, levels, strict=True)}
        self.diagnostics_ = rho | self._noise_in_mm()
