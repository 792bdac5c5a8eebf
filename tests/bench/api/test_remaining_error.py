"""Expected remaining error: its source, and its place in a model file."""

from __future__ import annotations

import numpy as np
import pytest
from sklearn.model_selection import GroupKFold

import stiffbench as sb
from stiff_bench.api.remaining_error import NOT_KNOWN, expected_error
from stiff_protocols.contract.errors import DataError
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
    unknown = expected_error(old, q, wrench, None)
    assert unknown.values is None and unknown.source == NOT_KNOWN


def test_error_grows_away_from_training_and_an_interval_replaces_it(vjm, twin):
    q, wrench = twin.samples.q[:2], twin.samples.wrench[:2]
    mean = vjm.cross_validated_error.mean
    near = expected_error(vjm, q, wrench, None)
    np.testing.assert_allclose(near.values, mean)
    away = expected_error(vjm, q + np.eye(6)[5], wrench, None)
    stretch = vjm.training_range.stretch(q + np.eye(6)[5], wrench)
    np.testing.assert_allclose(away.values, mean * stretch)
    assert f"{stretch.max():.3g} times that away from" in away.source
    interval = vjm.predict_interval(q, wrench, 0.8)
    of_interval = expected_error(vjm, q, wrench, 0.8)
    half = 0.5 * np.linalg.norm(interval.upper - interval.lower, axis=1)
    np.testing.assert_allclose(of_interval.values, half)
    assert of_interval.source == "80% interval"


def test_data_of_one_pose_have_no_cross_validated_error(twin):
    first = sb.Dataset.from_samples(twin.samples.take(np.zeros(4, dtype=int)), twin.robot)
    model = sb.make_model("mean").fit(first)
    error = expected_error(model, first.samples.q, first.samples.wrench, None)
    assert error.values is None and error.source.startswith("not known: one pose")


def test_a_crafted_error_is_refused():
    with pytest.raises(DataError, match="expected lengths and counts"):
        CrossValidatedError(-1.0, 1.0, 1.0, 5, 5)
