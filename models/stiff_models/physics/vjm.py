"""The linear virtual joint model (VJM): one torsion spring per joint.

With the Jacobian J at the TCP and its translational rows J_v, the deflection under a wrench w is
``d = J_v K^-1 J^T w = sum_i J_v,i (J_i^T w) c_i``, which is linear in the compliances
``c_i = 1/k_i``. They are identified by least squares, with a prior for compliances that the samples
cannot determine (`stiff_protocols.springs.identification`). A mimic joint has no spring: it follows
its joint rigidly.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from functools import partial
from typing import Any

import numpy as np

from stiff_models.fitted_model import FittedModel
from stiff_models.model_catalog import SpringModel, model_info
from stiff_models.physics.fitted_geometry import GeometryModel
from stiff_protocols.contract.errors import warn
from stiff_protocols.contract.types import FloatArray, Robot, Samples
from stiff_protocols.kinematics.serial_chain import AT_TCP, unit_deflections
from stiff_protocols.springs.identification import IdentifiedSprings, identify, typical_joints


def fitted_physics(name: str, samples: Samples, robot: Robot) -> FittedModel:
    """Return the model with its default options, identified on the samples.

    `name` is the key of a `SpringModel` or of another model. Errors are the same as for `fit`.
    """
    fitted: FittedModel = model_info(name).load()().fit(samples, robot=robot)
    return fitted


def identify_springs(
    springs: Mapping[str, str],
    matrix: FloatArray,
    samples: Samples,
    typical: FloatArray,
) -> IdentifiedSprings:
    """Identify springs by the one definition of `stiff_protocols.springs.identification`.

    Args:
        springs: units of the stiffnesses by the springs' names.
        matrix: (n, 3, n_springs) deflection [m] by each spring at unit compliance.
        samples: the n samples.
        typical: (n_springs,) typical compliances, up to one factor.

    Raises:
        ModelError: no spring can be identified.
    """
    is_read = samples.is_read
    rows, target = samples.read(matrix)[is_read], samples.values[is_read]
    identified = identify(rows, target, typical, samples.pose_of_number)
    return IdentifiedSprings(
        **vars(identified), names=tuple(springs), units=tuple(springs.values())
    )


def stiffness_unit(kind: str) -> str:
    """Return the unit of the stiffness of a joint of this type."""
    return "Nm/rad" if kind == "revolute" else "N/m"


def compliance_regressor(
    robot: Robot, q: FloatArray, wrench: FloatArray, levers: FloatArray = AT_TCP
) -> FloatArray:
    """Return the (n, 3, n_joints) deflection [m] by each joint at unit compliance."""
    return unit_deflections(robot.jacobian(q), wrench, levers)


def identify_joints(robot: Robot, samples: Samples) -> IdentifiedSprings:
    """Identify one spring per joint; ModelError if no joint can be identified."""
    matrix = compliance_regressor(robot, samples.q, samples.wrench, samples.levers)
    springs = dict(zip(robot.joint_names, map(stiffness_unit, robot.joint_types), strict=True))
    typical = typical_joints(robot)
    return identify_springs(springs, matrix, samples, typical)


@dataclass(kw_only=True, eq=False, repr=False)
class VirtualJointModel(GeometryModel):
    """The linear VJM as a model.

    Attributes:
        springs_: identified springs.
        diagnostics_: numbers by name and unit. Identified joints have their stiffness, its standard
            error and the ends of its 90 % interval; other joints have the prior's stiffness. Rank,
            condition number and the fitted geometry follow.
    """

    def _fit(self, train: Samples, robot: Robot, validation: Samples | None, seed: int) -> None:
        regressor = partial(unit_deflections, levers=train.levers)
        train, robot = self._placed(train, robot, Robot.jacobian, regressor)
        self.springs_ = identify_joints(robot, train)
        self.diagnostics_ = self.springs_.report() | self._geometry_report()
        warn_unidentifiable(self.springs_)
        warn_unexplained(self.springs_.compliance, train)

    def _deflection(
        self, robot: Robot, q: FloatArray, wrench: FloatArray, levers: FloatArray = AT_TCP
    ) -> FloatArray:
        if levers.size:
            springs = compliance_regressor(robot, q, wrench, levers)
            return np.asarray(springs @ self.springs_.compliance)
        return robot.joint_deflection(self.springs_.compliance, q, wrench)


def warn_unidentifiable(springs: IdentifiedSprings, samples: str = "training samples") -> None:
    """Warn of springs that these samples cannot identify."""
    if springs.unidentifiable:
        warn(
            f"joint stiffness not identifiable from the {samples}: "
            f"{', '.join(springs.unidentifiable)} (regressor rank {springs.rank} of "
            f"{len(springs.names)}); predictions use the prior's stiffness"
        )


def warn_no_masses(robot: Robot) -> None:
    """Warn that gears have no preload if the robot's masses are unknown."""
    if not robot.has_masses:
        warn(
            f"robot {robot.name!r} has no masses: its springs are fitted without gravity preload; "
            "add the masses to the robot's description"
        )


def warn_unexplained(compliance: FloatArray, samples: Samples) -> None:
    """Warn if every identified spring is rigid."""
    if not compliance.any():
        warn(why_rigid(samples))


def why_rigid(samples: Samples) -> str:
    """Return why these samples make every spring rigid."""
    if not samples.deflection.any():
        return f"every deflection is zero in all {len(samples)} samples: every joint is rigid"
    return (
        "no joint spring explains any of the deflections: the sign or the frame of the wrench may "
        "be wrong; `bench data validate` compares them"
    )


@dataclass(kw_only=True, eq=False, repr=False)
class OnPhysics:
    """Mixin listed before a learner: the learner is trained on the physics' residuals.

    A family is ``class VjmX(OnPhysics, X)``. Only the learner uses validation rows.

    Attributes:
        physics: model that is identified first, with its default options.
    """

    physics: SpringModel = "vjm"

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
        """The physics' identified springs; AttributeError if it has none."""
        springs: IdentifiedSprings = self.physics_.springs_
        return springs

    def _predict(self, q: FloatArray, wrench: FloatArray) -> FloatArray:
        learner: Any = super()
        residual: FloatArray = learner._predict(q, wrench)
        explained: FloatArray = self.physics_.predict(q, wrench)
        return explained + residual

    def _residual(self, samples: Samples) -> Samples:
        residual = samples.deflection - self.physics_.predict(samples.q, samples.wrench)
        return replace(samples, deflection=residual)
