"""The full virtual joint model: springs at every joint about, and along, all its axes.

Joints also tilt in their bearings and links bend. With virtual joints in all axes of every joint's
frame the compliance is ``C = J_t K_t^-1 J_t^T`` and the deflection under a wrench w is

    d = sum_s J_v,s (J_s^T w) c_s

over the virtual springs s (after Pashkevich, Klimchik and Chablat, "Enhanced stiffness modeling of
manipulators with passive joints", 2011, whose springs are coupled 6 x 6 matrices; here they are
diagonal). Springs of neighbouring joints partly do the same, so never all can be identified: the
singular values of the column-scaled regressor say how many can. SI: rad, N, N m, m.
"""

from __future__ import annotations

import warnings
from dataclasses import dataclass
from typing import Literal

import numpy as np

from stiff_models.base import FittedModel
from stiff_models.physics.identification import identify, ridge
from stiff_models.physics.kinematics import unit_deflections, virtual_jacobian
from stiff_models.physics.vjm import warn_unexplained
from stiff_protocols.contract.errors import StiffBenchWarning
from stiff_protocols.contract.identification import Solver, nonnegative
from stiff_protocols.contract.types import FloatArray, Robot, Samples

Springs = Literal[3, 6]

SOLVERS: dict[str, Solver] = {"nnls": nonnegative, "ridge": ridge}

_TURNS, _SLIDES = ("rx", "ry", "rz"), ("x", "y", "z")  # in the order of `virtual_jacobian`


@dataclass(kw_only=True, eq=False, repr=False)
class FullVjm(FittedModel):
    """The full VJM as a model; a load's own stiffness (congruence) is left out.

    Attributes:
        springs: virtual springs per joint: 3 of the joint's kind (about the axes of a revolute
            joint's moving frame, along those of a prismatic one's) or all 6. z is the joint's axis.
        solver: "nnls" finds compliances that are not negative; "ridge" small ones of either sign,
            over the directions that the samples resolve, its strength by generalised
            cross-validation on the training samples.
        springs_: names of the springs, such as "A2 rx" (about x) and "A2 x" (along x).
        compliance_: (n_springs,) rad/(N m) or m/N. Of springs that cannot be told apart only the
            sum of their effects on the samples means anything.
        unidentifiable_: names of the springs that the training samples cannot identify.
        diagnostics_: how many springs were found and identified, rank and condition number.
    """

    springs: Springs = 3
    solver: Literal["nnls", "ridge"] = "nnls"

    def _fit(self, train: Samples, robot: Robot, validation: Samples | None, seed: int) -> None:
        regressor = spring_regressor(robot, train.q, train.wrench, self.springs)
        matrix = regressor.reshape(-1, regressor.shape[2])
        found = identify(matrix, train.deflection.reshape(-1), SOLVERS[self.solver])
        self.springs_ = spring_names(robot, self.springs)
        self.compliance_ = found.compliance
        self.unidentifiable_ = tuple(
            name for name, known in zip(self.springs_, found.known, strict=True) if not known
        )
        n_springs = len(self.springs_)
        self.diagnostics_ = {
            "springs": float(n_springs),
            "springs not zero": float(np.count_nonzero(found.compliance)),
            "springs not identifiable": float(len(self.unidentifiable_)),
            "rank": float(found.rank),
            "condition number": found.condition,
        }
        if len(matrix) < n_springs:
            warnings.warn(
                f"{len(train)} training samples give {len(matrix)} equations for {n_springs} "
                f"springs (regressor rank {found.rank}): predictions at other poses and loads "
                "are unreliable",
                StiffBenchWarning,
                stacklevel=3,
            )
        warn_unexplained(found.compliance, train)

    def _predict(self, q: FloatArray, wrench: FloatArray) -> FloatArray:
        regressor = spring_regressor(self.robot_, q, wrench, self.springs)
        return np.asarray(regressor @ self.compliance_)


def spring_names(robot: Robot, springs: Springs) -> tuple[str, ...]:
    """Return the names of the springs, in the order of `spring_regressor`."""
    kinds = _TURNS + _SLIDES
    return tuple(
        f"{name} {kinds[k]}"
        for name, columns in zip(robot.joint_names, _columns(robot, springs), strict=True)
        for k in columns
    )


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
    twists = virtual_jacobian(robot, q)  # (n, 6, n_joints, 6)
    rows = np.concatenate(
        [twists[:, :, joint, columns] for joint, columns in enumerate(_columns(robot, springs))],
        axis=2,
    )
    return unit_deflections(rows, wrench)


def _columns(robot: Robot, springs: Springs) -> list[list[int]]:
    """Return, joint by joint, which virtual joints of `virtual_jacobian` have springs."""
    turns, slides = [0, 1, 2], [3, 4, 5]
    if springs == 6:
        return [turns + slides] * robot.n_joints
    return [turns if kind == "revolute" else slides for kind in robot.joint_types]
