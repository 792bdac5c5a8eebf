"""Ten types of robot: poses, loads and gears of a plausible size."""

from __future__ import annotations

import numpy as np
import pinocchio as pin
import pytest

from stiff_datasets.twin.constants import shipped_constants
from stiff_datasets.twin.robot_twin import ARMS, ArmFamily
from stiff_protocols.contract.robot import STANDARD_GRAVITY

NUMBERS = range(len(ARMS))


@pytest.fixture(scope="module")
def constants():
    return [shipped_constants(name) for name in ARMS]


@pytest.fixture(scope="module")
def data():
    return [ArmFamily(robot=number).load() for number in NUMBERS]


def test_ten_robots_have_151_poses_inside_the_limits_and_loads_to_80_percent(data, constants):
    assert len({one.robot.name for one in data}) == len({one.sha256 for one in data}) == 10
    for one, twin in zip(data, constants, strict=True):
        samples, robot = one.samples, one.robot
        assert len(set(samples.pose_id)) == len(samples) == 151
        assert (samples.q > robot.lower - 1e-5).all() and (samples.q < robot.upper + 1e-5).all()
        share = np.linalg.norm(samples.wrench[:, :3], axis=1) / (twin.payload_kg * STANDARD_GRAVITY)
        assert 0.19 < share.min() < 0.25 and 0.75 < share.max() < 0.85  # the sensor is 3 % off
        direction = samples.wrench[:, :3] / share[:, None]
        assert np.abs(direction.mean(axis=0)).max() < 0.2 * twin.payload_kg * STANDARD_GRAVITY


@pytest.mark.parametrize("number", NUMBERS)
def test_a_gears_rated_torque_is_near_the_joints_static_torque(number, data, constants):
    twin, q = constants[number], data[number].samples.q
    chain, robot = twin.chain(), twin.robot()
    model, frames = chain.model, chain.model.createData()
    stands = robot.forward(q)
    hook = stands.points[:, -1] + stands.rotation @ np.array(twin.hook_m)
    axes = np.einsum("njab,jb->nja", stands.rotations, robot.axes)
    lever = np.linalg.norm(np.cross(axes, hook[:, None] - stands.points[:, :-1]), axis=2)
    weight = [np.abs(pin.computeGeneralizedGravity(model, frames, angles)) for angles in q]
    largest = (np.array(weight) + twin.payload_kg * STANDARD_GRAVITY * lever).max(axis=0)
    ratio = np.array([joint.springs.gear.rated_Nm for joint in twin.joint]) / largest
    assert (ratio > 0.5).all() and (ratio < 4).all()  # 14 is the smallest size
