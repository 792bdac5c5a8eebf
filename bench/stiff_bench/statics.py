"""Statics of a robot's poses: which torques the joints bear."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from stiff_models.kinematics import jacobian
from stiff_protocols.types import BenchmarkData, FloatArray, Robot


def load_torque(data: BenchmarkData) -> FloatArray:
    """Return J^T w: the (n, n_joints) torque [N m] (force [N]) that the loads exert on joints."""
    rows = jacobian(data.robot, data.samples.q)  # (n, 6, n_joints)
    return np.asarray(np.einsum("nij,ni->nj", rows, data.samples.wrench))


def gravity_torque(robot: Robot, q: FloatArray) -> FloatArray:
    """Return the torque that the links' weights exert on the joints.

    It has the sign of the loads' torque, and so the opposite one of the generalised gravity g(q)
    that drives must balance. A weight is a force at a centre of mass: J_com^T (m g), link by link.

    Args:
        robot: with masses; loads and tools it carries are not part of it.
        q: (n, n_joints) joint positions, rad or m.

    Returns:
        (n, n_joints) N m, or N at a prismatic joint.
    """
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
