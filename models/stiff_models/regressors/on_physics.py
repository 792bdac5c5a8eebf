"""The one residual wrapper: physics + learner.

A family is ``class VjmX(OnPhysics, X)``: the physics is identified on the training samples, and X
learns what it leaves.
"""

from __future__ import annotations

import importlib
from dataclasses import dataclass, replace
from typing import Any, Literal, Self

from stiff_models.regressors.gp import GaussianProcessModel
from stiff_models.regressors.regressor_model import BoostingModel
from stiff_protocols.contract.types import FloatArray, Interval, Robot, Samples

Physics = Literal["vjm", "vjm-multisegment", "vjm-full"]

_CLASSES: dict[Physics, str] = {  # imported when used
    "vjm": "stiff_models.physics.vjm:VirtualJointModel",
    "vjm-multisegment": "stiff_models.physics.multi_segment_vjm:MultiSegmentVjm",
    "vjm-full": "stiff_models.physics.full_vjm:FullVjm",
}


@dataclass(kw_only=True, eq=False, repr=False)
class OnPhysics:
    """Mixin before a learner: the learner's samples are the physics' residuals.

    Attributes:
        physics: what is identified first, with its default options.
    """

    physics: Physics = "vjm"

    def fit(
        self,
        train: Samples,
        *,
        robot: Robot,
        validation: Samples | None = None,
        seed: int = 0,
    ) -> Self:
        """Identify the physics on `train`, then let the learner learn the residuals.

        `validation` serves the learner alone; the physics never sees it.

        Raises:
            ModelError: the physics cannot be identified or the learner cannot be fitted.
        """
        vars(self).pop("diagnostics_", None)  # an earlier fit's
        self.physics_ = physics_model(self.physics).fit(train, robot=robot, seed=seed)
        learner: Any = super()
        learner.fit(
            self._residual(train),
            robot=robot,
            validation=None if validation is None else self._residual(validation),
            seed=seed,
        )
        learned: dict[str, float] = vars(self).get("diagnostics_", {})
        self.diagnostics_ = {**self.physics_.diagnostics_, **learned}
        return self

    def _predict(self, q: FloatArray, wrench: FloatArray) -> FloatArray:
        learner: Any = super()
        residual: FloatArray = learner._predict(q, wrench)
        return self._explained(q, wrench) + residual

    def _explained(self, q: FloatArray, wrench: FloatArray) -> FloatArray:
        """Return the (n, 3) deflection by the physics alone, m."""
        deflection: FloatArray = self.physics_.predict(q, wrench)
        return deflection

    def _residual(self, samples: Samples) -> Samples:
        left = samples.deflection - self._explained(samples.q, samples.wrench)
        return replace(samples, deflection=left)

    def _shifted(self, interval: Interval, q: FloatArray, wrench: FloatArray) -> Interval:
        """Return a learner's interval of the residual as one of the deflection."""
        base = self._explained(q, wrench)
        return Interval(interval.lower + base, interval.upper + base, interval.coverage)


def physics_model(name: Physics) -> Any:
    """Return an unfitted physical model with its default options."""
    module, _, cls = _CLASSES[name].partition(":")
    return getattr(importlib.import_module(module), cls)()


@dataclass(kw_only=True, eq=False, repr=False)
class VjmGp(OnPhysics, GaussianProcessModel):
    """Physics plus a Gaussian-process residual."""

    def predict_interval(self, q: FloatArray, wrench: FloatArray, coverage: float) -> Interval:
        """Return the residual's interval around the physics; see `GaussianProcessModel`.

        The physics counts as known: its own uncertainty is not in the width.

        Raises:
            NotFittedError: `fit` was not called.
            ModelError: the shapes are not those of the robot fitted for.
        """
        return self._shifted(super().predict_interval(q, wrench, coverage), q, wrench)


@dataclass(kw_only=True, eq=False, repr=False)
class VjmBoosting(OnPhysics, BoostingModel):
    """Physics plus a gradient-boosting residual."""
