"""The learning curve: nested subsets, one test part."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from made_samples import samples_with
from stiff_protocols.contract.errors import ConfigError
from stiff_protocols.splits.sample_efficiency import SampleEfficiency


def samples_of(n_poses, loads=1):
    n = n_poses * loads
    samples = samples_with(np.zeros((n, 6)), np.zeros((n, 6)), np.zeros((n, 3)))
    return replace(samples, pose_id=np.repeat([f"p{i}" for i in range(n_poses)], loads))


def by_index(splits):
    """Split index -> condition -> split."""
    found = {}
    for split in splits:
        found.setdefault(split.index, {})[split.condition] = split
    return found


def learned(split):
    return set(split.train) | set(split.validation)


def test_every_size_of_a_draw_is_tested_on_the_same_poses_and_holds_the_smaller_sizes():
    draws = by_index(SampleEfficiency().splits(samples_of(151), n_splits=3, seed=0))
    assert sorted(draws) == [0, 1, 2]
    for draw in draws.values():
        sizes = [len(learned(split)) for split in draw.values()]
        assert sizes == [5, 10, 20, 40, 80, 121]
        assert list(draw) == [f"n = {size}" for size in sizes]
        smaller = set()
        for split in draw.values():
            assert smaller < learned(split)
            smaller = learned(split)
            np.testing.assert_array_equal(split.test, draw["n = 5"].test)
        assert len(split.test) == 30


def test_draws_differ_in_test_part_and_subsets():
    first, second = by_index(SampleEfficiency().splits(samples_of(50), n_splits=2, seed=0)).values()
    assert set(first["n = 5"].test) != set(second["n = 5"].test)
    assert learned(first["n = 10"]) != learned(second["n = 10"])


def test_validation_poses_come_out_of_the_subset_and_count():
    protocol = SampleEfficiency(sizes="10", validation_fraction=0.3)
    (split,) = protocol.splits(samples_of(40), n_splits=None, seed=0)
    assert [len(split.train), len(split.validation)] == [7, 3]


def test_a_subset_of_one_pose_has_no_validation_part():
    (split,) = SampleEfficiency(sizes="1").splits(samples_of(10, 3), n_splits=None, seed=0)
    assert [len(split.train), len(split.validation)] == [3, 0]


def test_sizes_count_poses_and_no_pose_stands_on_two_sides():
    samples = samples_of(30, 4)
    for split in SampleEfficiency(sizes="3,12").splits(samples, n_splits=2, seed=1):
        parts = [set(samples.pose_id[rows]) for rows in (split.train, split.validation, split.test)]
        assert len(parts[0] | parts[1]) == int(split.condition.removeprefix("n = "))
        assert sum(map(len, parts)) == len(set.union(*parts))
        rows = np.concatenate([split.train, split.validation, split.test])
        assert len(rows) == 4 * len(set.union(*parts))


def test_sizes_beyond_the_training_side_become_one_with_all_of_it():
    splits = SampleEfficiency().splits(samples_of(43), n_splits=None, seed=0)
    assert [split.condition for split in splits] == ["n = 5", "n = 10", "n = 20", "n = 35"]
    assert len(learned(splits[-1])) + len(splits[-1].test) == 43


def test_a_draw_does_not_depend_on_how_many_draws_there_are():
    one, three = (SampleEfficiency().splits(samples_of(60), n_splits=n, seed=5) for n in (1, 3))
    assert [s.sha256 for s in one] == [s.sha256 for s in three[: len(one)]]


def test_the_same_seed_gives_the_same_draws_and_another_seed_others():
    first, again, other = (
        [s.sha256 for s in SampleEfficiency().splits(samples_of(60), n_splits=2, seed=seed)]
        for seed in (3, 3, 4)
    )
    assert first == again and not set(first) & set(other)


@pytest.mark.parametrize("sizes", ["few", "5,,10", "5;10", "", "0,5", "-3", "2.5"])
def test_sizes_that_are_no_numbers_from_1_are_refused_by_name(sizes):
    with pytest.raises(ConfigError) as refused:
        SampleEfficiency(sizes=sizes).splits(samples_of(20), n_splits=None, seed=0)
    assert str(refused.value) == (
        f"sample-efficiency.sizes={sizes!r}: valid are whole numbers from 1, separated by commas"
    )


@pytest.mark.parametrize(("n_poses", "test_fraction"), [(4, 0.2), (2, 0.5), (1, 0.2)])
def test_too_few_poses_are_refused_with_their_number(n_poses, test_fraction):
    protocol = SampleEfficiency(test_fraction=test_fraction)
    with pytest.raises(ConfigError, match=f"{n_poses} poses cannot be divided with test_fraction"):
        protocol.splits(samples_of(n_poses), n_splits=None, seed=0)
