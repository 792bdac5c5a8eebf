"""Check models of samples with one to three numbers along directions: a gauge's readings."""

from __future__ import annotations

from dataclasses import replace
from typing import get_args

import numpy as np
import pytest

from stiff_datasets.twin.kr10_twin import Kr10TwinOmni
from stiff_models.model_catalog import SpringModel, model_info
from stiff_models.physics.fitted_geometry import moved_wrench
from stiff_protocols.contract.errors import ConfigError, StiffBenchWarning
from stiff_protocols.contract.stiffness_model import MODELS_OF_READINGS, predicted_readings
from stiff_protocols.contract.types import Prediction, Samples
from stiff_protocols.scoring.conformal import SplitConformal
from stiff_protocols.scoring.metrics import METRICS

SLOW_LAST = (
    *(key for key in MODELS_OF_READINGS if key not in ("bayes-springs", "fourier-springs")),
    pytest.param("bayes-springs", marks=pytest.mark.slow),
    pytest.param("fourier-springs", marks=pytest.mark.slow),
)
pytestmark = pytest.mark.filterwarnings("ignore::stiff_protocols.contract.errors.StiffBenchWarning")
Z = np.array([0.0, 0.0, 1.0])


def read_along(samples, directions):
    """Return the samples as read along (n, m, 3) directions."""
    without = replace(samples, directions=np.empty(0))
    seen = np.linalg.pinv(directions) @ (directions @ without.deflection[..., None])
    return replace(without, deflection=seen[..., 0], directions=directions)


def one_axis(samples):
    """Return the samples as read along x, y and z in turn."""
    return read_along(samples, np.eye(3)[np.arange(len(samples)) % 3][:, None])


def quick(key):
    return model_info(key).load()()


@pytest.fixture(scope="module")
def rows():
    """Return robot, training and test samples under forces in all directions."""
    data = Kr10TwinOmni().load()
    return data.robot, data.samples.take(np.arange(0, 90)), data.samples.take(np.arange(90, 151))


@pytest.fixture(scope="module")
def weights(rows):
    """Return robot and samples under hanging weights, deflections of springs of usual sizes."""
    robot, train, _ = rows
    wrench = np.zeros((len(train), 6))
    wrench[:, 2] = -np.linspace(20.0, 80.0, len(train))
    deflection = robot.joint_deflection(np.full(6, 2e-5), train.q, wrench)
    return robot, replace(train, wrench=wrench, deflection=deflection)


def test_the_models_that_a_refusal_names_are_the_spring_models():
    assert set(MODELS_OF_READINGS) == {*get_args(SpringModel)}
    assert all(quick(key).takes_directions for key in MODELS_OF_READINGS)
    assert all(quick(key).takes_levers for key in MODELS_OF_READINGS)


@pytest.mark.parametrize("key", ["mean", "gp", "vjm-gp"])
def test_other_models_refuse_readings_and_name_those_that_take_them(key, rows):
    robot, train, _ = rows
    with pytest.raises(ConfigError, match=r"bayes-springs.*vjm-full"):
        quick(key).fit(one_axis(train), robot=robot)


@pytest.mark.parametrize("key", SLOW_LAST)
def test_readings_along_x_y_and_z_are_the_deflection(key, rows):
    robot, train, test = rows
    part = train.take(np.arange(0, 90, 4))
    same = replace(part, directions=np.tile(np.eye(3), (len(part), 1, 1)))
    padded = Samples.together(one_axis(part.take(np.array([0]))), part).take(np.arange(1, 24))
    predicted = [
        quick(key).fit(samples, robot=robot).predict(test.q, test.wrench)
        for samples in (part, same, padded)
    ]
    np.testing.assert_allclose(predicted[1], predicted[0], atol=2e-7)
    np.testing.assert_allclose(predicted[2], predicted[0], atol=2e-7)


@pytest.mark.parametrize("key", SLOW_LAST)
def test_three_single_numbers_teach_about_as_much_as_one_vector(key, rows):
    robot, train, test = rows

    def error(samples):
        model = quick(key).fit(samples, robot=robot)
        return np.linalg.norm(model.predict(test.q, test.wrench) - test.deflection, axis=1).mean()

    assert error(one_axis(train)) < 2.0 * error(train.take(np.arange(0, 90, 3)))


