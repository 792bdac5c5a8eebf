"""Check poses, Jacobians, weights, springs and inverse kinematics against Pinocchio."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pinocchio as pin
import pytest

from helpers.made_robots import random_chain
from stiff_protocols.contract.errors import DataError
from stiff_protocols.kinematics.serial_chain import unit_deflections
from stiff_protocols.kinematics.straight_line import CHUNK

JOINTS = {
    "revolute": pin.JointModelRevoluteUnaligned,
    "prismatic": pin.JointModelPrismaticUnaligned,
}
SPRINGS = [getattr(pin, f"JointModel{kind}{axis}") for kind in "RP" for axis in "XYZ"]
MIXED = ("revolute", "prismatic", "revolute", "revolute", "prismatic", "revolute", "revolute") * 2
GRAVITY = np.array([1.0, 2.0, -9.0])
CHAINS = [
    ("revolute",),
    ("prismatic",),
    ("revolute", "prismatic", "revolute"),
    ("prismatic", "revolute", "revolute", "prismatic", "revolute", "revolute", "revolute"),
]


@pytest.fixture(params=CHAINS, ids="-".join)
def chain(request, rng):
    """Return a chain with masses, 50 of its positions, and Pinocchio's model of it."""
    robot = random_chain(rng, request.param)
    n = robot.n_joints
    masses, centres = rng.uniform(1.0, 9.0, n), rng.normal(size=(n, 3))
    robot = replace(robot, masses=masses, centres_of_mass=centres, gravity=GRAVITY)
    model, joint = pin.Model(), 0
    model.gravity.linear = GRAVITY
    for kind, axis, placement in zip(robot.joint_types, robot.axes, robot.placements, strict=True):
        joint = model.addJoint(joint, JOINTS[kind](axis), pin.SE3(placement), f"j{joint}")
        inertia = robot.masses[joint - 1], robot.centres_of_mass[joint - 1], np.eye(3)
        model.appendBodyToJoint(joint, pin.Inertia(*inertia), pin.SE3.Identity())
    return robot, rng.uniform(-3.0, 3.0, size=(50, n)), model


def test_joints_and_tcp_are_where_pinocchio_puts_them(chain):
    robot, q, model = chain
    frames, data = robot.forward(q), model.createData()
    np.testing.assert_allclose(robot.tcp_position(q), frames.points[:, -1], atol=1e-15)
    for position, points, rotations in zip(q, frames.points, frames.rotations, strict=True):
        pin.forwardKinematics(model, data, position)
        places = [data.oMi[joint + 1] for joint in range(robot.n_joints)]
        truth = [*(place.translation for place in places), places[-1].act(robot.tcp)]
        np.testing.assert_allclose(points, truth, atol=1e-12)
        np.testing.assert_allclose(rotations, [place.rotation for place in places], atol=1e-12)


def test_points_of_the_last_link_move_as_pinocchio_moves_them_under_a_wrench_at_the_tcp(chain, rng):
    robot, q, model = chain
    data, step = model.createData(), 1e-6
    compliance, wrench = rng.uniform(1.0, 2.0, robot.n_joints), rng.normal(size=(len(q), 6))
    offsets = rng.normal(size=(len(q), 3))  # from the TCP, last joint's frame
    levers = np.einsum("nij,nj->ni", robot.forward(q).rotation, offsets)
    moved = unit_deflections(robot.jacobian(q), wrench, levers) @ compliance
    for position, load, offset, deflection in zip(q, wrench, offsets, moved, strict=True):
        pin.computeJointJacobians(model, data, position)
        tcp = pin.SE3(np.eye(3), robot.tcp)
        rows = pin.getFrameJacobian(model, data, robot.n_joints, tcp, pin.LOCAL_WORLD_ALIGNED)
        turn, places = step * compliance * (rows.T @ load), []
        for sign in (1.0, -1.0):
            pin.forwardKinematics(model, data, position + sign * turn)
            places.append(data.oMi[robot.n_joints].act(robot.tcp + offset))
        truth = (places[0] - places[1]) / (2.0 * step)
        np.testing.assert_allclose(deflection, truth, atol=1e-6 * max(1.0, np.abs(truth).max()))


def test_gravity_torque_is_what_pinocchios_drives_balance(chain):
    robot, q, model = chain
    data = model.createData()
    truth = [-pin.computeGeneralizedGravity(model, data, position) for position in q]
    np.testing.assert_allclose(robot.gravity_torque(q), truth, atol=1e-10)


def with_virtual_joints(robot):
    """Return Pinocchio's model with three turns and three slides after every joint."""
    model = pin.Model()
    parent, zero = 0, pin.SE3.Identity()
    own_columns, virtual_columns = [], []
    for i, kind in enumerate(robot.joint_types):
        aligned = joint_basis(robot.axes[i])
        placement = pin.SE3(robot.placements[i]) * pin.SE3(aligned, np.zeros(3))
        previous_basis = joint_basis(robot.axes[i - 1]) if i else np.eye(3)
        placement = pin.SE3(previous_basis.T, np.zeros(3)) * placement
        joint = pin.JointModelRZ() if kind == "revolute" else pin.JointModelPZ()
        parent = model.addJoint(parent, joint, placement, f"joint {i}")
        own_columns.append(model.joints[parent].idx_v)
        columns = []
        for k, spring in enumerate(SPRINGS):
            parent = model.addJoint(parent, spring(), zero, f"virtual {i} {k}")
            columns.append(model.joints[parent].idx_v)
        virtual_columns.append(columns)
    tcp = joint_basis(robot.axes[-1]).T @ robot.tcp
    model.addFrame(pin.Frame("tcp", parent, 0, pin.SE3(np.eye(3), tcp), pin.FrameType.OP_FRAME))
    return model, own_columns, virtual_columns


