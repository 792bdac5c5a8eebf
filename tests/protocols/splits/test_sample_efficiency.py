"""The learning curve: nested subsets, one test part."""

from __future__ import annotations

import numpy as np
import pytest

from made_samples import learned, unloaded
from stiff_protocols.splits.sample_efficiency import SampleEfficiency


def by_index(splits):
    """Split index -> condition -> split."""
    found = {}
    for split in splits:
        found.setdefault(split.index, {})[split.condition] = split
    return found


def test_every_size_of_a_draw_is_tested_on_the_same_poses_and_holds_the_smaller_sizes():
    draws = by_index(SampleEfficiency().splits(unloaded(151), n_splits=3, seed=0))
    assert sorted(draws) == [0, 1, 2]
    for draw in draws.values():
        sizes = [len(learned(split)) for split in draw.values()]
        assert sizes == [5, 10, 20, 40, 80, 121]
        assert list(draw) == [f"n = {size}" for size in sizes]
        smaller = set()
        for split in draw.values():
            assert smaller < set(learned(split))
            smaller = set(learned(split))
            np.testing.assert_array_equal(split.test, draw["n = 5"].test)
        assert len(split.test) == 30


@pytest.mark.parametrize(("size", "loads", "rows"), [(10, 1, [7, 3]), (1, 3, [3, 0])])
def test_validation_poses_come_out_of_the_subset_and_count(size, loads, rows):
    protocol = SampleEfficiency(sizes=str(size), validation_fraction=0.3)
    (split,) = protocol.splits(unloaded(40, loads), n_splits=None, seed=0)
    assert [len(split.train), len(split.validation)] == rows


def test_sizes_beyond_the_training_side_become_one_with_all_of_it():
    splits = SampleEfficiency().splits(unloaded(43), n_splits=None, seed=0)
    assert [split.condition for split in splits] == ["n = 5", "n = 10", "n = 20", "n = 35"]
    assert len(learned(splits[-1])) + len(splits[-1].test) == 43
