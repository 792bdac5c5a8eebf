"""Check the learning curve's splits: nested training parts, the same test part."""

from __future__ import annotations

import itertools

import numpy as np
import pytest

from helpers.made_samples import learned, unloaded
from stiff_protocols.splits.sample_efficiency import SampleEfficiency


def test_every_size_of_a_draw_is_tested_on_the_same_poses_and_holds_the_smaller_sizes():
    splits = list(SampleEfficiency().splits(unloaded(151), n_splits=3, seed=0))
    assert [split.index for split in splits] == [0] * 6 + [1] * 6 + [2] * 6
    for draw in (splits[:6], splits[6:12], splits[12:]):
        sizes = [len(learned(split)) for split in draw]
        assert sizes == [5, 10, 20, 40, 80, 121]
        assert [split.condition for split in draw] == [f"n = {size}" for size in sizes]
        for smaller, larger in itertools.pairwise(draw):
            assert set(learned(smaller)) < set(learned(larger))
            np.testing.assert_array_equal(smaller.test, larger.test)
        assert len(larger.test) == 30
    splits = SampleEfficiency().splits(unloaded(43), n_splits=None, seed=0)  # 35 to learn from
    assert [split.condition for split in splits] == ["n = 5", "n = 10", "n = 20", "n = 35"]
    assert len(learned(splits[-1])) + len(splits[-1].test) == 43


@pytest.mark.parametrize(("size", "loads", "rows"), [(10, 1, [7, 3]), (1, 3, [3, 0])])
def test_validation_poses_come_out_of_the_subset_and_count(size, loads, rows):
    protocol = SampleEfficiency(sizes=str(size), validation_fraction=0.3)
    (split,) = protocol.splits(unloaded(40, loads), n_splits=None, seed=0)
    assert [len(split.train), len(split.validation)] == rows
