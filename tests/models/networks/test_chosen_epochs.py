"""Check how cross-validation chooses the number of epochs."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from stiff_models.networks.mlp import Mlp
from stiff_models.networks.network_model import FOLDS, chosen_epochs
from stiff_models.transfer.ft_mlp import FtMlp

SMALL = {"width": 8, "device": "cpu"}


def samples_of(twin, n_poses, loads=1):
    rows = np.repeat(np.arange(n_poses), loads)
    return twin.samples.take(rows)


def test_every_row_is_held_out_once_with_all_rows_of_its_pose(twin):
    samples, parts = samples_of(twin, 23, loads=2), []

    def errors_of(learn, held_out):
        parts.append(held_out)
        assert not np.isin(samples.pose_id[held_out], samples.pose_id[learn]).any()
        assert len(learn) + len(held_out) == len(samples)
        return np.ones((2, len(held_out)))

    assert chosen_epochs(samples, (0, 10), errors_of, seed=1) == 0
    assert len(parts) == FOLDS
    np.testing.assert_array_equal(np.sort(np.concatenate(parts)), np.arange(len(samples)))


@pytest.mark.parametrize(
    ("gain", "scatter", "chosen"),
    [
        (0.0, 1.0, 0),  # nothing is gained
        (0.05, 1.0, 0),  # less than a standard error of the difference, 1/sqrt(100)
        (0.5, 1.0, 10),
        (0.05, 0.1, 10),  # the same gain on every pose, however much the poses differ
        (-0.5, 1.0, 0),
    ],
)
def test_more_epochs_are_taken_where_they_gain_a_standard_error(gain, scatter, chosen, twin):
    rng = np.random.default_rng(3)
    pose_errors = rng.uniform(1, 9, size=100)
    difference = rng.normal(size=100)
    difference = gain + scatter * (difference - difference.mean()) / difference.std()

    def errors_of(learn, held_out):
        return np.stack([pose_errors, pose_errors - difference])[:, held_out]

    assert chosen_epochs(samples_of(twin, 100), (0, 10), errors_of, seed=0) == chosen


def test_a_single_pose_is_trained_to_the_end(twin):
    one_pose = replace(twin.samples.take(np.arange(5)), pose_id=np.full(5, "p"))
    assert chosen_epochs(one_pose, (0, 30), lambda *_: pytest.fail("divided"), seed=0) == 30


@pytest.mark.slow
@pytest.mark.parametrize("cls", [Mlp, FtMlp])
def test_a_network_is_then_trained_so_long_on_all_rows(cls, parts, small_source):
    robot, train, held_out, _ = parts
    options = SMALL | ({"pretrain_steps": 5, "anchor": "vjm"} if cls is FtMlp else {})
    model = cls(**options, epochs=30).fit(train, robot=robot, validation=held_out, seed=2)
    epochs = model.best_params_["epochs"]
    assert not model.chooses_epoch() and epochs in (0, 10, 30)
    retrained_model = cls(**options, epochs=epochs, training="normal").fit(
        train, robot=robot, seed=2
    )
    assert not getattr(retrained_model, "best_params_", {})
    q, wrench = held_out.q, held_out.wrench
    np.testing.assert_array_equal(model.predict(q, wrench), retrained_model.predict(q, wrench))
