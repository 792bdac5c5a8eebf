"""Check processes over springs against dense formulas, differences and simpler models."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from scipy.stats import multivariate_normal
from sklearn.gaussian_process.kernels import Matern

from helpers.made_robots import chain, planar_arm, random_chain
from helpers.made_samples import samples_with
from stiff_datasets.twin.robot_twin import ArmFamily, Ur5Twin
from stiff_models import pose_folds
from stiff_models.physics.full_vjm import FullVjm
from stiff_models.physics.vjm import VirtualJointModel
from stiff_models.regressors.gp_springs import GpSprings
from stiff_models.regressors.spring_process import SpringProcess, likelihood_slopes
from stiff_protocols.contract.errors import StiffBenchWarning
from stiff_protocols.contract.types import BenchmarkData, Samples


@pytest.fixture(scope="module")
def twin() -> BenchmarkData:
    return ArmFamily(robot=2, world="clean").load()


def prepared_model(twin, n=15, **options):
    """Return a model with the loads of its first samples and its starting hyperparameters."""
    train = twin.samples.take(np.arange(n))
    model = GpSprings(**options)
    model.instrument_noise_, model.load_scale_ = 1e-5, np.abs(train.wrench).max(axis=0)
    loads = model._loads(twin.robot, train.q, train.wrench)
    hyper = model._hyperparameters(train, twin.robot, loads)
    return model, loads, hyper, train.deflection.T


def draw_theta(hyper, rng):
    start = np.array([prior.start for prior in hyper.priors.values()])
    return start + 0.3 * rng.normal(size=len(start))


@pytest.mark.parametrize(
    "options", [{}, {"springs": 6}, {"remainder": False, "lost_motion": False}]
)
def test_slopes_of_the_likelihood_are_its_differences(twin, options, rng):
    _, loads, hyper, deflection = prepared_model(twin, **options)
    theta = draw_theta(hyper, rng)

    def value(theta):
        return likelihood_slopes(hyper.covariance(theta), loads, deflection).value

    covariance = hyper.covariance(theta)
    slopes = hyper.slopes(covariance, likelihood_slopes(covariance, loads, deflection))
    steps = 1e-5 * np.eye(len(theta))
    differences = [(value(theta + step) - value(theta - step)) / 2e-5 for step in steps]
    np.testing.assert_allclose(slopes, differences, rtol=1e-5, atol=1e-5)


def dense(covariance, loads):
    """Return the covariance of deflections, computed spring by spring and axis by axis."""
    n = len(loads)
    matrix = np.zeros((3, n, 3, n))
    for s, scale in enumerate(covariance.scale):
        torques = np.concatenate([loads.loaded[s], loads.unloaded[s]])
        shape = Matern(covariance.length * scale, nu=1.5)(torques[:, None])
        lost = np.arctan(torques / (covariance.width * scale))
        curve = covariance.slope[s] * np.outer(torques, torques) + covariance.bend[s] * shape
        curve += covariance.lost[0, s] * np.outer(lost, lost)
        change = np.hstack([np.eye(n), -np.eye(n)])  # loaded minus unloaded
        load = loads.loaded[s] - loads.unloaded[s]
        loading_loss = 2.0 * np.arctan(load / (2.0 * covariance.width * scale))
        angle_covariance = change @ curve @ change.T + covariance.lost[1, s] * np.outer(
            loading_loss, loading_loss
        )
        matrix += np.einsum("an,nm,bm->anbm", loads.move[s], angle_covariance, loads.move[s])
    if covariance.remainder is not None:
        lengths = covariance.remainder.lengths
        remainder = covariance.remainder.variance * Matern(lengths, nu=2.5)(loads.features)
        remainder *= loads.load @ loads.load.T
        matrix += np.eye(3)[:, None, :, None] * remainder[None, :, None, :]
    return matrix.reshape(3 * n, 3 * n)


def test_likelihood_and_posterior_are_those_of_the_normal_that_the_equation_describes(twin, rng):
    _, loads, hyper, deflection = prepared_model(twin)
    covariance = hyper.covariance(draw_theta(hyper, rng))
    matrix = dense(covariance, loads)
    noisy = matrix + covariance.noise * np.eye(len(matrix))
    truth = multivariate_normal(cov=noisy).logpdf(deflection.ravel())
    assert likelihood_slopes(covariance, loads, deflection).value == pytest.approx(truth)

    train_loads, test_loads = loads.take(np.arange(10)), loads.take(np.arange(10, 15))
    train_rows = np.arange(45).reshape(3, 15)[:, :10].ravel()
    test_rows = np.setdiff1d(np.arange(45), train_rows)
    process = SpringProcess.of(covariance, train_loads, deflection[:, :10])
    gain = np.linalg.solve(
        noisy[np.ix_(train_rows, train_rows)], matrix[np.ix_(train_rows, test_rows)]
    ).T
    mean, deviation = process.mean_and_deviation(test_loads)
    np.testing.assert_allclose(mean.T.ravel(), gain @ deflection[:, :10].ravel(), atol=1e-9)
    np.testing.assert_allclose(process.mean(test_loads), mean, atol=1e-15)
    posterior = matrix[np.ix_(test_rows, test_rows)] - gain @ matrix[np.ix_(train_rows, test_rows)]
    expected = np.sqrt(np.diag(posterior) + covariance.noise)
    np.testing.assert_allclose(deviation.T.ravel(), expected, rtol=1e-6)
    process_covariance = process.between(test_loads, test_loads)
    for axis in range(3):
        block = posterior.reshape(3, 5, 3, 5)[axis, :, axis]
        np.testing.assert_allclose(
            process_covariance[axis], block, atol=1e-6 * np.abs(posterior).max()
        )


def with_deflection(twin, model):
    samples = twin.samples
    return replace(samples, deflection=model.predict(samples.q, samples.wrench))


def straight_covariance(hyper):
    """Return the covariance of straight springs of unknown slope with almost no noise."""
    theta = np.array([prior.start for prior in hyper.priors.values()])
    covariance = hyper.covariance(theta)
    return replace(
        covariance,
        slope=1e4 * covariance.slope,
        bend=0.0 * covariance.bend,
        lost=0.0 * covariance.lost,
        noise=1e-16,
        remainder=None,
    )


@pytest.mark.parametrize(("springs", "linear"), [(6, VirtualJointModel), (18, FullVjm)])
def test_straight_curves_are_the_linear_virtual_joint_model(twin, springs, linear):
    samples = with_deflection(twin, linear().fit(twin.samples, robot=twin.robot))
    train, test = samples.take(np.arange(60)), samples.take(np.arange(60, 151))
    model, loads, hyper, _ = prepared_model(replace(twin, samples=samples), 60, springs=springs)
    process = SpringProcess.of(straight_covariance(hyper), loads, train.deflection.T)
    predicted = process.mean(model._loads(twin.robot, test.q, test.wrench))
    expected = linear().fit(train, robot=twin.robot).predict(test.q, test.wrench)
    np.testing.assert_allclose(predicted, expected, atol=1e-3 * np.abs(test.deflection).max())


@pytest.mark.parametrize("kind", ["revolute", "prismatic"])
def test_every_joint_has_a_curve_and_three_stiffnesses_whatever_its_kind(kind, rng):
    robot = replace(random_chain(rng, (kind, *["revolute"] * 6)), masses=np.full(7, 2.0))
    q, wrench = rng.uniform(-1.0, 1.0, (12, 7)), 50.0 * rng.normal(size=(12, 6))
    deflection = robot.joint_deflection(1e-6 * np.ones(7), q, wrench)
    ids = np.arange(12).astype(str)
    samples = Samples(
        q=q, wrench=wrench, deflection=deflection, pose_id=ids, load_id=ids, group=ids
    )
    model = GpSprings(search_rows=12).fit(samples, robot=robot)
    assert [points.shape[1] for points in model.curves_.values()] == [3] * 7
    assert model.springs_.units[::3] == ("Nm/rad" if kind == "revolute" else "N/m", *["Nm/rad"] * 6)
    assert sum(name.startswith("lost motion ") for name in model.diagnostics_) == 7
    predicted = model.predict(q, wrench)
    assert np.abs(predicted - deflection).max() < 0.1 * np.abs(deflection).max()


ARCMIN = np.pi / 180.0 / 60.0
DOWN = (0.0, 1.0, 0.0)  # about y: an arm along x turns downwards


def wrist(mass=2.0):
    """Return an arm whose three joints turn about x, y and z, with masses [kg]."""
    placements = np.tile(np.eye(4), (3, 1, 1))
    placements[1:, 0, 3] = 0.5
    masses, centres = np.full(3, mass), np.tile([0.2, 0.1, 0.0], (3, 1))
    return chain(
        "wrist",
        ("revolute",) * 3,
        placements,
        axes=np.eye(3),
        tcp=np.array([0.3, 0.2, 0.1]),
        masses=masses,
        centres_of_mass=centres,
    )


def samples_by(robot, turn, noise, seed=0):
    """Return 60 samples of springs that turn by `turn` (a function of torque), with noise [m]."""
    rng = np.random.default_rng(seed)
    q = rng.uniform(-1.5, 1.5, (60, robot.n_joints))
    wrench = rng.normal(size=(60, 6)) * [100.0, 100.0, 100.0, 10.0, 10.0, 10.0]
    rows, weight = robot.jacobian(q), robot.gravity_torque(q)
    load = np.einsum("nki,nk->ni", rows, wrench)
    turns = turn(weight + load) - turn(weight)
    deflection = np.einsum("nki,ni->nk", rows[:, :3], turns) + noise * rng.normal(size=(60, 3))
    return samples_with(q, wrench, deflection)


def joint_springs(**options):
    return GpSprings(springs=6, remainder=False, **options)


def lost_motions(model):
    """Return the widths of lost motion, and their standard errors; None if none is found."""
    keys = [f"lost motion {name} [arcmin]" for name in model.robot_.joint_names]
    numbers = model.diagnostics_
    errors = [numbers.get(key.replace("motion", "motion standard error")) for key in keys]
    return [numbers[key] for key in keys], errors


def straight(torque):
    return 1e-5 * torque


def soft_first_slope(torque):
    """Return the turn of a gear that is twice as soft up to about a sixth of the largest torque."""
    return 1e-5 * torque + 1e-5 * np.clip(torque, -25.0, 25.0)


def lost_width(torque, width=0.6 * ARCMIN):
    return straight(torque) + width / 2.0 * np.tanh(torque / 4.0)


@pytest.mark.parametrize("turn", [straight, soft_first_slope])
@pytest.mark.parametrize("seed", range(4))
def test_a_robot_without_lost_motion_has_none_found_even_if_its_first_slope_is_soft(turn, seed):
    robot = wrist()
    model = joint_springs().fit(samples_by(robot, turn, 2e-5, seed), robot=robot)
    assert lost_motions(model) == ([0.0, 0.0, 0.0], [None, None, None])


@pytest.mark.parametrize("seed", range(4))
def test_a_lost_motion_is_found_within_three_standard_errors(seed):
    robot = wrist()
    model = joint_springs().fit(samples_by(robot, lost_width, 2e-5, seed), robot=robot)
    widths, errors = map(np.array, lost_motions(model))
    assert (errors < 0.15).all()
    assert (np.abs(widths - 0.6) < 3.0 * errors).all()


def test_no_lost_motion_is_negative_if_gears_stiffen_near_zero_torque():
    def stiff_at_zero(torque):
        return straight(torque) - 0.3 * ARCMIN * np.tanh(torque / 4.0)

    robot = wrist()
    model = joint_springs().fit(samples_by(robot, stiff_at_zero, 5e-6), robot=robot)
    assert (model.process_.lost_motion(np.arange(3))[0] < -0.3 * ARCMIN).all()
    assert lost_motions(model) == ([0.0, 0.0, 0.0], [None, None, None])


@pytest.mark.filterwarnings("ignore:.*no masses")
def test_a_width_is_the_turn_of_the_lost_motion_between_the_samples_extreme_torques():
    robot = wrist(mass=0.0)
    process = joint_springs().fit(samples_by(robot, lost_width, 5e-6), robot=robot).process_
    covariance, loads = process.covariance, process.loads
    only_lost = replace(covariance, slope=0.0 * covariance.slope, bend=0.0 * covariance.bend)
    noisy = covariance.between(loads, loads) + covariance.noise * np.eye(3 * len(loads))
    widths, errors = process.lost_motion(np.arange(3))
    for spring, torque in enumerate(loads.loaded):
        move, loaded = np.zeros((3, 3, 2)), np.zeros((3, 2))
        move[spring, 0], loaded[spring] = 1.0, [torque.min(), torque.max()]
        ends = replace(loads.take(slice(0, 2)), move=move, loaded=loaded, unloaded=0.0 * loaded)
        shared = only_lost.between(ends, loads)[:2]
        step = np.array([-1.0, 1.0])
        prior = step @ only_lost.between(ends, ends)[:2, :2] @ step
        variance = prior - step @ shared @ np.linalg.solve(noisy, shared.T @ step)
        assert widths[spring] == pytest.approx(step @ shared @ process.weights)
        assert errors[spring] == pytest.approx(np.sqrt(variance), rel=1e-3)


def test_curves_and_stiffnesses_stay_inside_the_torques_of_the_samples():
    robot, rng = planar_arm(1, DOWN, mass=3.0), np.random.default_rng(0)  # a weight of 29 N m
    wrench = np.zeros((40, 6))
    wrench[:, 2] = rng.uniform(-10.0, 10.0, 40)
    deflection = np.zeros((40, 3))
    deflection[:, 2] = 1e-5 * wrench[:, 2] + 1e-6 * rng.normal(size=40)
    q = np.zeros((40, 1))
    model = joint_springs().fit(samples_with(q, wrench, deflection), robot=robot)
    torque = robot.gravity_torque(q)[:, 0] - wrench[:, 2]
    curve = model.curves_["spring j1"][:, 0]
    np.testing.assert_allclose([curve[0], curve[-1]], [torque.min(), torque.max()])
    assert model.springs_.names == ("j1 at full torque",)
    assert not any("no torque" in name for name in model.diagnostics_)
    assert lost_motions(model) == ([0.0], [None])


def test_a_joint_without_torque_has_no_curve_and_no_stiffness():
    robot = replace(wrist(mass=0.0), tcp=np.array([0.3, 0.0, 0.0]))
    q, wrench = np.zeros((40, 3)), np.zeros((40, 6))
    wrench[:, 2] = np.linspace(-50.0, 50.0, 40)  # in a plane with the axes of joints 1 and 3
    deflection = np.zeros((40, 3))
    deflection[:, 2] = 1e-5 * wrench[:, 2]
    with pytest.warns(StiffBenchWarning, match="no masses"):
        model = joint_springs().fit(samples_with(q, wrench, deflection), robot=robot)
    assert [*model.curves_] == ["spring j2"]
    assert {name.split()[0] for name in model.springs_.names} == {"j2"}


@pytest.mark.slow
def test_the_bands_of_curves_hold_most_true_curves_where_no_link_bends():
    data = Ur5Twin().load()
    model = GpSprings().fit(data.samples, robot=data.robot)
    inside = []
    for joint, (torques, turn, deviation) in enumerate(
        points.T for points in model.curves_.values()
    ):
        torque = np.zeros((len(torques), 6))
        torque[:, joint] = torques
        true_turn = data.joint_turn(torque)[:, joint]
        inside.append((np.abs(turn - true_turn) < 2.0 * deviation).mean())
    assert np.median(inside) > 0.95
    assert np.mean(inside) > 0.75


@pytest.mark.slow
def test_a_point_that_lies_elsewhere_is_found_to_a_few_millimetres_by_the_likelihood(monkeypatch):
    monkeypatch.setattr(pose_folds, "FOLDS", 2)  # their fits take most of the time
    data = Ur5Twin().load()
    samples = data.samples.take(np.arange(0, 150, 2))
    card = replace(data.robot, tcp=data.robot.tcp + np.array([0.0, 0.0, 0.03]))
    model = GpSprings(tcp="fit").fit(samples, robot=card)
    assert model.geometry_ is not None
    offset = model.geometry_.robot.tcp - data.robot.tcp
    assert np.linalg.norm(offset) < 0.01
    assert (np.abs(offset) < 3.0 * np.sqrt(np.diag(model.geometry_.covariance))).all()
    true_point_model = GpSprings().fit(samples, robot=data.robot)
    q, wrench = samples.q, samples.wrench
    difference = model.predict(q, wrench) - true_point_model.predict(q, wrench)
    assert np.abs(difference).max() < 0.1 * np.abs(samples.deflection).max()
    at_card = model.predict_at_tcp(q, wrench)
    assert np.linalg.norm(at_card - model.predict(q, wrench), axis=1).mean() > 1e-5
