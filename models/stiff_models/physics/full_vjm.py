"""The full virtual joint model: springs about, and along, all axes of every joint.

Joints also tilt in their bearings, and links bend. With virtual joints in all axes of every joint's
frame the compliance is ``C = J_t K_t^-1 J_t^T`` and the deflection under a wrench w is

    d = sum_s J_v,s (J_s^T w) c_s

over the virtual springs s. It follows Pashkevich, Klimchik and Chablat, "Enhanced stiffness
modeling of manipulators with passive joints", 2011; their springs are coupled 6 x 6 matrices, here
they are diagonal. Springs of neighbouring joints partly have the same effect, so some cannot be
identified. Those springs have the prior's stiffness. SI: rad, N, N m, m.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import partial
from typing import Literal

import numpy as np

from stiff_models.physics.fitted_geometry import GeometryModel
from stiff_models.physics.vjm import identify_springs, stiffness_unit, warn_unexplained
from stiff_protocols.contract.errors import warn
from stiff_protocols.contract.types import FloatArray, Robot, Samples
from stiff_protocols.kinematics.serial_chain import AT_TCP, unit_deflections
from stiff_protocols.springs.identification import (
    RANK_TOLERANCE,
    least_compliance,
    spread_positions,
    typical_compliance,
)

Springs = Literal[3, 6]

_TURNS, _SLIDES = ("rx", "ry", "rz"), ("x", "y", "z")  # in the order of `virtual_jacobian`

TURN_RATIO, SLIDE_RATIO = 8.0, 100.0
"""Prior stiffness of virtual joints, divided by the stiffness of the joint itself. In published
identifications, bearings are 1 to 8 times stiffer in tilt than their gears in rotation. Along its
axes a bearing has about 1e8 N/m, the tip of an arm 1e6 N/m."""


@dataclass(kw_only=True, eq=False, repr=False)
class FullVjm(GeometryModel):
    """The full VJM as a model.

    Attributes:
        springs: virtual springs per joint: 3 of the joint's kind (about the axes of a revolute
            joint's moving frame, or along the axes of a prismatic joint's) or all 6. z is the
            joint's axis.
        solver: "nnls" gives non-negative compliances, with a prior for compliances that the samples
            cannot determine. "ridge" gives small compliances of either sign over the directions
            that the samples resolve; generalised cross-validation on the training samples sets its
            strength.
        springs_: identified springs, by names such as "A2 rx" (about x) and "A2 x" (along x).
        compliance_: (n_springs,) rad/(N m) or m/N: the compliances of `springs_`. With "ridge" they
            differ, and only the sum of their effects is meaningful.
        diagnostics_: numbers of springs and of springs not identifiable, the report of
            `IdentifiedSprings` (with "ridge" without stiffnesses), and the fitted geometry.
    """

    springs: Springs = 3
    solver: Literal["nnls", "ridge"] = "nnls"

    def _fit(self, train: Samples, robot: Robot, validation: Samples | None, seed: int) -> None:
        twists_of = partial(spring_twists, springs=self.springs)
        regressor = partial(unit_deflections, levers=train.levers)
        train, robot = self._placed(train, robot, twists_of, regressor)
        matrix = spring_regressor(robot, train.q, train.wrench, self.springs, train.levers)
        units, typical = spring_units(robot, self.springs), typical_springs(robot, self.springs)
        identified = identify_springs(units, matrix, train, typical)
        n_springs = len(identified.names)
        self.springs_ = identified
        if self.solver == "ridge":
            is_read = train.is_read
            rows, target = train.read(matrix)[is_read], train.values[is_read]
            self.compliance_ = least_compliance(rows, target, ridge)
            numbers = {"rank": float(identified.rank), "condition number": identified.condition}
        else:
            self.compliance_ = identified.compliance
            numbers = identified.report()
        self.diagnostics_ = {
            "springs": float(n_springs),
            "springs not identifiable": float(len(identified.unidentifiable)),
            **numbers,
            **self._geometry_report(),
        }
        warn_few_samples(train, n_springs)
        warn_unexplained(self.compliance_, train)

    def _deflection(
        self, robot: Robot, q: FloatArray, wrench: FloatArray, levers: FloatArray = AT_TCP
    ) -> FloatArray:
        regressor = spring_regressor(robot, q, wrench, self.springs, levers)
        return np.asarray(regressor @ self.compliance_)


def warn_few_samples(samples: Samples, n_springs: int) -> None:
    """Warn if the samples have fewer equations than there are springs."""
    n_equations = int(samples.is_read.sum())
    if n_equations < n_springs:
        warn(
            f"{len(samples)} training samples give {n_equations} equations for {n_springs} "
            "springs: predictions at other poses and loads are unreliable"
        )


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

    A bearing is sized with its gear, so the joint's lever also counts across its axis.
    """
    move = robot.virtual_jacobian(spread_positions(robot))[:, :3, :, [2, 5]]
    turns = np.tile([True, False], robot.n_joints)
    joint_compliance = typical_compliance(move.reshape(len(move), 3, -1), turns).reshape(-1, 2)
    typical = np.repeat(joint_compliance / (TURN_RATIO, SLIDE_RATIO), 3, axis=1)
    for joint, kind in enumerate(robot.joint_types):
        turn = kind == "revolute"
        typical[joint, 2 if turn else 5] = joint_compliance[joint, 0 if turn else 1]
    return np.asarray(typical.ravel()[spring_columns(robot, springs)])


