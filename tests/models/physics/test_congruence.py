"""Stiffness under load: closed forms, the nonlinear balance, and what it is worth on a robot."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from scipy.optimize import fsolve

from helpers.made_robots import planar_arm
from helpers.made_samples import samples_with
from stiff_datasets.twin.kr10_twin import Kr10Twin
from stiff_models.physics.congruence import LoadedRobot, loaded_deflection
from stiff_models.physics.vjm import VirtualJointModel, identify_joints
from stiff_protocols.contract.errors import ModelError

STIFFNESS = np.array([50.9e3, 63.4e3, 50.3e3, 2.27e3, 8.89e3, 1.39e3])  # the paper's Table 3
Z = (0.0, 0.0, 1.0)


def loaded_samples(robot, rng, n=60):
    """Samples of springs that the load softens, at loads far beyond the KR10's payload."""
    q = rng.uniform(np.maximum(robot.lower, -2), np.minimum(robot.upper, 2), size=(n, 6))
    wrench = rng.normal(size=(n, 6)) * np.repeat([300.0, 30.0], 3)
    return samples_with(q, wrench, loaded_deflection(robot, 1 / STIFFNESS, q, wrench))


def pushed(force_inwards, force_across, stiffness=1000.0):
    """A 1 m pendulum along x, pushed towards its joint and across."""
    wrench = np.array([[-force_inwards, force_across, 0.0, 0.0, 0.0, 0.0]])
    return loaded_deflection(planar_arm(1, Z), np.array([1 / stiffness]), np.zeros((1, 1)), wrench)


def test_a_pushed_pendulum_is_softer_and_a_pulled_one_stiffer_by_force_times_length():
    # torque balance k t = F_across l cos t + F_in l sin t, linear: t = F_across l / (k - F_in l)
    np.testing.assert_allclose(pushed(400.0, 30.0), [[0.0, 30.0 / 600.0, 0.0]], atol=1e-15)
    np.testing.assert_allclose(pushed(-400.0, 30.0), [[0.0, 30.0 / 1400.0, 0.0]], atol=1e-15)


def test_a_pendulum_pushed_beyond_its_stiffness_buckles_and_the_row_is_named():
    assert pushed(999.0, 1.0)[0, 1] == pytest.approx(1.0)
    with pytest.raises(ModelError, match=r"row 0: the load buckles .*\(1 such rows of 1\)"):
        pushed(1001.0, 1.0)


def test_the_model_names_the_sample_that_buckles(kr10, rng):
    samples = loaded_samples(kr10, rng)
    model = VirtualJointModel(congruence=True).fit(samples, robot=kr10)
    wrench = samples.wrench.copy()
    wrench[7] *= 1000.0
    with pytest.raises(ModelError, match=r"row 7: .* q = \[.*\] under the wrench"):
        model.predict(samples.q, wrench)


def test_a_rigid_joint_never_buckles_and_does_not_turn(kr10, rng):
    samples = loaded_samples(kr10, rng)
    huge = samples.wrench * 1e6
    assert not loaded_deflection(kr10, np.zeros(6), samples.q, huge).any()
    turn = LoadedRobot.of(kr10, samples.q, samples.wrench).turn(
        np.where(np.arange(6) == 2, 0.0, 1 / STIFFNESS)
    )
    assert not turn[:, 2].any() and turn[:, 5].all()


def balance_error(share, congruence):
    """How far the model is from the solved balance K t = J(q + t)^T w, at a share of a load."""
    arm, stiffness = planar_arm(2, Z), np.array([900.0, 500.0])
    q, wrench = np.array([[0.4, 0.7]]), share * np.array([[-60.0, 40.0, 0.0, 0.0, 0.0, 5.0]])

    def unbalanced(turn):
        return stiffness * turn - wrench[0] @ arm.jacobian(q + turn)[0]

    truth = fsolve(unbalanced, np.zeros(2), xtol=1e-14)
    loaded = LoadedRobot.of(arm, q, wrench)
    turn = loaded.turn(1 / stiffness) if congruence else loaded.torque / stiffness
    return np.abs(turn - truth).max()


