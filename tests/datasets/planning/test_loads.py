"""Check the sizes and directions of simulated loads."""

from __future__ import annotations

import numpy as np
import pytest

from stiff_datasets.planning.loads import TABLE_5, hook_wrenches, line_wrenches, omni_forces
from stiff_models.transfer.source_domain import PAPER_WRENCHES


def test_the_line_is_that_of_the_simulated_source_domain():
    np.testing.assert_array_equal(TABLE_5, PAPER_WRENCHES)


@pytest.mark.parametrize("payload", [5.0, 10.0, 165.0])
def test_line_loads_scale_with_the_payload_and_stay_within_it(payload):
    wrench = line_wrenches(20_000, payload, np.random.default_rng(0))
    assert np.linalg.norm(wrench[:, :3], axis=1).max() <= payload * 9.81 * (1 + 1e-12)
    middle = TABLE_5.mean(axis=0) * payload / 10.0
    # the heaviest loads are shrunk to the payload, a few per cent
    np.testing.assert_allclose(wrench[:, :3].mean(axis=0), middle[:3], atol=0.6 * payload)
    np.testing.assert_allclose(wrench[:, 3:].mean(axis=0), middle[3:], atol=0.06 * payload)


def test_line_loads_vary_along_the_line_far_more_than_across_it():
    wrench = line_wrenches(20_000, 10.0, np.random.default_rng(0)) / np.repeat([100.0, 10.0], 3)
    shares = np.linalg.svd(wrench - wrench.mean(axis=0), compute_uv=False) ** 2
    assert shares[0] / shares.sum() > 0.85


def test_omni_forces_have_every_direction_and_a_fifth_to_all_of_the_payload():
    force = omni_forces(20_000, 10.0, np.random.default_rng(0))
    size = np.linalg.norm(force, axis=1)
    assert 0.2 * 98.1 <= size.min() and size.max() <= 98.1
    direction = force / size[:, None]
    np.testing.assert_allclose(direction.T @ direction / len(force), np.eye(3) / 3, atol=0.01)
    np.testing.assert_allclose(direction.mean(axis=0), 0, atol=0.02)


def test_a_pull_at_a_hook_turns_about_the_lever():
    wrench = hook_wrenches(np.array([[0.0, 0.0, -10.0]]), np.array([[0.1, 0.0, 0.0]]))
    np.testing.assert_allclose(wrench, [[0, 0, -10, 0, 1, 0]])
