"""A robot's kinematics and weights against Pinocchio."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pinocchio as pin
import pytest

from helpers.made_robots import random_chain
from stiff_models.physics import kinematics
from stiff_protocols.contract.errors import DataError

JOINTS = {
    "revolute": pin.JointModelRevoluteUnaligned,
    "prismatic": pin.JointModelPrismaticUnaligned,
}
CHAINS = [
    ("revolute",),
    ("prismatic",),
    ("revolute", "prismatic", "revolute"),
    ("prismatic", "revolute", "revolute", "prismatic", "revolute", "revolute", "revolute"),
]


@pytest.fixture(params=CHAINS, ids="-".join)
def chain(request, rng):
    """A chain with masses, 50 of its positions, and Pinocchio's model of it."""
    robot = random_chain(rng, request.param)
    n = robot.n_joints
    robot = replace(robot, masses=rng.uniform(1.0, 9.0, n), centres_of_mass=rng.normal(size=(n, 3)))
    model, joint = pin.Model(), 0
    for kind, axis, placement in zip(robot.joint_types, robot.axes, robot.placements, strict=True):
        joint = model.addJoint(joint, JOINTS[kind](axis), pin.SE3(placement), f"j{joint}")
        inertia = robot.masses[joint - 1], robot.centres_of_mass[joint - 1], np.eye(3)
        model.appendBodyToJoint(joint, pin.Inertia(*inertia), pin.SE3.Identity())
    return robot, rng.uniform(-3.0, 3.0, size=(50, n)), model


def test_joints_links_and_tcp_are_where_pinocchio_puts_them(chain):
    robot, q, model = chain
    found, data = robot.forward(q), model.createData()
    np.testing.assert_array_equal(robot.tcp_position(q), found.tcp[:, :3, 3])
    for position, links, tcp in zip(q, found.links, found.tcp, strict=True):
        pin.forwardKinematics(model, data, position)
        places = [data.oMi[joint + 1].homogeneous for joint in range(robot.n_joints)]
        np.testing.assert_allclose(links, places, atol=1e-12)
        tool = pin.SE3(places[-1]) * pin.SE3(np.eye(3), robot.tcp)
        np.testing.assert_allclose(tcp, tool.homogeneous, atol=1e-12)


def test_jacobian_is_pinocchios_and_that_of_the_fast_kinematics(chain):
    robot, q, model = chain
    found = robot.jacobian(q)
    last = pin.Frame("tcp", model.njoints - 1, 0, pin.SE3(np.eye(3), robot.tcp), pin.OP_FRAME)
    tcp = model.addFrame(last)
    for position, rows in zip(q, found, strict=True):
        truth = pin.computeFrameJacobian(
            model, model.createData(), position, tcp, pin.LOCAL_WORLD_ALIGNED
        )
        np.testing.assert_allclose(rows, np.reshape(truth, rows.shape), atol=1e-12)
    np.testing.assert_allclose(found, kinematics.jacobian(robot, q), atol=1e-12)


def test_gravity_torque_is_what_pinocchios_drives_balance(chain):
    robot, q, model = chain
    data = model.createData()
    truth = [-pin.computeGeneralizedGravity(model, data, position) for position in q]
    np.testing.assert_allclose(robot.gravity_torque(q), truth, atol=1e-10)
    np.testing.assert_allclose(
        robot.gravity_torque(q), kinematics.gravity_torque(robot, q), atol=1e-10
    )


def test_inverse_gives_positions_at_which_the_tcp_has_each_pose_it_reaches(kr10, rng):
    q = rng.uniform(0.6 * kr10.lower, 0.6 * kr10.upper, size=(20, 6))
    wanted = kr10.forward(q)
    position = wanted.points[:, -1].copy()
    position[7] = 5.0, 0.0, 0.0
    found, reached = kr10.inverse(
        position, wanted.rotation, q + rng.normal(scale=0.05, size=q.shape)
    )
    np.testing.assert_array_equal(reached, np.arange(20) != 7)
    stands = kr10.forward(found)
    np.testing.assert_allclose(stands.points[reached, -1], position[reached], atol=1e-8)
    np.testing.assert_allclose(stands.rotation[reached], wanted.rotation[reached], atol=2e-8)


def test_poses_and_numbers_of_joint_angles_that_are_none_are_refused(kr10):
    position, rotation, seed = np.zeros((2, 3)), np.stack([np.eye(3)] * 2), np.zeros((2, 6))
    for places, named in ((position[:1], "has shape"), (np.nan * position, "is nan")):
        with pytest.raises(DataError, match=f"position.*{named}"):
            kr10.inverse(places, rotation, seed)
    with pytest.raises(DataError, match="rotation has shape"):
        kr10.inverse(position, rotation[:1], seed)
    for method in (kr10.forward, kr10.jacobian, kr10.gravity_torque, kr10.tcp_position):
        with pytest.raises(DataError, match=r"\(2, 5\), expected \(n, 6\)"):
            method(np.zeros((2, 5)))


def test_robot_and_samples_print_in_five_lines_at_most(kr10):
    from stiff_datasets.twin.kr10_twin import Kr10Twin

    for thing in (kr10, Kr10Twin().load().samples):
        assert len(repr(thing).splitlines()) <= 5
        assert max(map(len, repr(thing).splitlines())) < 200