def test_it_solves_the_nonlinear_balance_to_one_order_more_than_the_linear_model():
    # the linear model leaves out K_g dtheta ~ load^2, this one (d2J dtheta^2) w ~ load^3
    linear = balance_error(0.04, False) / balance_error(0.02, False)
    loaded = balance_error(0.04, True) / balance_error(0.02, True)
    assert linear == pytest.approx(4.0, rel=0.1)
    assert loaded == pytest.approx(8.0, rel=0.1)
    assert balance_error(0.02, True) < balance_error(0.02, False) / 30


def test_k_g_is_the_change_of_the_loads_torque_as_joints_turn(kr10, rng):
    samples, step = loaded_samples(kr10, rng, n=10), 1e-5
    congruence = LoadedRobot.of(kr10, samples.q, samples.wrench).congruence
    for joint in range(6):
        turn = step * np.eye(6)[joint]
        more, less = (
            LoadedRobot.of(kr10, samples.q + sign * turn, samples.wrench).torque for sign in (1, -1)
        )
        np.testing.assert_allclose(congruence[..., joint], (more - less) / (2 * step), atol=1e-5)


def test_k_g_of_a_pure_force_is_symmetric_and_that_of_a_moment_is_not(kr10, rng):
    samples = loaded_samples(kr10, rng, n=10)
    force, moment = samples.wrench.copy(), samples.wrench.copy()
    force[:, 3:] = moment[:, :3] = 0.0
    for wrench, symmetric in ((force, True), (moment, False)):
        congruence = LoadedRobot.of(kr10, samples.q, wrench).congruence
        skew = np.abs(congruence - congruence.transpose(0, 2, 1)).max()
        assert (skew < 1e-10) == symmetric


def test_at_the_kr10s_loads_it_takes_a_quarter_per_cent_off_a1_to_a3_and_more_off_a4():
    data = Kr10Twin().load()
    congruence = LoadedRobot.of(data.robot, data.samples.q, data.samples.wrench).congruence
    share = np.abs(congruence).max(axis=(0, 2)) / STIFFNESS  # of each joint's stiffness
    assert 50.0 < np.abs(congruence[:, 0]).max() < 200.0  # N m/rad, beside A1's 50,900
    assert share[:3].max() < 0.003 < 0.006 < share[3] < 0.01


def test_samples_of_a_loaded_robot_are_fitted_to_rounding_only_with_the_option(kr10, rng):
    samples = loaded_samples(kr10, rng)
    size = np.abs(samples.deflection).max()
    errors = [
        np.abs(
            VirtualJointModel(congruence=option)
            .fit(samples, robot=kr10)
            .predict(samples.q, samples.wrench)
            - samples.deflection
        ).max()
        for option in (False, True)
    ]
    assert errors[1] < 1e-12 * size
    assert errors[0] > 1e-3 * size
    joints = identify_joints(kr10, samples, congruence=True)
    np.testing.assert_allclose(joints.stiffness, STIFFNESS, rtol=1e-10)
    assert joints.rank == 6 and joints.unidentifiable == ()


def test_a_joint_that_is_rigid_is_stiffer_than_the_samples_can_tell(kr10, rng):
    samples = loaded_samples(kr10, rng)
    compliance = 1 / STIFFNESS
    compliance[1] = 0.0
    exact = loaded_deflection(kr10, compliance, samples.q, samples.wrench)
    found = identify_joints(kr10, replace(samples, deflection=exact), congruence=True)
    assert found.unidentifiable == ("A2",)
    assert 1.0 / found.compliance[1] > 10.0 * STIFFNESS[1]
    others = [0, 2, 3, 4, 5]
    np.testing.assert_allclose(found.compliance[others], compliance[others], rtol=0.01)


def test_measurements_that_only_a_buckled_robot_explains_end_in_springs_that_hold_them(kr10, rng):
    samples = loaded_samples(kr10, rng)
    soft = replace(samples, deflection=samples.deflection * 40.0)
    joints = identify_joints(kr10, soft, congruence=True)
    loaded = LoadedRobot.of(kr10, soft.q, soft.wrench)
    assert len(loaded.beyond_buckling(identify_joints(kr10, soft).compliance))
    assert not len(loaded.beyond_buckling(joints.compliance))
