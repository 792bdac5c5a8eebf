"""Check a run, a fit and a score on readings along directions, as a user does them."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

import stiffbench as sb
from stiff_datasets.twin.kr10_twin import Kr10TwinOmni
from stiff_protocols.contract.errors import ConfigError

pytestmark = pytest.mark.filterwarnings("ignore::stiff_protocols.contract.errors.StiffBenchWarning")


@pytest.fixture(scope="module")
def gauge():
    """Return a data set with one number a row, along z and y in turn."""
    data = Kr10TwinOmni().load()
    samples = data.samples.take(np.arange(0, 150, 3))
    directions = np.eye(3)[2 - np.arange(len(samples)) % 2][:, None]
    moved = samples.deflection * directions[:, 0]
    samples = replace(samples, deflection=moved, directions=directions)
    return sb.Dataset.from_samples(samples, data.robot)


def test_a_run_on_readings_is_scored_along_them(gauge, tmp_path):
    sb.evaluate("vjm", gauge, splits=2, output=tmp_path)
    frame = sb.open_results(tmp_path).frame()  # as stored
    assert frame["reading_mm"].to_numpy() == pytest.approx(frame["norm_mm"].to_numpy())
    assert "mae_x_mm" not in frame
    model = sb.make_model("vjm").fit(gauge)
    scores = model.score(gauge).set_index("metric")["value"]
    assert scores["reading"] == pytest.approx(scores["norm"])
    assert "mae" not in scores
    assert model.cross_validated_error.mean < 5e-4


NOISE = 2e-7
"""m, of a reading."""
SPRINGS = np.array([2.0, 1.6, 2.0, 44.0, 11.0, 72.0]) * 1e-5
"""rad/(N m)."""


@pytest.fixture(scope="module")
def off_tcp_rows(gauge):
    """Return a data set of linear springs, read 30 mm from the TCP, along z and y in turn."""
    samples, robot = gauge.samples, gauge.robot
    point, noise = np.array([0.0, 0.03, 0.0]), np.random.default_rng(62)
    levers = robot.forward(samples.q).rotation @ point
    wrench = samples.wrench.copy()
    wrench[:, 3:] += np.cross(-levers, wrench[:, :3])
    arm = replace(robot, tcp=robot.tcp + point)
    deflection = arm.joint_deflection(SPRINGS, samples.q, wrench)
    moved = (deflection * samples.directions[:, 0]).sum(axis=1, keepdims=True)
    moved = (moved + noise.normal(scale=NOISE, size=moved.shape)) * samples.directions[:, 0]
    return sb.Dataset.from_samples(replace(samples, deflection=moved, levers=levers), robot)


def test_readings_of_a_point_are_scored_at_the_point(off_tcp_rows, tmp_path):
    model = sb.make_model("vjm").fit(off_tcp_rows)
    model.save(tmp_path / "model.stiff")
    read_back = sb.load_model(tmp_path / "model.stiff")
    error = (
        read_back.score(off_tcp_rows).set_index(["metric", "axis"])["value"]["reading", ""] / 1e3
    )
    samples, size = off_tcp_rows.samples, 5.0 * NOISE
    assert max(error, model.cross_validated_error.mean, *model.left_out_errors.mean(axis=0)) < size
    at_tcp = read_back.fitted.predict(samples.q, samples.wrench)
    assert np.abs(samples.read(at_tcp) - samples.values).mean() > 3.0 * size


@pytest.mark.slow
def test_runs_and_intervals_on_readings_of_a_point_are_scored_at_the_point(off_tcp_rows, tmp_path):
    options = {"metrics": ("reading", "coverage"), "coverage": 0.8}
    sb.evaluate(["vjm", "bayes-springs"], off_tcp_rows, splits=2, output=tmp_path, **options)
    frame = sb.open_results(tmp_path).frame()
    assert len(frame) == 4
    assert frame["reading_mm"].max() < 5e3 * NOISE
    assert frame["coverage_3d_percent"].min() > 60.0


def test_a_model_of_the_tcp_is_not_scored_on_readings_of_a_point(off_tcp_rows, gauge):
    vectors = sb.Dataset.from_samples(Kr10TwinOmni().load().samples, gauge.robot)
    with pytest.raises(ConfigError, match=r"other points.*bayes-springs"):
        sb.make_model("mean").fit(vectors).score(off_tcp_rows)


def test_a_model_of_vectors_is_refused_before_it_is_fitted(gauge):
    with pytest.raises(ConfigError, match="bayes-springs"):
        sb.make_model("mean").fit(gauge)
