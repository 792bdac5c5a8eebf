"""Check splits with errors of the force sensor, which only the test part has."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from helpers.made_samples import samples_with
from stiff_bench.run.execution import compute_fit
from stiff_protocols.contract.types import Samples
from stiff_protocols.splits.random_splits import Holdout
from stiff_protocols.splits.sensor_noise import SensorNoise

FIGURES = np.repeat([0.04, 0.002], 3)  # N, N m: facts of the ATI Axia80-M8 in the source paper
FITS = []


class RecordingModel:
    """Record the arguments of `fit`, and predict from the given wrench."""

    def fit(self, train, *, robot, validation=None, seed=0):
        FITS.append((train.wrench.tobytes(), validation.wrench.tobytes(), seed))
        return self

    def predict(self, q, wrench):
        return 1e-6 * wrench[:, :3]


@pytest.fixture(scope="module")
def many_samples() -> Samples:
    n = 20_000
    return samples_with(np.zeros((n, 6)), np.ones((n, 6)), np.zeros((n, 3)))


def errors(samples, n_splits=1, **options):
    """Return the first split's error per condition."""
    splits = SensorNoise(**options).splits(samples, n_splits=n_splits, seed=0)
    return {split.condition: split.wrench_error for split in splits if split.index == 0}


def test_every_level_tests_holdouts_divisions_and_its_error_changes_the_splits_hash(many_samples):
    some_samples = many_samples.take(np.arange(50))
    splits = SensorNoise(levels="-0.0,1,5,20").splits(some_samples, n_splits=2, seed=3)
    holdout_splits = Holdout().splits(some_samples, n_splits=2, seed=3)
    assert [(s.index, s.condition) for s in splits] == [
        (index, f"noise x{level}") for index in (0, 1) for level in (0, 1, 5, 20)
    ]
    for split in splits:
        assert split.rows_sha256 == holdout_splits[split.index].sha256
    assert splits[0].wrench_error is None and splits[0].sha256 == splits[0].rows_sha256
    assert len({split.sha256 for split in splits}) == 8


def test_noise_has_the_sensors_figures_as_its_standard_deviation_at_level_one(many_samples):
    noise = errors(many_samples, bias=0.0)["noise x1"]
    assert noise.shape == (4000, 6)
    np.testing.assert_allclose(noise.std(axis=0), FIGURES, rtol=0.05)
    np.testing.assert_allclose(noise.mean(axis=0), np.zeros(6), atol=4 / np.sqrt(4000) * 0.04)
    neighbours = np.corrcoef(noise[:-1, 0], noise[1:, 0])[0, 1]
    assert abs(neighbours) < 4 / np.sqrt(4000)  # independent from sample to sample


def test_bias_is_one_draw_per_split_with_the_same_standard_deviation(many_samples):
    some_samples = many_samples.take(np.arange(20))
    splits = SensorNoise(levels="1", noise=0.0).splits(some_samples, n_splits=100, seed=0)
    for split in splits:
        np.testing.assert_array_equal(split.wrench_error, split.wrench_error[:1].repeat(4, axis=0))
    biases = np.stack([split.wrench_error[0] for split in splits])
    np.testing.assert_allclose(biases.std(axis=0), FIGURES, rtol=0.25)


def test_levels_are_paired_multiples_of_the_same_draws(many_samples):
    level_errors = errors(many_samples, levels="20,0.5,1,1")
    assert list(level_errors) == ["noise x0.5", "noise x1", "noise x20"]
    np.testing.assert_allclose(level_errors["noise x20"], 20.0 * level_errors["noise x1"])
    np.testing.assert_allclose(level_errors["noise x0.5"], 0.5 * level_errors["noise x1"])
    np.testing.assert_allclose(
        level_errors["noise x1"],
        errors(many_samples, noise=0.0)["noise x1"] + errors(many_samples, bias=0.0)["noise x1"],
    )


def test_fits_are_the_same_at_every_level_and_know_no_error(tasks_of):
    FITS.clear()
    tasks = tasks_of(("vjm",), "fanuc-r2000ic", "sensor-noise")
    model = replace(tasks[0].model, cls=RecordingModel, params={}, context={})
    results = [compute_fit(replace(task, model=model, chooses_epoch=True), "r") for task in tasks]
    assert [result.failure for result in results] == [""] * 4
    split, samples = tasks[0].split, tasks[0].data.samples
    ((train, validation, _),) = set(FITS)
    assert len(FITS) == 4
    assert train == samples.wrench[split.train].tobytes()
    assert validation == samples.wrench[split.validation].tobytes()
    for task, result in zip(tasks, results, strict=True):
        wrench = task.split.told_wrench(samples)
        np.testing.assert_array_equal(result.prediction.predicted, 1e-6 * wrench[:, :3])
