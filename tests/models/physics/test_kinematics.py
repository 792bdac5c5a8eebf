"""Jacobians, the links' weights and joint springs against Pinocchio and products of Jacobians."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pinocchio as pin
import pytest

from helpers.made_robots import random_chain
from stiff_models.physics.kinematics import (
    compliance_matrix,
    gravity_torque,
    jacobian,
    joint_deflection,
    kinematic_hessian,
    virtual_jacobian,
)
from stiff_models.physics.straight_line import CHUNK
from stiff_protocols.contract.errors import DataError

SPRINGS = [getattr(pin, f"JointModel{kind}{axis}") for kind in "RP" for axis in "XYZ"]
MIXED = ("revolute", "prismatic", "revolute", "revolute", "prismatic", "revolute", "revolute") * 2


def with_tcp(chain):
    """Pinocchio's model of a shipped robot, and the number of its TCP."""
    model = chain.model.copy()
    at_tcp = pin.SE3(np.eye(3), chain.tcp)
    return model, model.addFrame(pin.Frame("truth_tcp", 6, 0, at_tcp, pin.FrameType.OP_FRAME))


def assert_relatively_equal(ours, truth):
    assert np.abs(ours - truth).max() <= 1e-12 * np.abs(truth).max()


def test_a_batch_of_several_chunks_equals_its_rows_one_at_a_time(kr10, rng):
    q = rng.uniform(kr10.lower, kr10.upper, size=(CHUNK + 7, 6))
    batch = jacobian(kr10, q)
    for row in (0, CHUNK - 1, CHUNK, CHUNK + 6):
        np.testing.assert_allclose(batch[row], jacobian(kr10, q[row : row + 1])[0], atol=1e-15)


@pytest.mark.parametrize("function", [jacobian, virtual_jacobian])
def test_no_pose_has_no_jacobian(function, kr10):
    assert function(kr10, np.empty((0, 6))).shape == (
        0,
        *function(kr10, np.zeros((1, 6))).shape[1:],
    )


@pytest.mark.parametrize("function", [jacobian, virtual_jacobian, gravity_torque])
def test_wrong_number_of_joint_angles_is_refused(function, kr10):
    with pytest.raises(DataError, match=r"\(2, 5\), expected \(n, 6\)"):
        function(kr10, np.zeros((2, 5)))


def test_kinematic_hessian_equals_pinocchios_time_variation_of_the_jacobian(kr10, kr10_chain, rng):
    model, tcp = with_tcp(kr10_chain)
    data = model.createData()
    q = rng.uniform(kr10.lower, kr10.upper, size=(20, 6))
    for pose, hessian in zip(q, kinematic_hessian(jacobian(kr10, q)), strict=True):
        for joint, velocity in enumerate(np.eye(6)):
            pin.computeJointJacobiansTimeVariation(model, data, pose, velocity)
            pin.updateFramePlacements(model, data)
            truth = pin.getFrameJacobianTimeVariation(model, data, tcp, pin.LOCAL_WORLD_ALIGNED)
            np.testing.assert_allclose(hessian[..., joint], truth, atol=1e-12)


def with_virtual_joints(robot):
    """Pinocchio's model of the chain with three turns and three slides after every joint."""
    model = pin.Model()
    parent, zero = 0, pin.SE3.Identity()
    own, virtual = [], []
    for i, kind in enumerate(robot.joint_types):
        aligned = joint_basis(robot.axes[i])
        placement = pin.SE3(robot.placements[i]) * pin.SE3(aligned, np.zeros(3))
        before = joint_basis(robot.axes[i - 1]) if i else np.eye(3)
        placement = pin.SE3(before.T, np.zeros(3)) * placement
        joint = pin.JointModelRZ() if kind == "revolute" else pin.JointModelPZ()
        parent = model.addJoint(parent, joint, placement, f"own {i}")
        own.append(model.joints[parent].idx_v)
        columns = []
        for k, spring in enumerate(SPRINGS):
            parent = model.addJoint(parent, spring(), zero, f"virtual {i} {k}")
            columns.append(model.joints[parent].idx_v)
        virtual.append(columns)
    tcp = joint_basis(robot.axes[-1]).T @ robot.tcp
    model.addFrame(pin.Frame("tcp", parent, 0, pin.SE3(np.eye(3), tcp), pin.FrameType.OP_FRAME))
    return model, own, virtual


