"""Check bayes-springs: what is planted is found, and the rig is told from the robot."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from helpers.made_robots import random_chain
from helpers.made_samples import samples_with
from stiff_datasets.twin.kr10_twin import Kr10Twin
from stiff_datasets.twin.robot_twin import Ur5Twin
from stiff_models import load
from stiff_models.physics.full_vjm import FullVjm, spring_regressor, typical_springs
from stiff_models.physics.vjm import VirtualJointModel
from stiff_models.regressors.arm_loads import OWN_AXIS, ArmLoads, Rig, Sizes, friction_turns
from stiff_models.regressors.bayes_springs import BayesSprings
from stiff_protocols.conformance.model_checks import check_model
from stiff_protocols.contract.errors import ConfigError, StiffBenchWarning
from stiff_protocols.contract.types import TRUTH


def predict(model, samples):
    return model.predict(samples.q, samples.wrench)


def error(predicted, expected):
    """Return the mean 3-D error over the mean size of what is expected."""
    misses = np.linalg.norm(predicted - expected, axis=1).mean()
    return misses / np.linalg.norm(expected, axis=1).mean()


def divided(data, n_train=120):
    """Return training samples, test samples and the truth at these."""
    rows = np.random.default_rng(3).permutation(len(data.samples))
    train, test = rows[:n_train], rows[n_train:]
    return data.samples.take(train), data.samples.take(test), data.bound_deflections[TRUTH][test]


@pytest.fixture(scope="module")
def clean():
    """Return a simulated KR10 with gears and tilting bearings only."""
    return Kr10Twin(plan="wide").load()


@pytest.fixture(scope="module")
def few(clean):
    """Return the robot with 30 training samples, for what needs no precise fit."""
    return clean.robot, divided(clean, 30)[0]


def linear_samples(robot, rng, springs, n=60):
    """Return samples of linear springs, and their (n, 3) deflections at other poses."""
    q = rng.uniform(-1.0, 1.0, size=(n + 40, robot.n_joints))
    wrench = rng.normal(size=(n + 40, 6)) * np.repeat([60.0, 5.0], 3)
    compliance = 1e-5 * typical_springs(robot, 3).reshape(-1, 3)
    compliance = compliance * rng.uniform(0.5, 2.0, compliance.shape) * springs
    deflection = spring_regressor(robot, q, wrench, 3) @ compliance.ravel()
    samples = samples_with(q, wrench, deflection)
    return samples.take(np.arange(n)), samples.take(np.arange(n, n + 40))


KINDS = [("revolute",) * 6, ("prismatic", "revolute", "prismatic"), ("revolute",)]


@pytest.mark.parametrize("kinds", KINDS, ids=["turns", "slides", "one joint"])
@pytest.mark.parametrize(
    ("groups", "springs", "linear"),
    [
        ("joints", [0.0, 0.0, 1.0], VirtualJointModel),
        ("joints+bearings", [1.0, 1.0, 1.0], FullVjm),
    ],
)
def test_groups_of_lines_are_the_linear_models(kinds, groups, springs, linear, rng):
    robot = random_chain(rng, kinds)
    train, test = linear_samples(robot, rng, springs)
    with pytest.warns(StiffBenchWarning, match="has no masses"):
        model = BayesSprings(groups=groups).fit(train, robot=robot)
    expected = predict(linear().fit(train, robot=robot), test)
    assert error(predict(model, test), expected) < 0.01


def test_stiffnesses_and_curves_are_those_of_linear_springs(rng):
    robot = Ur5Twin().load().robot
    train, _ = linear_samples(robot, rng, [0.0, 0.0, 1.0])
    model = BayesSprings(groups="joints").fit(train, robot=robot)
    stiffness = VirtualJointModel().fit(train, robot=robot).springs_.stiffness
    springs = dict(zip(model.springs_.names, model.springs_.stiffness, strict=True))
    for joint, expected in zip(robot.joint_names, stiffness, strict=True):
        for place in ("no", "half", "full"):
            assert springs[f"{joint} at {place} torque"] == pytest.approx(expected, rel=0.02)
        torque, turn, deviation = model.curves_[f"spring {joint}"].T
        np.testing.assert_allclose(turn, torque / expected, rtol=0.02)
        assert (deviation < 0.1 * np.abs(turn).max()).all()


@pytest.mark.slow
def test_curves_lie_on_the_gears_of_the_simulated_robot(clean):
    train, _, _ = divided(clean)
    curves = BayesSprings().fit(train, robot=clean.robot).curves_
    for joint in (1, 3, 4):  # A3 shares its deflection with its bearings
        torque, turn, _ = curves[f"spring {clean.robot.joint_names[joint]}"].T
        true = clean.joint_turn(np.outer(torque, np.eye(6)[joint]))[:, joint]
        assert np.abs(turn - true).max() < 0.05 * np.abs(true).max()


def test_a_model_without_springs_of_the_joints_identifies_no_stiffness(few):
    robot, train = few
    model = BayesSprings(groups="links+base").fit(train, robot=robot)
    assert not model.springs_.is_identified.any()


@pytest.mark.slow
def test_without_a_load_nothing_moves(few):
    robot, train = few
    model = BayesSprings().fit(train, robot=robot)
    assert not model.predict(train.q, np.zeros_like(train.wrench)).any()
    assert not model.predict_reading(train.q, np.zeros_like(train.wrench)).any()


@pytest.mark.slow
def test_it_is_better_than_linear_springs_on_gears_and_finds_no_soft_parts_there(clean):
    train, test, truth = divided(clean)
    model, linear = (cls().fit(train, robot=clean.robot) for cls in (BayesSprings, FullVjm))
    assert error(predict(model, test), truth) < 0.3 * error(predict(linear, test), truth)
    report = model.diagnostics_
    total = np.linalg.norm(train.deflection, axis=1).mean() * 1e3
    for name in ("couplings", "base", "links, slides", "links, bending", "joint angles"):
        assert report[f"contribution of {name} [mm]"] < 0.01 * total
    assert report["contribution of joints [mm]"] > 0.3 * total


@pytest.mark.slow
def test_a_planted_force_point_is_found_and_left_out_of_predictions(clean):
    point = np.array([0.012, -0.016, 0.0])  # m, 20 mm beside the TCP
    train, test, truth = divided(clean)
    lever = clean.robot.forward(train.q).rotation @ point
    written = train.wrench.copy()
    written[:, 3:] -= np.cross(lever, written[:, :3])
    model = BayesSprings().fit(replace(train, wrench=written), robot=clean.robot)
    assert np.linalg.norm(model.rig_.force_point - point) < 3e-3
    assert error(predict(model, test), truth) < 0.03
    readings = model.predict_reading(train.q, written)
    assert error(readings, train.deflection) < 0.03
    assert error(model.predict(train.q, written), train.deflection) > 0.035


@pytest.mark.slow
def test_a_planted_drift_is_found_where_the_file_states_an_order(clean):
    train, test, truth = divided(clean, 60)
    order = np.argsort(np.argsort(train.pose_id)).astype(float)
    drift = 4e-4 * (order / 59.0)[:, None] ** 2 * [0.6, 0.0, -0.8]  # m
    drifted = replace(train, deflection=train.deflection + drift)
    silent = BayesSprings().fit(drifted, robot=clean.robot)
    model = BayesSprings().fit(replace(drifted, order=order), robot=clean.robot)
    assert "contribution of drift [mm]" not in silent.diagnostics_
    size = 1e3 * np.linalg.norm(drift, axis=1).mean()
    assert model.diagnostics_["contribution of drift [mm]"] == pytest.approx(size, rel=0.2)
    assert error(predict(model, test), truth) < 0.5 * error(predict(silent, test), truth)
    of_robot, of_reading = (
        model.deviation(test.q, test.wrench, reading=reading) for reading in (False, True)
    )
    assert (of_reading**2 > of_robot**2 + model.file_variance_).all()


@pytest.mark.slow
def test_friction_of_a_known_approach_is_found_and_left_out_of_predictions(clean, rng):
    train, test, truth = divided(clean, 60)
    approach = rng.choice([-1.0, 1.0], train.q.shape)
    loads = ArmLoads.of(clean.robot, train.q, train.wrench, Rig.perfect(6))
    turned = 3.0 * approach * friction_turns(loads, Sizes.of(clean.robot, train), 0.2)
    moved = np.einsum("nkj,nj->nk", loads.move[:, :, 1:, OWN_AXIS], 0.1 * turned)
    stuck = replace(train, deflection=train.deflection + moved)
    silent = BayesSprings().fit(stuck, robot=clean.robot)
    model = BayesSprings().fit(replace(stuck, approach=approach), robot=clean.robot)
    assert error(predict(model, test), truth) < 0.5 * error(predict(silent, test), truth)


@pytest.mark.slow
def test_groups_after_a_minus_are_left_out_with_all_that_share_their_first_word(few):
    robot, train = few
    model = BayesSprings(groups="-links+lost motion").fit(train, robot=robot)
    names = [name for name in model.diagnostics_ if name.startswith("contribution of ")]
    assert not [name for name in names if "links" in name or "lost motion" in name]
    assert [name for name in names if "bearing play" in name]


@pytest.mark.slow
def test_planted_masses_are_found(clean):
    light = replace(clean.robot, masses=clean.robot.masses / 1.2)
    train, _, _ = divided(clean)
    factors = BayesSprings().fit(train, robot=light).rig_.weight_factor
    assert factors[1] == pytest.approx(1.2, abs=0.08)  # of the joint with the largest weights


@pytest.mark.slow
def test_a_planted_soft_link_is_found(clean):
    """A cantilever after joint 3 bends: its end moves and tilts under force and moment."""
    samples, _, _ = divided(clean, 151)
    twist = clean.robot.virtual_jacobian(samples.q)[:, :, 2]
    load = np.einsum("nks,nk->ns", twist, samples.wrench)
    length, soft = 0.5, 1.5e-5
    bend = np.zeros((6, 6))
    for turn, slide, sign in ((0, 4, -1.0), (1, 3, 1.0)):
        bend[turn, turn], bend[slide, slide] = soft, soft * length**2 / 3.0
        bend[turn, slide] = bend[slide, turn] = sign * soft * length / 2.0
    extra = np.einsum("nks,ns->nk", twist[:, :3], load @ bend)
    soft_samples = replace(samples, deflection=samples.deflection + extra)
    stiff, model = (
        BayesSprings().fit(of.take(np.arange(120)), robot=clean.robot)
        for of in (samples, soft_samples)
    )
    test = samples.take(np.arange(120, 151))
    assert error(predict(model, test) - predict(stiff, test), extra[120:]) < 0.2


@pytest.mark.slow
def test_intervals_of_readings_hold_and_are_wider_than_those_of_the_robot(clean):
    train, test, _ = divided(clean, 60)
    model = BayesSprings().fit(train, robot=clean.robot)
    interval = model.predict_interval(test.q, test.wrench, 0.9)
    inside = (interval.lower <= test.deflection) & (test.deflection <= interval.upper)
    assert 0.75 < inside.mean() <= 1.0
    of_robot, of_reading = (
        model.deviation(test.q, test.wrench, reading=reading) for reading in (False, True)
    )
    assert (of_robot < of_reading).all()


@pytest.mark.slow
def test_the_covariance_of_a_deflection_with_itself_is_its_variance(few, clean):
    robot, train = few
    model = BayesSprings(groups="joints+bearings").fit(train.take(np.arange(9)), robot=robot)
    q, wrench = clean.samples.q[:5], clean.samples.wrench[:5]
    covariance = model.covariance(q, wrench, q[:3], wrench[:3])
    assert covariance.shape == (3, 5, 3)
    np.testing.assert_allclose(covariance[:, :3], covariance[:, :3].swapaxes(1, 2), rtol=1e-9)
    variance = np.diagonal(covariance, axis1=1, axis2=2).T
    deviation = model.deviation(q[:3], wrench[:3], reading=False)
    np.testing.assert_allclose(variance, deviation**2, rtol=1e-9)
    assert (model.noise_variance() > 0.0).all()


@pytest.mark.slow
def test_a_wild_reading_hardly_counts(clean):
    robot, train = clean.robot, divided(clean)[0]
    deflection = train.deflection.copy()
    deflection[7] += [2e-3, -1e-3, 1e-3]
    wild = BayesSprings().fit(replace(train, deflection=deflection), robot=robot)
    model = BayesSprings().fit(train, robot=robot)
    assert error(predict(wild, train), predict(model, train)) < 0.02


@pytest.mark.slow
@pytest.mark.parametrize("options", [{}, {"groups": "joints+lost motion"}, {"tcp": "fit"}], ids=str)
def test_a_saved_model_predicts_the_same(options, few, tmp_path):
    robot, train = few
    model = BayesSprings(**options).fit(train, robot=robot)
    model.save(tmp_path / "model.stiff")
    loaded = load(tmp_path / "model.stiff")
    np.testing.assert_array_equal(predict(loaded, train), predict(model, train))
    first, second = (m.predict_interval(train.q, train.wrench, 0.9) for m in (loaded, model))
    np.testing.assert_array_equal(first.upper, second.upper)


@pytest.mark.slow
def test_a_wrong_tcp_is_found(rng):
    robot, offset = Ur5Twin().load().robot, np.array([0.03, -0.02, 0.04])
    train, test = linear_samples(robot, rng, [1.0, 1.0, 1.0])
    wrong = replace(robot, tcp=robot.tcp - offset)
    model = BayesSprings(tcp="fit").fit(train, robot=wrong)
    assert np.linalg.norm(model.geometry_.point - robot.tcp) < 1e-3
    assert error(predict(model, test), test.deflection) < 0.01


@pytest.mark.parametrize(
    "groups", ["springs", "joints+", "-", "-springs", "weights", "force point+force sensor"]
)
def test_groups_that_are_unknown_or_do_not_bend_the_robot_are_refused(groups, few):
    robot, train = few
    with pytest.raises(ConfigError, match="groups"):
        BayesSprings(groups=groups).fit(train, robot=robot)


@pytest.mark.slow
def test_it_keeps_the_contract(fanuc):
    checks = check_model(BayesSprings, fanuc, uses_validation=False, load=load)
    failures = [str(check) for check in checks if check.status == "failed"]
    assert not failures, "\n".join(failures)
