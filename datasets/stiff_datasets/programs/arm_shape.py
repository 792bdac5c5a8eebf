"""The shape of a six-axis arm: shoulder, elbow and wrist, as controllers tell them apart."""

from __future__ import annotations

import numpy as np

from stiff_protocols.contract.types import FloatArray, Robot


def arm_signs(robot: Robot, q: FloatArray, wrist_angle: FloatArray) -> FloatArray:
    """Return (n, 3) signs of an arm whose first axis is vertical and whose wrist axes meet.

    The first is 1 where the wrist centre is in front of axis 1, -1 where it is behind. The second
    is 1 where the elbow is above the line from joint 2 to the wrist centre for an arm that reaches
    forward (KUKA's joint 3 beyond the straight arm), else -1. The third is the sign of joint 5.

    Args:
        robot: of six joints.
        q: (n, 6) joint positions of the description, rad.
        wrist_angle: (n,) the controller's joint 5, rad.
    """
    stands = robot.forward(q)
    at_zero = robot.forward(np.zeros((1, robot.n_joints))).rotations[0, 0]
    turned = stands.rotations[:, 0] @ at_zero.T  # by joint 1 from its zero
    forward, sideways = turned[:, :, 0], turned[:, :, 1]
    points = stands.points
    axis, shoulder, elbow, wrist = points[:, 0], points[:, 1], points[:, 2], points[:, 4]
    reach = np.einsum("ni,ni->n", forward, wrist - axis)
    bend = np.einsum("ni,ni->n", sideways, np.cross(elbow - shoulder, wrist - elbow))
    sign = np.where(np.column_stack([reach, bend]) >= 0.0, 1.0, -1.0)
    return np.column_stack([sign, np.sign(wrist_angle)])