def spring_regressor(
    robot: Robot,
    q: FloatArray,
    wrench: FloatArray,
    springs: Springs,
    levers: FloatArray = AT_TCP,
) -> FloatArray:
    """Return the (n, 3, n_joints * springs) deflection [m] by each spring at unit compliance.

    Args:
        robot: the serial chain.
        q: (n, n_joints) joint positions, rad or m.
        wrench: (n, 6) N and N m at the TCP, base frame.
        springs: virtual springs per joint.
        levers: (n, 3) as `Samples.levers`.
    """
    return unit_deflections(spring_twists(robot, q, springs), wrench, levers)


def spring_twists(robot: Robot, q: FloatArray, springs: Springs) -> FloatArray:
    """Return the (n, 6, n_joints * springs) twists of the TCP by a unit motion of each spring.

    Arguments are the same as for `spring_regressor`.
    """
    joint, axis = np.divmod(spring_columns(robot, springs), 6)
    return robot.virtual_jacobian(q)[:, :, joint, axis]


def spring_columns(robot: Robot, springs: Springs) -> list[int]:
    """Return the columns with springs among `virtual_jacobian`'s six per joint."""
    first = [3 if kind == "prismatic" and springs < 6 else 0 for kind in robot.joint_types]
    return [6 * joint + start + k for joint, start in enumerate(first) for k in range(springs)]


def ridge(scaled: FloatArray, target: FloatArray) -> FloatArray:
    """Return the ridge solution over the directions that the regressor resolves.

    Its strength minimises the generalised cross-validation criterion (Golub, Heath and Wahba
    1979). The weakest shrinks nothing by more than a millionth; the strongest halves every part.
    """
    from scipy.optimize import minimize_scalar  # slow, and predictions do without

    left_vectors, singular, axes = np.linalg.svd(scaled, full_matrices=False)
    resolved = singular > RANK_TOLERANCE * singular[0]
    left_vectors, squares = left_vectors[:, resolved], singular[resolved] ** 2
    projected = left_vectors.T @ target  # the target's part that any spring can explain
    unexplained = max(float(target @ target - projected @ projected), 0.0)

    def criterion(log_strength: float) -> float:
        shrinkage = np.exp(log_strength) / (squares + np.exp(log_strength))
        degrees = len(target) - len(squares) + shrinkage.sum()
        return float((unexplained + ((shrinkage * projected) ** 2).sum()) / degrees**2)

    grid = np.log(np.geomspace(1e-6 * squares[-1], squares[0], 100))
    best = min(range(len(grid)), key=lambda i: criterion(float(grid[i])))
    around = (grid[max(best - 1, 0)], grid[min(best + 1, len(grid) - 1)])
    strength = np.exp(minimize_scalar(criterion, bounds=around, method="bounded").x)
    return np.asarray(axes[resolved].T @ (singular[resolved] / (squares + strength) * projected))