@pytest.fixture(scope="module")
def off_tcp_rows(rows):
    """Return robot, single numbers read at another point in every row, and their truth at the TCP.

    Springs are linear. Robots whose TCP is the point move as far under the same load.
    """
    robot, train, _ = rows
    rng, compliance = np.random.default_rng(62), np.array([2.0, 1.6, 2.0, 44.0, 11.0, 72.0]) * 1e-5
    wrench = np.hstack([train.wrench[:, :3], rng.normal(size=(len(train), 3))])
    points = robot.tcp + rng.uniform(-0.1, 0.1, (len(train), 3))
    rotation = robot.forward(train.q).rotation
    levers = np.einsum("nij,nj->ni", rotation, points - robot.tcp)
    loads = moved_wrench(wrench, -levers)
    deflection = np.vstack(
        [
            replace(robot, tcp=point).joint_deflection(compliance, q[None], load[None])
            for point, q, load in zip(points, train.q, loads, strict=True)
        ]
    )
    samples = one_axis(replace(train, wrench=wrench, deflection=deflection))
    truth = robot.joint_deflection(compliance, train.q, wrench)
    return robot, replace(samples, levers=levers), truth, deflection


@pytest.mark.parametrize("key", SLOW_LAST)
def test_readings_of_other_points_than_the_tcp_teach_its_deflection(key, off_tcp_rows):
    robot, samples, truth, at_points = off_tcp_rows
    model = quick(key).fit(samples, robot=robot)
    careless = quick(key).fit(replace(samples, levers=np.empty(0)), robot=robot)

    def error(predicted, truth=truth):
        return np.linalg.norm(predicted - truth, axis=1).mean()

    loads = samples.q, samples.wrench
    assert error(model.predict(*loads)) < 0.02 * np.linalg.norm(truth, axis=1).mean()
    assert error(model.predict(*loads)) < 0.2 * error(careless.predict(*loads))
    readings = predicted_readings(model, *loads, samples.levers)
    assert error(readings, at_points) < 0.02 * np.linalg.norm(truth, axis=1).mean()


@pytest.mark.parametrize("key", SLOW_LAST)
def test_a_point_moves_as_the_tcp_of_a_robot_whose_tcp_it_is(key, off_tcp_rows):
    robot, samples, _, _ = off_tcp_rows
    rig = {"groups": "-force point+force sensor"} if key == "bayes-springs" else {}
    model = quick(key).set_params(**rig).fit(samples, robot=robot)
    point = np.array([0.03, -0.02, 0.05])  # from the TCP, last joint's frame
    levers = robot.forward(samples.q).rotation @ point
    predicted = predicted_readings(model, samples.q, samples.wrench, levers)
    load = moved_wrench(samples.wrench, -levers)
    there = model.predict_at_point(samples.q, load, robot.tcp + point)
    np.testing.assert_allclose(predicted, there, rtol=0.0, atol=1e-12)


def test_a_fitted_measured_point_and_models_of_the_tcp_refuse_readings_of_other_points(
    off_tcp_rows,
):
    robot, samples, _, _ = off_tcp_rows
    with pytest.raises(ConfigError, match=r"tcp='fit'.*tcp='given'"):
        quick("vjm").set_params(tcp="fit").fit(samples, robot=robot)
    of_tcp = quick("vjm").set_params(tcp="fit").fit(replace(samples, levers=[]), robot=robot)
    vectors = replace(samples, directions=[], levers=[])
    for model in (of_tcp, quick("mean").fit(vectors, robot=robot)):
        with pytest.raises(ConfigError, match="points"):
            predicted_readings(model, samples.q, samples.wrench, samples.levers)
    plugin = quick("vjm")
    plugin.takes_levers = False  # of a plugin that learns from directions only
    with pytest.raises(ConfigError, match="other points"):
        plugin.fit(samples, robot=robot)


def test_a_fitted_lever_of_the_force_leaves_the_points_that_were_read(off_tcp_rows):
    robot, samples, truth, _ = off_tcp_rows
    offset = np.array([0.0, 0.04, 0.03])
    written = moved_wrench(samples.wrench, -(robot.forward(samples.q).rotation @ offset))
    fitted = quick("vjm").set_params(lever="fit").fit(replace(samples, wrench=written), robot=robot)
    assert np.abs(fitted.geometry_.lever - offset).max() < 1e-3
    error = np.linalg.norm(fitted.predict(samples.q, written) - truth, axis=1).mean()
    assert error < 0.02 * np.linalg.norm(truth, axis=1).mean()


def test_conformal_intervals_of_other_points_are_as_narrow_as_the_readings_allow(off_tcp_rows):
    robot, samples, _, _ = off_tcp_rows
    widths = [
        SplitConformal(quick("vjm"), coverage=0.8).fit(rows, robot=robot).residuals_.max()
        for rows in (samples, replace(samples, levers=[]))
    ]
    assert widths[0] < 0.05 * widths[1]


