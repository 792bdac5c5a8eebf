"""Expected errors: mean at left-out poses and half width, and their place in a model file."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pandas as pd
import pytest
from sklearn.model_selection import GroupKFold

import stiffbench as sb
from stiff_apply.example_path import example_path
from stiff_apply.expected_error import UNKNOWN, expected_error
from stiff_apply.tool_paths import compensate_path
from stiff_datasets.robots.shipped_robots import named_robot
from stiff_models.physics.vjm import VirtualJointModel
from stiff_protocols.contract.errors import ConfigError, DataError
from stiff_protocols.contract.types import BenchmarkData
from stiff_protocols.scoring.cross_validated import CrossValidatedError


def test_cross_validated_error_is_of_fits_that_did_not_learn_the_pose(vjm, twin):
    samples, lengths = twin.samples, []
    folds = GroupKFold(5, shuffle=True, random_state=0).split(samples.q, groups=samples.pose_id)
    for learned, left_out in folds:
        model = sb.make_model("vjm").fit(sb.Dataset.from_samples(samples.take(learned), twin.robot))
        off = model.predict(samples.q[left_out], samples.wrench[left_out])
        lengths.extend(np.linalg.norm(off - samples.deflection[left_out], axis=1))
    error = vjm.cross_validated_error
    assert error.mean == pytest.approx(np.mean(lengths))
    assert error.rms == pytest.approx(np.sqrt(np.mean(np.square(lengths))))
    assert error.quantile_90 == pytest.approx(np.quantile(lengths, 0.9))
    assert (error.n_samples, error.n_folds) == (len(samples), 5)


def test_a_file_keeps_the_error_and_one_without_it_is_read(vjm, twin, tmp_path):
    error, q, wrench = vjm.cross_validated_error, twin.samples.q, twin.samples.wrench
    vjm.save(tmp_path / "new.stiff")
    new = sb.load_model(tmp_path / "new.stiff")
    assert new.cross_validated_error == error
    model = sb.make_model("vjm").fit(twin)
    model.save(tmp_path / "old.stiff", cross_validate=False)
    old = sb.load_model(tmp_path / "old.stiff")
    assert old.cross_validated_error is None
    np.testing.assert_array_equal(old.predict(q, wrench), new.predict(q, wrench))
    unknown = expected_error(old, q, wrench, None).mean
    assert unknown.values is None and unknown.source == UNKNOWN


def test_error_grows_away_from_training_and_the_half_width_has_its_own_name(vjm, twin):
    q, wrench = twin.samples.q[:2], twin.samples.wrench[:2]
    mean = vjm.cross_validated_error.mean
    near = expected_error(vjm, q, wrench, None)
    np.testing.assert_allclose(near.mean.values, mean)
    assert (near.half_width.values > near.mean.values).all()
    assert near.half_width.name == "90 % interval, half width"
    away = expected_error(vjm, q + np.eye(6)[5], wrench, None).mean
    stretch = vjm.training_range.stretch(q + np.eye(6)[5], wrench)
    np.testing.assert_allclose(away.values, mean * stretch)
    assert f"{stretch.max():.3g} times that away from" in away.source
    interval = vjm.predict_interval(q, wrench, 0.8)
    of_interval = expected_error(vjm, q, wrench, 0.8)
    half = 0.5 * np.linalg.norm(interval.upper - interval.lower, axis=1)
    np.testing.assert_allclose(of_interval.half_width.values, half)
    assert of_interval.half_width.name == "80 % interval, half width"
    np.testing.assert_allclose(of_interval.mean.values, mean)


@pytest.mark.slow
@pytest.mark.parametrize("name", ["vjm", "gp"])
def test_models_with_and_without_own_intervals_print_both_numbers(name, twin, tmp_path):
    rows = np.arange(0, len(twin.samples), 5)
    data = sb.Dataset.from_samples(twin.samples.take(rows), twin.robot)
    model = sb.make_model(name, **({"restarts": 0} if name == "gp" else {})).fit(data)
    example_path(tmp_path / "path.csv", points=5, model=model)
    corrected = compensate_path(model, tmp_path / "path.csv", tmp_path / "new.csv")
    written = pd.read_csv(tmp_path / "new.csv")
    np.testing.assert_allclose(1e3 * corrected.expected_error, written["expected_error_mm"])
    np.testing.assert_allclose(1e3 * corrected.half_width, written["half_width_mm"], atol=1e-8)
    np.testing.assert_allclose(corrected.expected_error, model.cross_validated_error.mean, rtol=0.5)
    for text in (str(corrected), model.report(data, 0)):
        assert str(text).count("expected error, mean at left-out poses: ") == 1
        assert str(text).count("90 % interval, half width: ") == 1


class Rig(VirtualJointModel):
    """Springs whose rig reads 1 mm more along x than the robot moves."""

    def fit(self, train, **options):
        bent = train.deflection - np.array([1e-3, 0.0, 0.0])
        return super().fit(replace(train, deflection=bent), **options)

    def predict_reading(self, q, wrench):
        return self.predict(q, wrench) + np.array([1e-3, 0.0, 0.0])


def test_readings_are_compared_with_predicted_readings(vjm, twin):
    shift = np.array([1e-3, 0.0, 0.0])
    shifted = replace(twin.samples, deflection=twin.samples.deflection + shift)
    data = sb.Dataset.from_samples(shifted, twin.robot)
    model = sb.make_model(Rig).fit(data)
    assert model.cross_validated_error.mean == pytest.approx(vjm.cross_validated_error.mean)
    score, usual = model.score(data), vjm.score(twin)
    absolute = slice(24)  # the last numbers are shares of the deflection
    np.testing.assert_allclose(score["value"][absolute], usual["value"][absolute], rtol=1e-6)


def test_samples_of_another_tcp_or_robot_are_not_scored(vjm, twin):
    moved = replace(twin.robot, tcp=twin.robot.tcp + np.array([0.0, 0.0, 0.05]))
    for robot in (moved, named_robot("ur5").robot()):
        data = BenchmarkData(twin.samples, robot)
        with pytest.raises(ConfigError, match=f"is of {robot.name}.*vjm was fitted to kr10"):
            vjm.score(data)


def test_data_of_one_pose_have_no_cross_validated_error(twin):
    first = sb.Dataset.from_samples(twin.samples.take(np.zeros(4, dtype=int)), twin.robot)
    model = sb.make_model("mean").fit(first)
    error = expected_error(model, first.samples.q, first.samples.wrench, None)
    for lengths in (error.mean, error.half_width):
        assert lengths.values is None and lengths.source.startswith("not known: ")


def test_a_crafted_error_is_refused():
    with pytest.raises(DataError, match="expected lengths and counts"):
        CrossValidatedError(-1.0, 1.0, 1.0, 5, 5)
