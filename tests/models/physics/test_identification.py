"""Check that poorly identified springs stay plausible, are named and have intervals."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from helpers.made_robots import seven_joint_arm
from helpers.made_samples import samples_with
from stiff_datasets.robots.shipped_robots import shipped_robot
from stiff_models.physics.full_vjm import FullVjm, spring_regressor
from stiff_models.physics.vjm import identify_joints

IIWA = np.array([1.6e4, 1.4e4, 1.0e4, 1.0e4, 4e3, 1.3e3, 1.3e3])  # N m/rad
KR10 = np.array([50.9e3, 63.4e3, 50.3e3, 2.27e3, 8.89e3, 1.39e3])
STILL = np.deg2rad(0.01)  # scatter of joints that do not move


def kr10_arm():
    return shipped_robot("kr10_r1100_2", tcp=(0.06, 0.0, 0.08))


ARMS = {
    "seven joints, two move": (seven_joint_arm, IIWA, (0, 1), -24.5, 3e-4),
    "seven joints, one moves": (seven_joint_arm, IIWA, (3,), -24.5, 3e-4),
    "KR10, two joints move": (kr10_arm, KR10, (1, 2), -80.0, 2e-4),
    "KR10, its wrist moves": (kr10_arm, KR10, (3, 4, 5), -80.0, 2e-4),
}
"""Robot, typical stiffnesses, moving joints, weight [N] at the TCP, noise per axis [m]."""


def arm_samples(arm, seed, n=100):
    """Return an arm, samples in which few of its joints move, and its stiffnesses."""
    robot, typical, moving, weight, noise = arm
    robot, rng = robot(), np.random.default_rng(seed)
    q = rng.uniform(-1.2, 1.2, robot.n_joints) + STILL * rng.normal(size=(n, robot.n_joints))
    q[:, moving] = rng.uniform(-1.5, 1.5, size=(n, len(moving)))
    wrench = np.zeros((n, 6))
    wrench[:, 2] = weight
    stiffness = typical * np.exp(0.3 * rng.normal(size=robot.n_joints))
    deflection = robot.joint_deflection(1.0 / stiffness, q, wrench)
    return robot, samples_with(q, wrench, deflection + noise * rng.normal(size=(n, 3))), stiffness


@pytest.mark.parametrize("arm", ARMS.values(), ids=ARMS)
def test_no_spring_lies_outside_a_thirtieth_to_thirty_times_the_truth(arm):
    known_ratios = []
    for seed in range(12):
        robot, samples, stiffness = arm_samples(arm, seed)
        joints = identify_joints(robot, samples)
        ratio = 1.0 / joints.compliance / stiffness
        assert (1 / 30 < ratio).all() and (ratio < 30).all()
        known_ratios.extend(ratio[joints.is_identified])
        assert joints.unidentifiable
    assert len(known_ratios) > 12 and 1 / 3 < np.min(known_ratios) and np.max(known_ratios) < 3


@pytest.mark.filterwarnings("ignore::stiff_protocols.contract.errors.StiffBenchWarning")
@pytest.mark.parametrize("arm", ARMS.values(), ids=ARMS)
def test_no_spring_across_a_joint_lies_outside_that_range(arm):
    for seed in range(3):
        robot, samples, stiffness = arm_samples(arm, seed)
        rng = np.random.default_rng(seed)
        truth = stiffness[:, None] * np.exp(rng.uniform(0.0, np.log(8.0), (len(stiffness), 3)))
        truth[:, 2] = stiffness
        regressor = spring_regressor(robot, samples.q, samples.wrench, 3)
        noise = samples.deflection - robot.joint_deflection(
            1.0 / stiffness, samples.q, samples.wrench
        )
        samples = replace(samples, deflection=regressor @ (1.0 / truth.ravel()) + noise)
        model = FullVjm().fit(samples, robot=robot)
        ratio = 1.0 / model.compliance_ / truth.ravel()
        assert (1 / 30 < ratio).all() and (ratio < 30).all()
        assert model.springs_.unidentifiable


@pytest.mark.slow
@pytest.mark.parametrize("arm", ARMS.values(), ids=ARMS)
def test_nine_of_ten_intervals_hold_the_stiffness(arm):
    inside = []
    for seed in range(30):
        robot, samples, stiffness = arm_samples(arm, seed)
        lower, upper = identify_joints(robot, samples).interval(0.9).T
        inside.extend((lower <= stiffness) & (stiffness <= upper))
    assert 0.85 < np.mean(inside)


def test_intervals_of_well_known_joints_are_no_wider_than_they_must_be(kr10):
    rng, inside = np.random.default_rng(3), []
    for _ in range(60):
        q = rng.uniform(-1.5, 1.5, size=(60, 6))
        wrench = rng.normal(size=(60, 6)) * np.repeat([60.0, 5.0], 3)
        deflection = kr10.joint_deflection(1.0 / KR10, q, wrench)
        noise = 2e-4 * rng.normal(size=deflection.shape)
        lower, upper = (
            identify_joints(kr10, samples_with(q, wrench, deflection + noise)).interval().T
        )
        inside.extend((lower <= KR10) & (KR10 <= upper))
    assert 0.85 < np.mean(inside) < 0.97


def test_samples_that_err_together_at_a_pose_widen_the_intervals(kr10, rng):
    q = np.repeat(rng.uniform(-1.5, 1.5, size=(30, 6)), 5, axis=0)
    wrench = np.tile([30.0, 20.0, -60.0, 3.0, 4.0, 2.0], (150, 1)) * rng.uniform(0.5, 1, (150, 1))
    error = np.repeat(2e-4 * rng.normal(size=(30, 3)), 5, axis=0)
    deflection = kr10.joint_deflection(1.0 / KR10, q, wrench) + error
    poses = np.repeat(np.arange(30), 5).astype(str)
    grouped_joints = identify_joints(kr10, samples_with(q, wrench, deflection, pose_id=poses))
    separate_joints = identify_joints(kr10, samples_with(q, wrench, deflection))
    np.testing.assert_array_equal(grouped_joints.compliance, separate_joints.compliance)
    assert np.median(grouped_joints.log_error / separate_joints.log_error) > 1.5


@pytest.mark.parametrize(("lengths", "loads"), [(0.1, 1.0), (1.0, 100.0), (1.0, 0.01)])
def test_neither_the_size_of_the_robot_nor_the_unit_of_loads_matters(lengths, loads):
    robot, samples, _ = arm_samples(ARMS["seven joints, two move"], 1)
    placements = robot.placements.copy()
    placements[:, :3, 3] *= lengths
    scaled_robot = replace(robot, placements=placements, tcp=robot.tcp * lengths)
    scaled_samples = replace(
        samples,
        wrench=samples.wrench * loads,
        deflection=samples.deflection * lengths,
    )
    original = identify_joints(robot, samples)
    rescaled = identify_joints(scaled_robot, scaled_samples)
    assert original.unidentifiable == rescaled.unidentifiable
    np.testing.assert_allclose(
        rescaled.compliance, original.compliance / (lengths * loads), rtol=1e-3
    )
