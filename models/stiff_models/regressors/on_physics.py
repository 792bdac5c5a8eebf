"""The one residual wrapper: the VJM is identified, and a learner learns what it leaves.

A family is ``class VjmX(OnPhysics, X)``.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any

from stiff_models.physics.vjm import Physics, fitted_physics
from stiff_models.regressors.gp import GaussianProcessModel
from stiff_models.regressors.regressor_model import BoostingModel
from stiff_protocols.contract.types import FloatArray, Robot, Samples
from stiff_protocols.springs.identification import IdentifiedSprings


@dataclass(kw_only=True, eq=False, repr=False)
class OnPhysics:
    """Mixin before a learner: the learner's samples are the physics' residuals.

    Validation rows serve the learner alone.

    Attributes:
        physics: model that is identified first, with its default options.
    """

    physics: Physics = "vjm"

    def _fit(self, train: Samples, robot: Robot, validation: Samples | None, seed: int) -> None:
        vars(self).pop("diagnostics_", None)  # an earlier fit's
        self.physics_ = fitted_physics(self.physics, train, robot)
        learner: Any = super()
        residuals = None if validation is None else self._residual(validation)
        learner._fit(self._residual(train), robot, residuals, seed)
        learned: dict[str, float] = vars(self).get("diagnostics_", {})
        self.diagnostics_ = {**self.physics_.diagnostics_, **learned}

    @property
    def springs_(self) -> IdentifiedSprings:
        """What was identified of the physics' springs."""
        found: IdentifiedSprings = self.physics_.springs_
        return found

    def _predict(self, q: FloatArray, wrench: FloatArray) -> FloatArray:
        learner: Any = super()
        residual: FloatArray = learner._predict(q, wrench)
        explained: FloatArray = self.physics_.predict(q, wrench)
        return explained + residual

    def _residual(self, samples: Samples) -> Samples:
        left = samples.deflection - self.physics_.predict(samples.q, samples.wrench)
        return replace(samples, deflection=left)


@dataclass(kw_only=True, eq=False, repr=False)
class VjmGp(OnPhysics, GaussianProcessModel):
    """Physics plus a Gaussian-process residual."""


@dataclass(kw_only=True, eq=False, repr=False)
class VjmBoosting(OnPhysics, BoostingModel):
    """Physics plus a gradient-boosting residual."""
