"""Check curve-springs: curved and linear springs, samples that say little, and wild readings."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from helpers.made_robots import planar_arm, random_chain
from helpers.made_samples import samples_with
from stiff_datasets.twin.robot_twin import Ur5Twin
from stiff_models import load
from stiff_models.physics.curve_springs import CurveSprings
from stiff_models.physics.full_vjm import TURN_RATIO, FullVjm, spring_regressor, typical_springs
from stiff_protocols.conformance.model_checks import check_model
from stiff_protocols.contract.errors import ModelError, StiffBenchWarning
from stiff_protocols.kinematics.serial_chain import joint_torque

DOWN = (0.0, 1.0, 0.0)  # about y: an arm along x turns downwards


def predict(model, samples):
    return model.predict(samples.q, samples.wrench)


def error(model, samples):
    """Return the mean 3-D error, m."""
    return np.linalg.norm(predict(model, samples) - samples.deflection, axis=1).mean()


@pytest.fixture(scope="module")
def strain_wave():
    """Return robot, training and test samples of a simulated UR5, read without noise.

    Its gears have three slopes and no lost motion.
    """
    data = Ur5Twin().load()
    samples = replace(data.samples, deflection=data.bound_deflections["noise"])
    rows = np.arange(len(samples))
    return data.robot, samples.take(rows[rows % 3 > 0]), samples.take(rows[rows % 3 == 0])


def linear_samples(robot, rng, n=60):
    """Return samples of linear springs about and across every joint."""
    q = rng.uniform(-1.0, 1.0, size=(n, robot.n_joints))
    wrench = rng.normal(size=(n, 6)) * np.repeat([60.0, 5.0], 3)
    compliance = 1e-5 * typical_springs(robot, 3) * rng.uniform(0.5, 2.0, 3 * robot.n_joints)
    return samples_with(q, wrench, spring_regressor(robot, q, wrench, 3) @ compliance)


@pytest.mark.parametrize("weights", ["equal", "student"])
def test_gears_with_three_slopes_are_predicted_better_than_with_linear_springs(
    weights, strain_wave
):
    robot, train, test = strain_wave
    model = CurveSprings(weights=weights).fit(train, robot=robot)
    assert error(model, test) < 0.5 * error(FullVjm().fit(train, robot=robot), test)


def test_without_a_load_nothing_moves(strain_wave):
    robot, train, test = strain_wave
    model = CurveSprings().fit(train, robot=robot)
    assert not model.predict(test.q, np.zeros_like(test.wrench)).any()


def test_the_gear_of_one_joint_is_found(rng):
    robot = planar_arm(1, DOWN, mass=3.0)
    q, wrench = rng.uniform(-1.5, 1.5, size=(80, 1)), np.zeros((80, 6))
    wrench[:, :3] = rng.normal(size=(80, 3)) * 20.0
    unloaded = robot.gravity_torque(q)
    loaded = unloaded + joint_torque(robot.jacobian(q), wrench)
    turns = [4e-5 * torque + 6e-5 * np.clip(torque, -12.0, 12.0) for torque in (loaded, unloaded)]
    deflection = robot.jacobian(q)[:, :3, 0] * (turns[0] - turns[1])
    samples = samples_with(q, wrench, deflection)
    train, test = samples.take(np.arange(50)), samples.take(np.arange(50, 80))
    model, linear = (cls().fit(train, robot=robot) for cls in (CurveSprings, FullVjm))
    assert error(model, test) < 0.3 * error(linear, test)


@pytest.mark.parametrize(
    "kinds", [("prismatic", "revolute", "revolute", "prismatic"), ("prismatic",) * 3]
)
def test_slides_and_a_robot_without_masses_are_predicted_and_the_masses_are_missed(kinds, rng):
    robot = random_chain(rng, kinds)
    samples = linear_samples(robot, rng)
    train, test = samples.take(np.arange(40)), samples.take(np.arange(40, 60))
    with pytest.warns(StiffBenchWarning, match="robot 'chain' has no masses"):
        model = CurveSprings().fit(train, robot=robot)
    assert error(model, test) < 0.01 * np.linalg.norm(test.deflection, axis=1).mean()


def test_a_joint_that_no_load_turned_is_as_soft_as_joints_of_its_size(rng):
    upright = (0.0, 0.0, 1.0)
    robot, q = planar_arm(2, upright, mass=3.0), rng.uniform(-1.0, 1.0, size=(30, 2))
    wrench = np.zeros((30, 6))
    wrench[:, 2] = rng.normal(size=30) * 50.0  # parallel to both axes, as are the weights
    across = spring_regressor(robot, q, wrench, 3) @ np.tile([1e-5, 1e-5, 0.0], 2)
    with pytest.warns(StiffBenchWarning, match="no load turns"):
        model = CurveSprings().fit(samples_with(q, wrench, across), robot=robot)
    sideways = np.zeros((30, 6))
    sideways[:, :2] = 100.0
    soft = robot.joint_deflection(np.full(2, TURN_RATIO * 1e-5), q, sideways)
    ratio = np.linalg.norm(model.predict(q, sideways)) / np.linalg.norm(soft)
    assert 0.3 < ratio < 3.0


def test_two_samples_are_too_few_and_fitted(strain_wave):
    robot, train, test = strain_wave
    with pytest.warns(StiffBenchWarning, match="2 training samples give 6 equations for 18 spring"):
        model = CurveSprings().fit(train.take(np.arange(2)), robot=robot)
    assert np.abs(predict(model, test)).max() < 0.1  # m


def test_samples_of_one_pose_choose_no_penalty_and_are_fitted(strain_wave):
    robot, train, _ = strain_wave
    one_pose = replace(
        train, q=np.repeat(train.q[:1], len(train), axis=0), pose_id=np.full(len(train), "P1")
    )
    model = CurveSprings().fit(one_pose, robot=robot)
    assert model.diagnostics_["penalty"] == pytest.approx(0.01)


def test_deflections_that_are_all_zero_make_every_joint_rigid_and_are_named(strain_wave):
    robot, train, test = strain_wave
    still = replace(train, deflection=np.zeros_like(train.deflection))
    with pytest.warns(StiffBenchWarning, match="every deflection is zero"):
        model = CurveSprings().fit(still, robot=robot)
    assert not predict(model, test).any()


def test_samples_without_a_load_are_refused(strain_wave):
    robot, train, _ = strain_wave
    with pytest.raises(ModelError, match="no wrench turns any joint"):
        CurveSprings().fit(replace(train, wrench=np.zeros_like(train.wrench)), robot=robot)


OFFSET = np.array([0.03, -0.02, 0.04])  # m, of the true point from the card's


def test_a_wrong_tcp_is_found_exactly_with_linear_springs_and_to_a_tenth_with_curved_ones(
    strain_wave, rng
):
    robot, train, _ = strain_wave
    wrong = replace(robot, tcp=robot.tcp - OFFSET)
    for samples, tolerance in ((linear_samples(robot, rng), 1e-4), (train, 5e-3)):
        model = CurveSprings(tcp="fit").fit(samples, robot=wrong)
        assert np.linalg.norm(model.geometry_.point - robot.tcp) < tolerance  # m


def test_with_a_fitted_tcp_the_deflection_of_the_given_tcp_has_the_same_springs(strain_wave, rng):
    robot, _, test = strain_wave
    samples = linear_samples(robot, rng)
    wrong = replace(robot, tcp=robot.tcp - OFFSET)
    compliance = FullVjm().fit(samples, robot=robot).compliance_
    there = spring_regressor(wrong, test.q, test.wrench, 3) @ compliance
    fitted = CurveSprings(tcp="fit").fit(samples, robot=wrong)
    np.testing.assert_allclose(
        fitted.predict_at_tcp(test.q, test.wrench), there, rtol=0.0, atol=1e-3 * np.abs(there).max()
    )


def test_a_wild_reading_moves_student_weights_least(strain_wave):
    robot, train, test = strain_wave
    deflection = train.deflection.copy()
    deflection[7] += [2e-3, -1e-3, 1e-3]
    wild = replace(train, deflection=deflection)
    moves = {}
    for weights in ("equal", "student"):
        model, moved = (
            CurveSprings(weights=weights).fit(samples, robot=robot) for samples in (train, wild)
        )
        moves[weights] = np.abs(predict(moved, test) - predict(model, test)).max()
    assert moves["student"] < 0.1 * moves["equal"]


@pytest.mark.parametrize("weights", ["equal", "student"])
def test_the_order_of_the_samples_does_not_matter(weights, strain_wave, rng):
    robot, train, test = strain_wave
    shuffled = train.take(rng.permutation(len(train)))
    first, second = (
        CurveSprings(weights=weights).fit(samples, robot=robot) for samples in (train, shuffled)
    )
    np.testing.assert_allclose(predict(second, test), predict(first, test), rtol=0.0, atol=1e-9)
    assert second.diagnostics_["penalty"] == first.diagnostics_["penalty"]


@pytest.mark.parametrize("options", [{}, {"weights": "student"}, {"tcp": "fit"}], ids=str)
def test_a_saved_model_predicts_the_same(options, strain_wave, tmp_path):
    robot, train, test = strain_wave
    model = CurveSprings(**options).fit(train, robot=robot)
    model.save(tmp_path / "model.stiff")
    np.testing.assert_array_equal(
        predict(load(tmp_path / "model.stiff"), test), predict(model, test)
    )


@pytest.mark.slow
def test_student_weights_keep_the_contract(fanuc):
    checks = check_model(
        lambda: CurveSprings(weights="student"), fanuc, uses_validation=False, load=load
    )
    failures = [str(check) for check in checks if check.status == "failed"]
    assert not failures, "\n".join(failures)
