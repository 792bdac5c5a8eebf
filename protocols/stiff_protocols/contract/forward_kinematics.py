"""Where the joints and the tool centre point (TCP) of a serial chain are."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.spatial.transform import Rotation

from stiff_protocols.contract.errors import DataError
from stiff_protocols.contract.types import FloatArray, Robot


@dataclass(frozen=True, eq=False)
class ChainPoses:
    """Where a chain stands at n joint positions, robot base frame.

    Attributes:
        points: (n, n_joints + 1, 3) origin of every joint, then the TCP, m.
        rotation: (n, 3, 3) orientation of the last joint's frame.
    """

    points: FloatArray
    rotation: FloatArray


def forward_kinematics(robot: Robot, q: FloatArray) -> ChainPoses:
    """Return where the robot's joints and TCP are at (n, n_joints) `q`, rad or m.

    Raises:
        DataError: `q` has another number of joints than the robot.
    """
    q = checked_positions(robot, q)
    rotation, origin = np.broadcast_to(np.eye(3), (len(q), 3, 3)), np.zeros((len(q), 3))
    points = np.empty((len(q), robot.n_joints + 1, 3))
    for joint, kind in enumerate(robot.joint_types):
        origin = origin + rotation @ robot.placements[joint, :3, 3]
        rotation = rotation @ robot.placements[joint, :3, :3]
        points[:, joint] = origin
        motion = q[:, joint, None] * robot.axes[joint]  # (n, 3) rad or m, joint frame
        if kind == "revolute":
            rotation = rotation @ Rotation.from_rotvec(motion).as_matrix()
        else:
            origin = origin + np.einsum("nij,nj->ni", rotation, motion)
    points[:, -1] = origin + rotation @ robot.tcp
    return ChainPoses(points, rotation)


def tcp_position(robot: Robot, q: FloatArray) -> FloatArray:
    """Return the (n, 3) position of the TCP [m]; as `forward_kinematics`."""
    return forward_kinematics(robot, q).points[:, -1]


def checked_positions(robot: Robot, q: FloatArray) -> FloatArray:
    """Return the joint positions as (n, n_joints) float64; DataError where they are not."""
    q = np.asarray(q, dtype=np.float64)
    if q.ndim != 2 or q.shape[1] != robot.n_joints:
        raise DataError(f"q has shape {q.shape}, expected (n, {robot.n_joints})")
    return q
