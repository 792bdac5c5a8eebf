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
    cheap: tuple[FloatArray, FloatArray],
    dear: tuple[FloatArray, FloatArray],
    search: Search,
    *,
    least: float = 0.0,
) -> GaussianProcess:
    """Fit the low fidelity, and the high one with it as its trend; errors as of `GaussianProcess`.

    The search starts from `low`, the covariance of the low fidelity, and from `delta`, that of the
    difference, whose noise is at least `least`. `cheap` and `dear` are (n, n_features) inputs and
    (n,) outputs of the low and the high fidelity.
    """
    below = GaussianProcess.of(search.likeliest(low, *cheap), *cheap)
    between = search.likeliest(delta, *dear, below.mean(dear[0]), least=least)
    return GaussianProcess.of(between, *dear, below)


@dataclass(kw_only=True, eq=False, repr=False)
class MultiFidelityGp(SourceModel, GaussianProcessModel):
    """Two-fidelity co-kriging, one an axis.

    Its few simulated samples should lie where the measured ones do, so that the source is a Sobol
    design over the training samples' ranges unless another is asked for. With another robot's
    source the low fidelity is that robot's VJM, over its own samples' ranges.

    Attributes:
        source_samples: drawn at random from the simulated design, one wrench a pose, besides those
            at the training samples' poses and loads; at most as many as the design has poses.
    """

    source_poses: PoseDesign = "sobol"
    source_wrenches: WrenchDesign = "sobol"
    restarts: Annotated[int, Ge(0)] = 0
    source_samples: Annotated[int, Ge(1)] = 256

    _low_starts: tuple[Covariance, ...] = field(default=(), init=False)

    def _for_a_fold(self) -> Self:
        copy = super()._for_a_fold()
        # simulated samples of nearly the same springs: the search is over after a few steps
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
        # nested designs: the low fidelity is simulated where the high one was measured too
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
        rho = {f"rho {a.upper()}": one.rho for a, one in zip(AXES, levels, strict=True)}
        self.diagnostics_ = rho | self._noise_in_mm()
