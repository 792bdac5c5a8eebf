"""The full virtual joint model: springs at every joint about, and along, all its axes.

Joints also tilt in their bearings and links bend. With virtual joints in all axes of every joint's
frame the compliance is ``C = J_t K_t^-1 J_t^T`` and the deflection under a wrench w is

    d = sum_s J_v,s (J_s^T w) c_s

over the virtual springs s (after Pashkevich, Klimchik and Chablat, "Enhanced stiffness modeling of
manipulators with passive joints", 2011, whose springs are coupled 6 x 6 matrices; here they are
diagonal). Springs of neighbouring joints partly do the same, so never all can be identified; those
that cannot have the prior's stiffness. SI: rad, N, N m, m.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import partial
from typing import Literal

import numpy as np
from scipy.optimize import minimize_scalar

from stiff_models.physics.fitted_geometry import GeometryModel
from stiff_models.physics.vjm import identify_springs, stiffness_unit, warn_unexplained
from stiff_protocols.contract.errors import warn
from stiff_protocols.contract.types import FloatArray, Robot, Samples
from stiff_protocols.kinematics.serial_chain import unit_deflections
from stiff_protocols.springs.identification import (
    RANK_TOLERANCE,
    least_compliance,
    spread_positions,
    typical_compliance,
)

Springs = Literal[3, 6]

_TURNS, _SLIDES = ("rx", "ry", "rz"), ("x", "y", "z")  # in the order of `virtual_jacobian`

TURN_RATIO, SLIDE_RATIO = 8.0, 100.0
"""Prior stiffness of virtual joints over that of the joint itself. Bearings tilt 1 to 8 times
stiffer than their gears turn, in published identifications. Along its axes a bearing hardly gives:
1e8 N/m, an arm 1e6 at its tip."""


@dataclass(kw_only=True, eq=False, repr=False)
class FullVjm(GeometryModel):
    """The full VJM as a model.

    Attributes:
        springs: virtual springs per joint: 3 of the joint's kind (about the axes of a revolute
            joint's moving frame, along those of a prismatic one's) or all 6. z is the joint's axis.
        solver: "nnls" finds compliances that are not negative, with a prior for those that the
            samples cannot tell; "ridge" small ones of either sign, over the directions that the
            samples resolve, its strength by generalised cross-validation on the training samples.
        springs_: what was identified, by names such as "A2 rx" (about x) and "A2 x" (along x).
        compliance_: (n_springs,) rad/(N m) or m/N: those of `springs_`; of "ridge" others, of
            which only the sum of their effects means anything.
        diagnostics_: how many springs there are and cannot be identified, and what
            `IdentifiedSprings` reports, of "ridge" no stiffnesses; the fitted geometry.
    """

    springs: Springs = 3
    solver: Literal["nnls", "ridge"] = "nnls"

    def _fit(self, train: Samples, robot: Robot, validation: Samples | None, seed: int) -> None:
        twists_of = partial(spring_twists, springs=self.springs)
        train, robot = self._placed(train, robot, twists_of, unit_deflections)
        matrix = spring_regressor(robot, train.q, train.wrench, self.springs)
        units, typical = spring_units(robot, self.springs), typical_springs(robot, self.springs)
        found = identify_springs(units, matrix, train.deflection, typical, train.pose_id)
        n_springs = len(found.names)
        self.springs_ = found
        if self.solver == "ridge":
            rows = matrix.reshape(-1, n_springs)
            self.compliance_ = least_compliance(rows, train.deflection.reshape(-1), ridge)
            numbers = {"rank": float(found.rank), "condition number": found.condition}
        else:
            self.compliance_ = found.compliance
            numbers = found.report()
        self.diagnostics_ = {
            "springs": float(n_springs),
            "springs not identifiable": float(len(found.unidentifiable)),
            **numbers,
            **self._geometry_report(),
        }
        if 3 * len(train) < n_springs:
            warn(
                f"{len(train)} training samples give {3 * len(train)} equations for {n_springs} "
                f"springs (regressor rank {found.rank}): predictions at other poses and loads "
                "are unreliable"
            )
        warn_unexplained(self.compliance_, train)

    def _deflection(self, robot: Robot, q: FloatArray, wrench: FloatArray) -> FloatArray:
        regressor = spring_regressor(robot, q, wrench, self.springs)
        return np.asarray(regressor @ self.compliance_)


def spring_units(robot: Robot, springs: Springs) -> dict[str, str]:
    """Return the units of the stiffnesses by the springs' names, in `spring_regressor`'s order."""
    kinds = [(name, "revolute") for name in _TURNS] + [(name, "prismatic") for name in _SLIDES]
    units = [
        (f"{joint} {name}", stiffness_unit(kind))
        for joint in robot.joint_names
        for name, kind in kinds
    ]
    return dict(units[k] for k in spring_columns(robot, springs))


def typical_springs(robot: Robot, springs: Springs) -> FloatArray:
    """Return the (n_joints * springs,) typical compliances, up to one factor.

    A bearing is sized with its gear: across its axis the lever of the joint counts, too.
    """
    move = robot.virtual_jacobian(spread_positions(robot))[:, :3, :, [2, 5]]
    turns = np.tile([True, False], robot.n_joints)
    own = typical_compliance(move.reshape(len(move), 3, -1), turns).reshape(-1, 2)
    typical = np.repeat(own / (TURN_RATIO, SLIDE_RATIO), 3, axis=1)
    for joint, kind in enumerate(robot.joint_types):
        turn = kind == "revolute"
        typical[joint, 2 if turn else 5] = own[joint, 0 if turn else 1]
    return np.asarray(typical.ravel()[spring_columns(robot, springs)])


def spring_regressor(
    robot: Robot, q: FloatArray, wrench: FloatArray, springs: Springs
) -> FloatArray:
    """Return the (n, 3, n_joints * springs) deflection [m] by each spring at unit compliance.

    Args:
        robot: the serial chain.
        q: (n, n_joints) joint positions, rad or m.
        wrench: (n, 6) N and N m at the TCP, base frame.
        springs: virtual springs a joint.
    """
    return unit_deflections(spring_twists(robot, q, springs), wrench)


def spring_twists(robot: Robot, q: FloatArray, springs: Literal[1, 3, 6]) -> FloatArray:
    """Return the (n, 6, n_joints * springs) twists of the TCP by a unit motion of each spring.

    Arguments as of `spring_regressor`; of 1 spring a joint it is the joint's own.
    """
    joint, own = np.divmod(spring_columns(robot, springs), 6)
    return robot.virtual_jacobian(q)[:, :, joint, own]


def spring_columns(robot: Robot, springs: Literal[1, 3, 6]) -> list[int]:
    """Return which virtual joints have springs, of `virtual_jacobian`'s six a joint in a row.

    Of 1 it is the joint's own.
    """
    kinds = {1: range(2, 3), 3: range(3), 6: range(6)}[springs]
    first = [3 if kind == "prismatic" and springs < 6 else 0 for kind in robot.joint_types]
    return [6 * joint + start + k for joint, start in enumerate(first) for k in kinds]


def ridge(scaled: FloatArray, target: FloatArray) -> FloatArray:
    """Return the ridge solution over the directions that the regressor resolves.

    Its strength minimises the generalised cross-validation criterion (Golub, Heath and Wahba
    1979), between one that shrinks nothing by more than a millionth and one that halves all.
    """
    left, singular, axes = np.linalg.svd(scaled, full_matrices=False)
    kept = singular > RANK_TOLERANCE * singular[0]
    left, squares = left[:, kept], singular[kept] ** 2
    seen = left.T @ target  # the target's part that any spring can explain
    unseen = max(float(target @ target - seen @ seen), 0.0)

    def criterion(log_strength: float) -> float:
        left_over = np.exp(log_strength) / (squares + np.exp(log_strength))
        degrees = len(target) - len(squares) + left_over.sum()
        return float((unseen + ((left_over * seen) ** 2).sum()) / degrees**2)

    grid = np.log(np.geomspace(1e-6 * squares[-1], squares[0], 100))
    best = min(range(len(grid)), key=lambda i: criterion(float(grid[i])))
    around = (grid[max(best - 1, 0)], grid[min(best + 1, len(grid) - 1)])
    strength = np.exp(minimize_scalar(criterion, bounds=around, method="bounded").x)
    return np.asarray(axes[kept].T @ (singular[kept] / (squares + strength) * seen))
