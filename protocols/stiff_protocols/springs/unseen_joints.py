"""Find joints whose springs no measurement shows: no load turns them, or no reading shows the turn.

Under hanging weights a vertical joint has no torque, so nothing tells how stiff it is.
"""

from __future__ import annotations

from itertools import compress

import numpy as np

from stiff_protocols.contract.arrays import BoolArray, FloatArray
from stiff_protocols.contract.robot import Robot
from stiff_protocols.contract.types import read_along
from stiff_protocols.kinematics.serial_chain import AT_TCP, unit_deflections
from stiff_protocols.springs.identification import LEAST_LEVER, RANK_TOLERANCE

LEAST_SHARE = 1e-3
"""Of the largest deflection by a joint with the largest lever; a joint with less is not shown."""


def unseen_joints_texts(
    robot: Robot,
    q: FloatArray,
    wrench: FloatArray,
    directions: FloatArray,
    levers: FloatArray = AT_TCP,
) -> list[str]:
    """Return a text on joints that no load turns, and one on joints whose turn is not read.

    A joint that no force at the TCP can turn is not named.

    Args:
        robot: the measured robot.
        q: (n, n_joints) joint positions, rad or m.
        wrench: (n, 6) N and N m at the TCP, base frame.
        directions: (n, m, 3) as `Samples.directions`; empty: x, y and z.
        levers: (n, 3) as `Samples.levers`.
    """
    jacobian = robot.jacobian(q)
    lever = np.linalg.norm(jacobian[:, :3], axis=1).max(axis=0)
    matters = ~robot.turns | (lever > LEAST_LEVER * float(lever[robot.turns].max(initial=0.0)))
    moved = unit_deflections(jacobian, wrench)  # (n, 3, n_joints)
    is_turned = ~unseen_columns(moved, LEAST_SHARE)
    read_columns = read_along(directions, unit_deflections(jacobian, wrench, levers))
    is_read = ~unseen_columns(read_columns, LEAST_SHARE)
    texts = []
    if unloaded := _names(robot, matters & ~is_turned):
        is_vertical = not np.linalg.norm(wrench[:, :2], axis=1).any()
        pull = "a horizontal pull" if is_vertical else "a pull in another direction"
        texts.append(f"no load turns {unloaded}: add {pull}")
    if unread := _names(robot, matters & is_turned & ~is_read):
        texts.append(f"no reading shows a turn of {unread}: read along another direction")
    return texts


def unseen_columns(columns: FloatArray, least_share: float = RANK_TOLERANCE) -> BoolArray:
    """Return (p,) true for (n, m, p) columns no longer than a share of the longest."""
    size = np.linalg.norm(columns, axis=(0, 1))
    return np.asarray(size <= least_share * float(size.max(initial=0.0)))


def _names(robot: Robot, joints: BoolArray) -> str:
    return ", ".join(compress(robot.joint_names, joints))
