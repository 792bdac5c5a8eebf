"""Processes over springs: dense formulas, finite differences, and the models they contain."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from scipy.stats import multivariate_normal
from sklearn.gaussian_process.kernels import Matern

from helpers.made_robots import random_chain
from stiff_datasets.twin.robot_twin import ArmFamily, Ur5Twin
from stiff_models import fitted_model
from stiff_models.physics.full_vjm import FullVjm
from stiff_models.physics.vjm import VirtualJointModel
from stiff_models.regressors.gp_springs import GpSprings
from stiff_models.regressors.spring_process import SpringProcess, likelihood_slopes
from stiff_protocols.contract.types import BenchmarkData, Samples


@pytest.fixture(scope="module")
def twin() -> BenchmarkData:
    return ArmFamily(robot=0).load()


def prepared(twin, n=15, **options):
    """A model with the loads of its first samples and its hyperparameters, before any search."""
    train = twin.samples.take(np.arange(n))
    model = GpSprings(**options)
    model.instrument_noise_, model.load_scale_ = 1e-5, np.abs(train.wrench).max(axis=0)
    loads = model._loads(twin.robot, train.q, train.wrench)
    hyper = model._hyperparameters(train, twin.robot, loads)
    return model, loads, hyper, train.deflection.T


def some(hyper, rng):
    start = np.array([prior.start for prior in hyper.priors.values()])
    return start + 0.3 * rng.normal(size=len(start))


@pytest.mark.parametrize(
    "options", [{}, {"springs": 6}, {"remainder": False, "lost_motion": False}]
)
def test_slopes_of_the_likelihood_are_its_differences(twin, options, rng):
    _, loads, hyper, deflection = prepared(twin, **options)
    theta = some(hyper, rng)

    def value(theta):
        return likelihood_slopes(hyper.covariance(theta), loads, deflection).value

    covariance = hyper.covariance(theta)
    slopes = hyper.slopes(covariance, likelihood_slopes(covariance, loads, deflection))
    steps = 1e-5 * np.eye(len(theta))
    differences = [(value(theta + step) - value(theta - step)) / 2e-5 for step in steps]
    np.testing.assert_allclose(slopes, differences, rtol=1e-5, atol=1e-5)


def dense(covariance, loads):
    """The covariance of deflections, spring by spring and axis by axis, as the equation has it."""
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
        again = 2.0 * np.arctan(load / (2.0 * covariance.width * scale))
        turned = change @ curve @ change.T + covariance.lost[1, s] * np.outer(again, again)
        matrix += np.einsum("an,nm,bm->anbm", loads.move[s], turned, loads.move[s])
    if covariance.remainder is not None:
        lengths = covariance.remainder.lengths
        rest = covariance.remainder.variance * Matern(lengths, nu=2.5)(loads.features)
        rest *= loads.load @ loads.load.T
        matrix += np.eye(3)[:, None, :, None] * rest[None, :, None, :]
    return matrix.reshape(3 * n, 3 * n)


def test_likelihood_and_posterior_are_those_of_the_normal_that_the_equation_describes(twin, rng):
    _, loads, hyper, deflection = prepared(twin)
    covariance = hyper.covariance(some(hyper, rng))
    whole = dense(covariance, loads)
    noisy = whole + covariance.noise * np.eye(len(whole))
    truth = multivariate_normal(cov=noisy).logpdf(deflection.ravel())
    assert likelihood_slopes(covariance, loads, deflection).value == pytest.approx(truth)

    first, last = loads.take(np.arange(10)), loads.take(np.arange(10, 15))
    known = np.arange(45).reshape(3, 15)[:, :10].ravel()
    new = np.setdiff1d(np.arange(45), known)
    process = SpringProcess.of(covariance, first, deflection[:, :10])
    gain = np.linalg.solve(noisy[np.ix_(known, known)], whole[np.ix_(known, new)]).T
    mean, deviation = process.mean_and_deviation(last)
    np.testing.assert_allclose(mean.T.ravel(), gain @ deflection[:, :10].ravel(), atol=1e-9)
    np.testing.assert_allclose(process.mean(last), mean, atol=1e-15)
    left = whole[np.ix_(new, new)] - gain @ whole[np.ix_(known, new)]
    expected = np.sqrt(np.diag(left) + covariance.noise)
    np.testing.assert_allclose(deviation.T.ravel(), expected, rtol=1e-6)
    together = process.between(last, last)
    for axis in range(3):
        block = left.reshape(3, 5, 3, 5)[axis, :, axis]
        np.testing.assert_allclose(together[axis], block, atol=1e-6 * np.abs(left).max())


def with_deflection(twin, model):
    samples = twin.samples
    return replace(samples, deflection=model.predict(samples.q, samples.wrench))


def straight(hyper):
    """Springs of unknown slope and nothing else, next to no noise."""
    theta = np.array([prior.start for prior in hyper.priors.values()])
    found = hyper.covariance(theta)
    return replace(
        found,
        slope=1e4 * found.slope,
        bend=0.0 * found.bend,
        lost=0.0 * found.lost,
        noise=1e-16,
        remainder=None,
    )


@pytest.mark.parametrize(("springs", "linear"), [(6, VirtualJointModel), (18, FullVjm)])
def test_straight_curves_are_the_linear_virtual_joint_model(twin, springs, linear):
    samples = with_deflection(twin, linear().fit(twin.samples, robot=twin.robot))
    train, test = samples.take(np.arange(60)), samples.take(np.arange(60, 151))
    model, loads, hyper, _ = prepared(replace(twin, samples=samples), 60, springs=springs)
    process = SpringProcess.of(straight(hyper), loads, train.deflection.T)
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
    assert sum(name.startswith("lost motion ") for name in model.diagnostics_) == 14
    predicted = model.predict(q, wrench)
    assert np.abs(predicted - deflection).max() < 0.1 * np.abs(deflection).max()


@pytest.mark.slow
def test_the_bands_of_curves_hold_most_true_curves_where_no_link_bends():
    data = Ur5Twin().load()
    model = GpSprings().fit(data.samples, robot=data.robot)
    inside = []
    for joint, (at, turn, deviation) in enumerate(points.T for points in model.curves_.values()):
        torque = np.zeros((len(at), 6))
        torque[:, joint] = at
        true = data.joint_turn(torque)[:, joint]
        inside.append((np.abs(turn - true) < 2.0 * deviation).mean())
    assert np.median(inside) > 0.95
    assert np.mean(inside) > 0.75


@pytest.mark.slow
def test_a_point_that_lies_elsewhere_is_found_to_a_few_millimetres_by_the_likelihood(monkeypatch):
    monkeypatch.setattr(fitted_model, "FOLDS", 2)  # their fits take most of the time
    data = Ur5Twin().load()
    samples = data.samples.take(np.arange(0, 150, 2))
    card = replace(data.robot, tcp=data.robot.tcp + np.array([0.0, 0.0, 0.03]))
    model = GpSprings(tcp="fit").fit(samples, robot=card)
    assert model.geometry_ is not None
    away = model.geometry_.robot.tcp - data.robot.tcp
    assert np.linalg.norm(away) < 0.01
    assert (np.abs(away) < 3.0 * np.sqrt(np.diag(model.geometry_.covariance))).all()
    given = GpSprings().fit(samples, robot=data.robot)
    q, wrench = samples.q, samples.wrench
    difference = model.predict(q, wrench) - given.predict(q, wrench)
    assert np.abs(difference).max() < 0.1 * np.abs(samples.deflection).max()
    at_card = model.predict_at_tcp(q, wrench)
    assert np.linalg.norm(at_card - model.predict(q, wrench), axis=1).mean() > 1e-5
