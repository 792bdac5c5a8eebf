"""Torque of the links' weights on the joints."""

from __future__ import annotations

from functools import lru_cache

import numpy as np

from stiff_models.chain import Chain
from stiff_models.kinematics import PROGRAMS_KEPT
from stiff_models.straight_line import Program, half_angle, tape_with
from stiff_protocols.forward_kinematics import checked_positions
from stiff_protocols.types import FloatArray, Robot


def gravity_torque(robot: Robot, q: FloatArray) -> FloatArray:
    """Return the torque that the links' weights exert on the joints.

    It has the sign of the loads' torque, and so the opposite one of the generalised gravity g(q)
    that drives must balance. Loads and tools that the robot carries are not part of it.

    Args:
        robot: with masses.
        q: (n, n_joints) joint positions, rad or m.

    Returns:
        (n, n_joints) N m, or N at a prismatic joint.

    Raises:
        DataError: `q` has another number of joints than the robot.
    """
    q = checked_positions(robot, q)
    torque = np.empty((robot.n_joints, len(q)))
    _program(robot).run([q], torque)
    return np.ascontiguousarray(torque.T)


@lru_cache(PROGRAMS_KEPT)
def _program(robot: Robot) -> Program:
    tape, (q,) = tape_with(robot.n_joints)
    return Program.of(tape, Chain.of(robot).gravity_torque(q, half_angle))
