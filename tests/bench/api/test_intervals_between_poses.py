"""Intervals at random poses inside the joint box of the measured ones."""

from __future__ import annotations

import numpy as np
import pytest

import coverage_between_poses as between
import stiffbench as sb


@pytest.mark.filterwarnings("ignore:joint stiffness not identifiable.* J6")  # of the smallest arm
@pytest.mark.slow
@pytest.mark.parametrize("name", between.DATASETS[:2])
@pytest.mark.parametrize("key", ["vjm", "gp", "vjm-gp", "bayes-springs"])
def test_intervals_hold_between_the_measured_poses_where_nothing_is_marked(name, key):
    """docs/models.md has the figures; gp held 0.84 of kr10-twin before it knew distances."""
    dataset = sb.load_dataset(name)
    model = sb.make_model(key).fit(dataset)
    for loads in between.LOADS:
        coverage = between.held(dataset, model, loads)
        assert np.mean(coverage.near) >= 0.85
        if loads == "measured":
            assert coverage.marked < 0.3
        if coverage.marked:
            assert np.mean(coverage.far) >= 0.85
