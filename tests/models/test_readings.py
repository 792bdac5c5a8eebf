"""Check models of samples with one to three numbers along directions: a gauge's readings."""

from __future__ import annotations

from dataclasses import replace
from typing import get_args

import numpy as np
import pytest

from stiff_datasets.twin.kr10_twin import Kr10TwinOmni
from stiff_models.model_catalog import SpringModel, model_info
from stiff_protocols.contract.errors import ConfigError, StiffBenchWarning
from stiff_protocols.contract.stiffness_model import MODELS_OF_READINGS
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
