"""Check the groups' columns against rigid motions, closed forms and the full VJM."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from helpers.made_robots import random_chain
from helpers.made_samples import samples_with
from stiff_models.physics.full_vjm import spring_regressor
from stiff_models.regressors.arm_loads import ArmLoads, Rig, Sizes
from stiff_models.regressors.spring_groups import (
    GROUPS,
    BaseSpring,
    CrossTalk,
    Drift,
    ForcePoint,
    JointLines,
    LostMotion,
    Tilts,
)
from stiff_protocols.kinematics.serial_chain import joint_torque

KINDS = {
    "turns": ("revolute",) * 6,
    "slides": ("prismatic", "revolute", "prismatic"),
    "one": ("revolute",),
    "seven": ("revolute",) * 7,
}


@pytest.fixture(params=KINDS)
def arm(request, rng):
    """Return a robot, its training samples, sizes and loads."""
    robot = random_chain(rng, KINDS[request.param])
    robot = replace(robot, masses=np.full(robot.n_joints, 3.0))
    q = rng.uniform(-1.0, 1.0, size=(40, robot.n_joints))
    wrench = rng.normal(size=(40, 6)) * np.repeat([60.0, 5.0], 3)
    compliance = np.full(3 * robot.n_joints, 1e-5)
    deflection = spring_regressor(robot, q, wrench, 3) @ compliance
    train = samples_with(q, wrench, deflection)
    sizes = Sizes.of(robot, train)
    return robot, train, sizes, ArmLoads.of(robot, q, wrench, Rig.perfect(robot.n_joints))


def test_every_group_has_finite_columns_that_vanish_without_a_load(arm):
    robot, train, sizes, loads = arm
    stated = {
        "by_weight": np.zeros((40, 3, robot.n_joints)),
        "order": np.arange(40.0),
        "approach": np.ones((40, robot.n_joints)),
    }
    loads = replace(loads, **stated)
    none = ArmLoads.of(robot, train.q, np.zeros((40, 6)), Rig.perfect(robot.n_joints))
    for group in GROUPS:
        columns = group.columns(loads, sizes)
        assert columns.shape[:2] == (40, 3) and np.isfinite(columns).all()
        if not isinstance(group, Drift):
            assert not group.columns(replace(none, **stated), sizes).any()


def test_lines_and_tilts_are_the_springs_of_the_full_vjm(arm):
    robot, train, sizes, loads = arm
    expected = spring_regressor(robot, train.q, train.wrench, 3).reshape(40, 3, -1, 3)
    expected = expected * sizes.compliance[1:, :3]
    np.testing.assert_allclose(JointLines().columns(loads, sizes), expected[..., 2], atol=1e-15)
    tilts = Tilts().columns(loads, sizes).reshape(40, 3, -1, 2)
    np.testing.assert_allclose(tilts, expected[..., :2], atol=1e-15)


def test_lost_motion_saturates_and_depends_on_the_weights(arm):
    robot, train, sizes, loads = arm
    torque = joint_torque(robot.jacobian(train.q), train.wrench)
    weight, width = robot.gravity_torque(train.q), 0.1 * sizes.torque[1:, 2]
    turned = np.arctan((weight + torque) / width) - np.arctan(weight / width)
    size = sizes.compliance[1:, 2] * sizes.torque[1:, 2]
    expected = robot.jacobian(train.q)[:, :3] * (turned * size)[:, None]
    np.testing.assert_allclose(LostMotion(0.1).columns(loads, sizes), expected, atol=1e-14)


def test_a_base_that_turns_about_x_moves_the_tcp_as_a_rigid_body(arm):
    robot, train, sizes, loads = arm
    columns = BaseSpring().columns(loads, sizes)
    assert columns.shape[2] == 21
    tcp, force, torque = robot.tcp_position(train.q), train.wrench[:, :3], train.wrench[:, 3:]
    moment = (torque + np.cross(tcp, force))[:, 0] * sizes.compliance[0, 0]
    expected = np.cross([1.0, 0.0, 0.0], tcp) * moment[:, None]
    np.testing.assert_allclose(columns[:, :, 0], expected, atol=1e-14)


@pytest.mark.parametrize("group", [ForcePoint(), CrossTalk()], ids=lambda group: group.name)
def test_columns_of_the_rig_are_the_slopes_of_the_linear_springs(group, arm, rng):
    """The wrench that acts changes with the coefficients; linear springs give the deflection."""
    robot, train, sizes, loads = arm
    coefficients = 1e-5 * rng.normal(size=group.columns(loads, sizes).shape[2])
    rig = group.changed(Rig.perfect(robot.n_joints), coefficients, sizes)
    np.testing.assert_allclose(group.coefficients(rig, sizes), coefficients)
    moved = ArmLoads.of(robot, train.q, train.wrench, rig)
    springs = spring_regressor(robot, train.q, moved.acting - train.wrench, 3)
    change = springs @ sizes.springs[1:, :3].ravel()
    predicted = group.columns(loads, sizes) @ coefficients
    np.testing.assert_allclose(predicted, change, rtol=1e-3, atol=1e-3 * np.abs(change).max())


def test_a_force_point_adds_the_moment_of_the_force(arm):
    robot, train, _, _ = arm
    point = np.array([0.01, -0.02, 0.005])
    rig = replace(Rig.perfect(robot.n_joints), force_point=point)
    acting = ArmLoads.of(robot, train.q, train.wrench, rig).acting
    lever = robot.forward(train.q).rotation @ point
    np.testing.assert_allclose(acting[:, :3], train.wrench[:, :3])
    np.testing.assert_allclose(
        acting[:, 3:], train.wrench[:, 3:] + np.cross(lever, train.wrench[:, :3])
    )
    assert not rig.without_errors.force_point.any()
