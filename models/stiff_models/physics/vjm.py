"""The linear virtual joint model (VJM): one torsion spring a joint.

With the Jacobian J at the TCP and its translational rows J_v, the deflection under a wrench w is
``d = J_v K^-1 J^T w = sum_i J_v,i (J_i^T w) c_i``, which is linear in the compliances
``c_i = 1/k_i``. They are identified by least squares, with a prior for those that the samples
cannot tell (`stiff_protocols.springs.identification`).
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import Any, Literal

import numpy as np

from stiff_models.fitted_model import FittedModel
from stiff_models.model_catalog import model_info
from stiff_models.physics.fitted_geometry import GeometryModel
from stiff_protocols.contract.errors import warn
from stiff_protocols.contract.types import FloatArray, Robot, Samples, TextArray
from stiff_protocols.kinematics.serial_chain import unit_deflections
from stiff_protocols.springs.identification import IdentifiedSprings, identify, typical_joints

Physics = Literal["vjm", "vjm-multisegment", "vjm-full"]
"""Keys of the virtual joint models: what other families build on."""


def fitted_physics(name: str, samples: Samples, robot: Robot) -> FittedModel:
    """Return the model with its default options, identified on the samples; errors as of `fit`.

    `name` is its key, of `Physics` or another.
    """
    fitted: FittedModel = model_info(name).load()().fit(samples, robot=robot)
    return fitted


def identify_springs(
    springs: Mapping[str, str],
    matrix: FloatArray,
    target: FloatArray,
    typical: FloatArray,
    pose_id: TextArray,
) -> IdentifiedSprings:
    """Identify springs by the one definition of `stiff_protocols.springs.identification`.

    Args:
        springs: units of the stiffnesses by the springs' names.
        matrix: (n, 3, n_springs) deflection [m] by each spring at unit compliance.
        target: (n, 3) measured deflection, m.
        typical: (n_springs,) typical compliances, up to one factor.
        pose_id: (n,) of the samples.

    Raises:
        ModelError: no spring can be identified.
    """
    pose = np.unique(pose_id, return_inverse=True)[1]
    rows = matrix.reshape(-1, len(springs))
    found = identify(rows, target.reshape(-1), typical, np.repeat(pose, 3))
    return IdentifiedSprings(**vars(found), names=tuple(springs), units=tuple(springs.values()))


def stiffness_unit(kind: str) -> str:
    """Return the unit of the stiffness of a joint of this type."""
    return "Nm/rad" if kind == "revolute" else "N/m"


def compliance_regressor(robot: Robot, q: FloatArray, wrench: FloatArray) -> FloatArray:
    """Return the (n, 3, n_joints) deflection [m] by each joint at unit compliance."""
    return unit_deflections(robot.jacobian(q), wrench)


def identify_joints(robot: Robot, samples: Samples) -> IdentifiedSprings:
    """Identify one spring per joint; ModelError if no joint can be identified."""
    matrix = compliance_regressor(robot, samples.q, samples.wrench)
    springs = dict(zip(robot.joint_names, map(stiffness_unit, robot.joint_types), strict=True))
    typical = typical_joints(robot)
    return identify_springs(springs, matrix, samples.deflection, typical, samples.pose_id)


@dataclass(kw_only=True, eq=False, repr=False)
class VirtualJointModel(GeometryModel):
    """The linear VJM as a model.

    Attributes:
        springs_: what was identified.
        diagnostics_: by name and unit: of each joint that the samples identify its stiffness,
            standard error and the ends of an interval that holds it with 90 % probability; of
            each other the prior's stiffness; rank and condition number; the fitted geometry.
    """

    def _fit(self, train: Samples, robot: Robot, validation: Samples | None, seed: int) -> None:
        train, robot = self._placed(train, robot, Robot.jacobian, unit_deflections)
        self.springs_ = identify_joints(robot, train)
        self.diagnostics_ = self.springs_.report() | self._geometry_report()
        warn_unidentifiable(self.springs_)
        warn_unexplained(self.springs_.compliance, train)

    def _deflection(self, robot: Robot, q: FloatArray, wrench: FloatArray) -> FloatArray:
        return robot.joint_deflection(self.springs_.compliance, q, wrench)


def warn_unidentifiable(springs: IdentifiedSprings, samples: str = "training samples") -> None:
    """Warn which springs these samples cannot identify."""
    if springs.unidentifiable:
        warn(
            f"joint stiffness not identifiable from the {samples}: "
            f"{', '.join(springs.unidentifiable)} (regressor rank {springs.rank} of "
            f"{len(springs.names)}); predictions use the prior's"
        )


def warn_no_masses(robot: Robot) -> None:
    """Warn that gears have no preload where the robot's masses are not known."""
    if not robot.masses.any():
        warn(
            f"robot {robot.name!r} has no masses: its springs are fitted as if nothing but "
            "the load turned them (gravity preload 0)"
        )


def warn_unexplained(compliance: FloatArray, samples: Samples) -> None:
    """Warn where every spring was found rigid."""
    if not compliance.any():
        warn(why_rigid(samples))


def why_rigid(samples: Samples) -> str:
    """Return why these samples make every spring rigid."""
    if not samples.deflection.any():
        return f"every deflection is zero in all {len(samples)} samples: every joint is rigid"
    return (
        "no joint spring explains any of the deflections: is the sign or the frame of the "
        "wrench wrong? `bench data validate` compares them"
    )


@dataclass(kw_only=True, eq=False, repr=False)
class OnPhysics:
    """Mixin before a learner: the learner's samples are the physics' residuals.

    A family is ``class VjmX(OnPhysics, X)``. Validation rows serve the learner alone.

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
