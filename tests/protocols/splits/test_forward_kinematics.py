"""Joint origins, TCP and orientation against Pinocchio."""

from __future__ import annotations

import numpy as np
import pinocchio as pin
import pytest

from made_robots import random_chain
from stiff_protocols.contract.errors import DataError
from stiff_protocols.contract.forward_kinematics import forward_kinematics, tcp_position

JOINTS = {
    "revolute": pin.JointModelRevoluteUnaligned,
    "prismatic": pin.JointModelPrismaticUnaligned,
}


def model_of(robot):
    """Pinocchio's model of the robot."""
    model, joint = pin.Model(), 0
    for kind, axis, placement in zip(robot.joint_types, robot.axes, robot.placements, strict=True):
        joint = model.addJoint(joint, JOINTS[kind](axis), pin.SE3(placement), f"j{joint}")
    return model


def assert_stands_where_pinocchio_puts_it(robot, model, q):
    found, data = forward_kinematics(robot, q), model.createData()
    np.testing.assert_array_equal(tcp_position(robot, q), found.points[:, -1])
    for position, points, rotation in zip(q, found.points, found.rotation, strict=True):
        pin.forwardKinematics(model, data, position)
        last = data.oMi[model.njoints - 1]
        np.testing.assert_allclose(points[-1], last.act(robot.tcp), atol=1e-12)
        np.testing.assert_allclose(rotation, last.rotation, atol=1e-12)
        for joint in range(robot.n_joints):
            if robot.joint_types[joint] == "revolute":  # a slide's frame moves along
                np.testing.assert_allclose(
                    points[joint], data.oMi[joint + 1].translation, atol=1e-12
                )


def test_it_equals_pinocchios_at_random_poses_of_the_kr10(kr10, kr10_chain, rng):
    q = rng.uniform(kr10.lower, kr10.upper, size=(200, 6))
    assert_stands_where_pinocchio_puts_it(kr10, kr10_chain.model, q)


@pytest.mark.parametrize(
    "kinds",
    [
        ("revolute",),
        ("prismatic",),
        ("revolute", "prismatic", "revolute"),
        ("prismatic", "revolute", "revolute", "prismatic", "revolute", "revolute", "revolute"),
    ],
)
def test_it_equals_pinocchios_on_chains_that_turn_and_slide(kinds, rng):
    robot = random_chain(rng, kinds)
    q = rng.uniform(-3.0, 3.0, size=(50, len(kinds)))
    assert_stands_where_pinocchio_puts_it(robot, model_of(robot), q)


def test_wrong_number_of_joint_angles_is_refused(kr10):
    with pytest.raises(DataError, match=r"\(2, 5\), expected \(n, 6\)"):
        tcp_position(kr10, np.zeros((2, 5)))
