"""Gaps between the capsules along an arm are those of points sampled along them."""

from __future__ import annotations

import numpy as np

from stiff_datasets.planning.self_collision import (
    COLUMN,
    FOREARM,
    HAND,
    PAIRS,
    RADII,
    UPPER_ARM,
    self_clearance,
)

STEPS = np.linspace(0.0, 1.0, 101)[:, None]


def sampled_gap(points, first, second):
    """Return the gap of two capsules of one pose, from sampled centre lines."""
    ends = {
        COLUMN: (np.zeros(3), points[0]),
        UPPER_ARM: (points[1], points[2]),
        FOREARM: (points[3], points[4]),
        HAND: (points[4], points[6]),
    }
    lines = [ends[name][0] + STEPS * (ends[name][1] - ends[name][0]) for name in (first, second)]
    distance = np.linalg.norm(lines[0][:, None] - lines[1], axis=2).min()
    return distance - RADII[first] - RADII[second]


def test_the_smallest_gap_is_that_of_sampled_points_in_any_pose(kr10, kr10_chain, rng):
    q = rng.uniform(kr10.lower, kr10.upper, size=(20, 6))
    q[10:, 2:5] = np.deg2rad(rng.uniform((130, -10, 60), (156, 10, 120), size=(10, 3)))  # folded
    sampled = np.array(
        [min(sampled_gap(at, *pair) for pair in PAIRS) for at in kr10.forward(q).points]
    )
    found = self_clearance(kr10_chain, q)
    assert (found <= sampled + 1e-9).all()
    np.testing.assert_allclose(found, sampled, atol=2e-3)
    assert (found < 0).any() and (found > 0).any()


def test_an_upright_arm_is_clear_and_a_folded_one_is_not(kr10_chain):
    upright, folded = (0, -90, 0, 0, 0, 0), (0, -90, 156, 0, 120, 0)
    found = self_clearance(kr10_chain, np.deg2rad([upright, folded]))
    assert found[0] > 0.3 and found[1] < 0
