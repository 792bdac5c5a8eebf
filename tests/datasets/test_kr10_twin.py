"""The simulated data set."""

from __future__ import annotations

import numpy as np
import pytest

from stiff_datasets.kr10_twin import FORCE_LINE, FORCE_SCATTER, LARGEST_FORCE, Kr10Twin, draw_forces


@pytest.fixture(scope="module")
def data():
    return Kr10Twin().load()


def test_it_holds_151_poses_with_one_load_each(data):
    samples = data.samples
    assert len(samples) == len(set(samples.pose_id)) == 151
    assert (samples.group == "joint-space").sum() == 61
    assert (samples.group == "cartesian").sum() == 90


def test_the_same_seed_gives_the_same_data_and_another_seed_other_readings(data):
    assert Kr10Twin(seed=0).load().sha256 == data.sha256
    other = Kr10Twin(seed=1).load()
    assert other.sha256 != data.sha256
    np.testing.assert_array_equal(other.samples.q, data.samples.q)


def test_forces_stay_within_the_payload_and_near_the_line_of_table_5():
    forces = draw_forces(20_000, np.random.default_rng(0))
    assert np.linalg.norm(forces, axis=1).max() <= LARGEST_FORCE * (1 + 1e-12)
    direction = FORCE_LINE[1] - FORCE_LINE[0]
    direction /= np.linalg.norm(direction)
    across = forces - FORCE_LINE[0]
    across -= np.outer(across @ direction, direction)
    # two components of scatter; the payload pulls the strongest loads off the line a little
    assert np.sqrt((across**2).sum(axis=1).mean()) < 2 * np.sqrt(2) * FORCE_SCATTER


def test_torques_are_those_of_one_lever(data):
    wrench = data.samples.wrench
    # a torque r x F has no part along F, but for sensor noise
    along = (wrench[:, :3] * wrench[:, 3:]).sum(axis=1) / np.linalg.norm(wrench[:, :3], axis=1)
    assert np.abs(along).max() < 0.02
    assert np.linalg.norm(wrench[:, 3:], axis=1).max() < 11.0


def test_deflections_have_the_size_that_the_paper_reports(data):
    size_mm = np.linalg.norm(data.samples.deflection, axis=1) * 1000
    assert 0.3 < np.median(size_mm) < 3.0
    assert size_mm.max() < 10.0