def joint_basis(axis):
    """Columns: x and y across the axis (the URDF frame's own where it can be), z along it."""
    helper = np.eye(3)[np.argmin(np.abs(axis))]
    x = np.cross(helper, axis) / np.linalg.norm(np.cross(helper, axis))
    return np.column_stack([x, np.cross(axis, x), axis])


@pytest.mark.parametrize("n_joints", range(3, 9))
def test_own_and_virtual_joints_move_the_tcp_as_pinocchios_model_with_both(n_joints, kr10, rng):
    for robot in (kr10, *(random_chain(rng, MIXED[:n_joints]) for _ in range(5))):
        model, own, virtual = with_virtual_joints(robot)
        data = model.createData()
        q = rng.uniform(-3, 3, size=(20, robot.n_joints))
        found = zip(q, jacobian(robot, q), virtual_jacobian(robot, q), strict=True)
        for pose, twists, virtual_twists in found:
            position = pin.neutral(model)
            position[own] = pose
            frame = model.getFrameId("tcp")
            truth = pin.computeFrameJacobian(model, data, position, frame, pin.LOCAL_WORLD_ALIGNED)
            assert_relatively_equal(twists, truth[:, own])
            assert_relatively_equal(virtual_twists, truth[:, virtual])


def test_virtual_axes_are_those_of_the_urdf_frame_where_the_joints_axis_is_one_of_them(kr10, rng):
    # at q = 0 the KR10's joint frames all lie like the base: every axis is one of the base's
    turns = virtual_jacobian(kr10, np.zeros((1, 6)))[0, 3:, :, :3]  # (xyz, joint, axis)
    np.testing.assert_allclose(np.sort(np.abs(turns), axis=0)[:2], 0.0, atol=1e-15)
    np.testing.assert_allclose(np.abs(turns).sum(axis=2), 1.0, atol=1e-15)


@pytest.mark.parametrize("gravity", [(0.0, 0.0, -9.81), (9.81, 0.0, 0.0)], ids=["floor", "wall"])
def test_gravity_torque_opposes_pinocchios_generalised_gravity(gravity, kr10, kr10_chain, rng):
    model = kr10_chain.model.copy()
    model.gravity.linear = np.array(gravity)
    q = rng.uniform(kr10.lower, kr10.upper, size=(100, 6))
    truth = [-pin.computeGeneralizedGravity(model, model.createData(), pose) for pose in q]
    found = gravity_torque(replace(kr10, gravity=np.array(gravity)), q)
    np.testing.assert_allclose(found, truth, atol=1e-10)


KINDS = [
    ("revolute",) * 6,
    ("prismatic", "revolute", "prismatic", "revolute", "revolute"),
    ("revolute", "revolute", "prismatic"),
    ("prismatic",),
    ("prismatic", "prismatic"),
    ("revolute",) * 7,
]


@pytest.mark.parametrize("kinds", KINDS, ids=lambda kinds: "".join(kind[0] for kind in kinds))
def test_deflection_and_compliance_matrix_are_the_product_of_the_jacobians(kinds, rng):
    robot = random_chain(rng, kinds)
    compliance = rng.uniform(0.1, 1.0, size=robot.n_joints)
    compliance[1:2] = 0.0  # one joint is rigid where there are several
    q, wrench = rng.uniform(-3, 3, size=(60, robot.n_joints)), rng.normal(size=(60, 6))
    rows = jacobian(robot, q)
    matrices = (rows[:, :3] * compliance) @ rows.transpose(0, 2, 1)
    for found, truth in (
        (compliance_matrix(robot, compliance, q), matrices),
        (joint_deflection(robot, compliance, q, wrench), (matrices @ wrench[..., None])[..., 0]),
    ):
        np.testing.assert_allclose(found, truth, rtol=0, atol=1e-13 * np.abs(truth).max())


def test_springs_and_wrenches_of_another_number_are_refused(kr10):
    q, wrench = np.zeros((2, 6)), np.zeros((2, 6))
    for refused in (
        lambda: joint_deflection(kr10, np.ones(5), q, wrench),
        lambda: compliance_matrix(kr10, np.ones(5), q),
    ):
        with pytest.raises(DataError, match=r"compliance has shape \(5,\), expected \(6,\)"):
            refused()
    with pytest.raises(DataError, match=r"wrench has shape \(3, 6\), expected \(2, 6\)"):
        joint_deflection(kr10, np.ones(6), q, np.zeros((3, 6)))
