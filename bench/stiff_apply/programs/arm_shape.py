"""Classify the shape of a six-axis arm: shoulder, elbow and wrist."""

from __future__ import annotations

import numpy as np

from stiff_protocols.contract.types import FloatArray, Robot


def arm_signs(robot: Robot, q: FloatArray, wrist_angle: FloatArray) -> FloatArray:
    """Return (n, 3) signs of an arm with vertical first axis and intersecting wrist axes.

    The first is 1 if the wrist centre is in front of axis 1, -1 if it is behind. The second is 1 if
    the elbow of a forward arm is above the line from joint 2 to the wrist centre (KUKA's joint 3
    beyond the straight arm), else -1. The third is the sign of joint 5.

    Args:
        robot: a robot with six joints.
        q: (n, 6) joint positions of the description, rad.
        wrist_angle: (n,) the controller's joint 5, rad.
    """
    link_poses = robot.forward(q)
    at_zero = robot.forward(np.zeros((1, robot.n_joints))).rotations[0, 0]
    turn_of_joint_1 = link_poses.rotations[:, 0] @ at_zero.T  # by joint 1 from its zero
    forward, sideways = turn_of_joint_1[:, :, 0], turn_of_joint_1[:, :, 1]
    points = link_poses.points
    axis, shoulder, elbow, wrist = points[:, 0], points[:, 1], points[:, 2], points[:, 4]
    reach = np.einsum("ni,ni->n", forward, wrist - axis)
    bend = np.einsum("ni,ni->n", sideways, np.cross(elbow - shoulder, wrist - elbow))
    sign = np.where(np.column_stack([reach, bend]) >= 0.0, 1.0, -1.0)
    return np.column_stack([sign, np.sign(wrist_angle)])