@pytest.mark.slow
def test_oblique_readings_and_rows_of_two_numbers_are_read(rows, rng):
    robot, train, test = rows
    directions = rng.normal(size=(len(train), 2, 3))
    directions /= np.linalg.norm(directions, axis=2, keepdims=True)
    directions[::2, 1] = 0.0
    model = quick("bayes-springs").fit(read_along(train, directions), robot=robot)
    errors = np.linalg.norm(model.predict(test.q, test.wrench) - test.deflection, axis=1)
    assert errors.mean() < 0.05 * np.linalg.norm(test.deflection, axis=1).mean()
    interval = model.predict_interval(test.q, test.wrench, 0.9)
    inside = (interval.lower <= test.deflection) & (test.deflection <= interval.upper)
    assert 0.75 < inside.mean() <= 1.0
    assert model.fold_errors_.shape == (len(train), 3)


@pytest.mark.parametrize("key", SLOW_LAST)
def test_a_joint_that_no_load_turns_is_named_and_as_soft_as_joints_of_its_size(key, weights):
    robot, samples = weights
    directions = np.tile(Z, (len(samples), 1, 1))
    with pytest.warns(StiffBenchWarning) as caught:
        model = quick(key).fit(read_along(samples, directions), robot=robot)
    named = [str(warning.message) for warning in caught]
    assert any("no load turns A1" in text and "a horizontal pull" in text for text in named)
    sideways = samples.wrench[:, [1, 2, 0, 3, 4, 5]]  # along y
    predicted, turned = model.predict(samples.q, sideways), robot.joint_deflection
    by_first = np.linalg.norm(turned(np.eye(6)[0] * 2e-5, samples.q, sideways), axis=1).mean()
    by_others = turned(np.array([0.0, *[2e-5] * 5]), samples.q, sideways)
    extra = np.linalg.norm(predicted - by_others, axis=1).mean()
    assert 0.2 * by_first < extra < 5.0 * by_first


@pytest.mark.slow
def test_the_intervals_of_bayes_springs_know_that_a_joint_was_never_turned(weights):
    robot, samples = weights
    with pytest.warns(StiffBenchWarning, match="no load turns A1"):
        model = quick("bayes-springs").fit(samples, robot=robot)
    sideways = samples.wrench[:, [1, 2, 0, 3, 4, 5]]
    widths = [
        model.deviation(samples.q, wrench, reading=False).mean()
        for wrench in (samples.wrench, sideways)
    ]
    assert widths[1] > 10.0 * widths[0]


def test_a_turn_that_no_gauge_shows_is_named(rows):
    robot, train, _ = rows
    wrench = np.tile([0.0, 50.0, -50.0, 0.0, 0.0, 0.0], (len(train), 1))
    deflection = robot.joint_deflection(np.full(6, 2e-5), train.q, wrench)
    pull = replace(train, wrench=wrench, deflection=deflection)
    upwards = read_along(pull, np.tile(Z, (len(pull), 1, 1)))
    with pytest.warns(StiffBenchWarning, match="no reading shows a turn of A1"):
        quick("vjm").fit(upwards, robot=robot)


def test_metrics_of_readings_count_their_numbers(rng):
    directions = rng.normal(size=(40, 1, 3))
    directions /= np.linalg.norm(directions, axis=2, keepdims=True)
    truth, errors = rng.normal(size=(40, 3)), rng.normal(size=(40, 3))
    measured = read_along(
        Samples(
            q=np.zeros((40, 6)),
            wrench=np.zeros((40, 6)),
            deflection=truth,
            **dict.fromkeys(("pose_id", "load_id", "group"), np.arange(40).astype(str)),
        ),
        directions,
    ).deflection
    prediction = Prediction(np.arange(40), truth + errors, measured, directions=directions)
    expected = np.abs((directions[:, 0] * errors).sum(axis=1)).mean()
    for key in ("reading", "norm"):
        assert METRICS[key].values(prediction)[""] == pytest.approx(expected)
    assert METRICS["mae"].values(prediction) == {}


def test_conformal_intervals_of_readings_hold_the_readings(rows):
    robot, train, test = rows
    samples = one_axis(train)
    model = SplitConformal(quick("vjm"), coverage=0.8).fit(samples, robot=robot)
    interval, read = model.predict_interval(test.q, test.wrench, 0.8), one_axis(test)
    prediction = Prediction(
        np.arange(len(test)),
        model.predict(test.q, test.wrench),
        read.deflection,
        interval,
        directions=read.directions,
    )
    assert 0.6 < METRICS["coverage-3d"].values(prediction)[""] <= 1.0
