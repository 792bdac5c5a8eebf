"""Where the tool centre point of a serial chain is."""

from __future__ import annotations

import numpy as np
from scipy.spatial.transform import Rotation

from stiff_protocols.contract.errors import DataError
from stiff_protocols.contract.types import FloatArray, Robot


def tcp_position(robot: Robot, q: FloatArray) -> FloatArray:
    """Return the position of the TCP in the robot base frame.

    Args:
        robot: the serial chain.
        q: (n, n_joints) joint positions, rad or m.

    Returns:
        (n, 3) m.

    Raises:
        DataError: `q` has another number of joints than the robot.
    """
    q = checked_positions(robot, q)
    point = np.tile(robot.tcp, (len(q), 1))  # (n, 3), in the frame of the joint that is reached
    for joint in reversed(range(robot.n_joints)):
        motion = q[:, joint, None] * robot.axes[joint]
        if robot.joint_types[joint] == "prismatic":
            point = point + motion
        else:
            point = Rotation.from_rotvec(motion).apply(point)
        placement = robot.placements[joint]
        point = point @ placement[:3, :3].T + placement[:3, 3]
    return point


def checked_positions(robot: Robot, q: FloatArray) -> FloatArray:
    """Return the joint positions as (n, n_joints) float64.

    Raises:
        DataError: `q` has another number of joints than the robot.
    """
    q = np.asarray(q, dtype=np.float64)
    if q.ndim != 2 or q.shape[1] != robot.n_joints:
        raise DataError(f"q has shape {q.shape}, expected (n, {robot.n_joints})")
    return q
