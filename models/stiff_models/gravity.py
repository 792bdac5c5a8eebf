"""Torque of the links' weights on the joints."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from stiff_models.kinematics import jacobian
from stiff_protocols.forward_kinematics import checked_positions
from stiff_protocols.types import FloatArray, Robot


def gravity_torque(robot: Robot, q: FloatArray) -> FloatArray:
    """Return the torque that the links' weights exert on the joints.

    It has the sign of the loads' torque, and so the opposite one of the generalised gravity g(q)
    that drives must balance. A weight is a force at a centre of mass: J_com^T (m g), link by link.

    Args:
        robot: with masses; loads and tools it carries are not part of it.
        q: (n, n_joints) joint positions, rad or m.

    Returns:
        (n, n_joints) N m, or N at a prismatic joint.

    Raises:
        DataError: `q` has another number of joints than the robot.
    """
    q = checked_positions(robot, q)
    torque = np.zeros(q.shape)
    for link in range(robot.n_joints):
        upto = slice(link + 1)
        below = replace(
            robot,
            joint_names=robot.joint_names[upto],
            joint_types=robot.joint_types[upto],
            placements=robot.placements[upto],
            axes=robot.axes[upto],
            lower=robot.lower[upto],
            upper=robot.upper[upto],
            masses=robot.masses[upto],
            centres_of_mass=robot.centres_of_mass[upto],
            tcp=robot.centres_of_mass[link],
        )
        weight = robot.masses[link] * robot.gravity
        torque[:, upto] += weight @ jacobian(below, q[:, upto])[:, :3]
    return torque