def joint_basis(axis):
    """Return a basis as columns: x and y across the axis, z along it.

    If the axis is an axis of the URDF frame, so are x and y.
    """
    helper = np.eye(3)[np.argmin(np.abs(axis))]
    x = np.cross(helper, axis) / np.linalg.norm(np.cross(helper, axis))
    return np.column_stack([x, np.cross(axis, x), axis])


def assert_relatively_equal(actual, truth):
    assert np.abs(actual - truth).max() <= 1e-12 * np.abs(truth).max()


@pytest.mark.parametrize("n_joints", [1, 2, 5, 8])
def test_own_and_virtual_joints_move_the_tcp_as_pinocchios_model_with_both(n_joints, kr10, rng):
    for robot in (kr10, *(random_chain(rng, MIXED[:n_joints]) for _ in range(5))):
        model, own_columns, virtual_columns = with_virtual_joints(robot)
        data = model.createData()
        q = rng.uniform(-3, 3, size=(20, robot.n_joints))
        rows = zip(q, robot.jacobian(q), robot.virtual_jacobian(q), strict=True)
        for pose, twists, virtual_twists in rows:
            position = pin.neutral(model)
            position[own_columns] = pose
            frame = model.getFrameId("tcp")
            truth = pin.computeFrameJacobian(model, data, position, frame, pin.LOCAL_WORLD_ALIGNED)
            assert_relatively_equal(twists, truth[:, own_columns])
            assert_relatively_equal(virtual_twists, truth[:, virtual_columns])


def test_virtual_axes_are_those_of_the_urdf_frame_where_the_joints_axis_is_one_of_them(kr10):
    # at q = 0 the KR10's joint frames all lie like the base: every axis is one of the base's
    turns = kr10.virtual_jacobian(np.zeros((1, 6)))[0, 3:, :, :3]  # (xyz, joint, axis)
    np.testing.assert_allclose(np.sort(np.abs(turns), axis=0)[:2], 0.0, atol=1e-15)
    np.testing.assert_allclose(np.abs(turns).sum(axis=2), 1.0, atol=1e-15)


@pytest.mark.parametrize(
    "kinds", [*CHAINS, ("revolute",) * 6], ids=lambda kinds: "".join(kind[0] for kind in kinds)
)
def test_deflection_is_the_product_of_the_jacobians(kinds, rng):
    robot = random_chain(rng, kinds)
    compliance = rng.uniform(0.1, 1.0, size=robot.n_joints)
    compliance[1:2] = 0.0  # one joint is rigid where there are several
    q, wrench = rng.uniform(-3, 3, size=(60, robot.n_joints)), rng.normal(size=(60, 6))
    rows = robot.jacobian(q)
    truth = np.einsum("nai,i,nbi,nb->na", rows[:, :3], compliance, rows, wrench)
    deflection = robot.joint_deflection(compliance, q, wrench)
    np.testing.assert_allclose(deflection, truth, rtol=0, atol=1e-13 * np.abs(truth).max())


def test_inverse_gives_positions_at_which_the_tcp_has_each_pose_it_reaches(kr10, rng):
    q = rng.uniform(0.6 * kr10.lower, 0.6 * kr10.upper, size=(20, 6))
    targets = kr10.forward(q)
    position = targets.points[:, -1].copy()
    position[7] = 5.0, 0.0, 0.0
    solutions, reached = kr10.inverse(
        position, targets.rotation, q + rng.normal(scale=0.05, size=q.shape)
    )
    np.testing.assert_array_equal(reached, np.arange(20) != 7)
    frames = kr10.forward(solutions)
    np.testing.assert_allclose(frames.points[reached, -1], position[reached], atol=1e-8)
    np.testing.assert_allclose(frames.rotation[reached], targets.rotation[reached], atol=2e-8)


def test_a_batch_of_several_chunks_equals_its_rows_one_at_a_time(kr10, rng):
    q = rng.uniform(kr10.lower, kr10.upper, size=(CHUNK + 7, 6))
    batch = kr10.jacobian(q)
    for row in (0, CHUNK - 1, CHUNK, CHUNK + 6):
        np.testing.assert_allclose(batch[row], kr10.jacobian(q[row : row + 1])[0], atol=1e-15)


def test_no_pose_has_no_numbers(kr10):
    none = np.empty((0, 6))
    assert kr10.forward(none).points.shape == (0, 7, 3)
    assert kr10.jacobian(none).shape == (0, 6, 6)
    assert kr10.virtual_jacobian(none).shape == (0, 6, 6, 6)


def test_joint_angles_springs_wrenches_and_poses_of_another_shape_are_refused(kr10):
    q, wrench, eyes = np.zeros((2, 6)), np.zeros((2, 6)), np.stack([np.eye(3)] * 2)
    position = np.zeros((2, 3))
    for call, message in (
        (lambda: kr10.jacobian(q[:, :5]), r"\(2, 5\), expected \(n, 6\)"),
        (lambda: kr10.joint_deflection(np.ones(5), q, wrench), "compliance has shape"),
        (lambda: kr10.joint_deflection(np.ones(6), q, wrench[:1]), "wrench has shape"),
        (lambda: kr10.inverse(position[:1], eyes, q), "position has shape"),
        (lambda: kr10.inverse(np.nan * position, eyes, q), "position.*is nan"),
        (lambda: kr10.inverse(position, eyes[:1], q), "rotation has shape"),
    ):
        with pytest.raises(DataError, match=message):
            call()
