"""Check splits that test other poses or loads than the training part has."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from helpers.made_samples import assert_no_pose_is_parted, learned, samples_with
from stiff_protocols.contract.errors import ConfigError
from stiff_protocols.contract.types import Samples
from stiff_protocols.splits.extrapolation import ALL_POSES, LoadExtrapolation, SpaceTransfer

HEAVY, TURNED = "light -> heavy loads", "other directions"


def samples_of(force, pose_id=None, group=None) -> Samples:
    """Return samples under these forces; each row is a pose by default."""
    force = np.asarray(force, dtype=float)
    n = len(force)
    samples = samples_with(np.zeros((n, 6)), np.hstack([force, np.zeros((n, 3))]), np.zeros((n, 3)))
    pose_id = samples.pose_id if pose_id is None else np.asarray(pose_id)
    return replace(samples, pose_id=pose_id, group=samples.group if group is None else group)


def samples_in_groups(*sizes, loads=1):
    """Return samples with these numbers of poses in the groups g0, g1, ..."""
    group = np.repeat([f"g{i}" for i in range(len(sizes))], [size * loads for size in sizes])
    pose_id = np.repeat([f"p{i}" for i in range(sum(sizes))], loads)
    return samples_of(np.zeros((len(group), 3)), pose_id, group)


def test_each_group_is_learned_from_once_and_all_others_are_tested():
    samples = samples_in_groups(10, 20, 30, loads=2)
    splits = SpaceTransfer().splits(samples, n_splits=None, seed=0)
    words = ["g0 -> g1 + g2", "g1 -> g0 + g2", "g2 -> g0 + g1"]
    assert [s.condition for s in splits] == [f"{word}{ALL_POSES}" for word in words]
    for split, group in zip(splits, ("g0", "g1", "g2"), strict=True):
        np.testing.assert_array_equal(
            np.sort(learned(split)), np.flatnonzero(samples.group == group)
        )
        np.testing.assert_array_equal(split.test, np.flatnonzero(samples.group != group))
        assert len(split.validation) == pytest.approx(0.2 * len(learned(split)))
    assert_no_pose_is_parted(samples, splits)


def test_a_pose_of_two_groups_is_tested_and_not_learned_from():
    samples = samples_in_groups(5, 5)
    shared = replace(samples, pose_id=np.where(np.arange(10) == 9, "p0", samples.pose_id))
    first, second = SpaceTransfer().splits(shared, n_splits=None, seed=0)
    assert sorted(learned(first)) == [1, 2, 3, 4] and 9 in first.test
    assert sorted(learned(second)) == [5, 6, 7, 8] and 0 in second.test


def test_several_draws_learn_from_parts_of_a_group_and_test_the_same_rows():
    samples = samples_in_groups(20, 20)
    splits = SpaceTransfer(train_fraction=0.5).splits(samples, n_splits=3, seed=0)
    assert [s.index for s in splits] == [0, 0, 1, 1, 2, 2]
    forward_splits = [split for split in splits if split.condition.startswith("g0 -> g1")]
    assert {len(learned(split)) for split in forward_splits} == {10}
    assert len({tuple(sorted(learned(split))) for split in forward_splits}) == 3
    assert {tuple(split.test) for split in forward_splits} == {tuple(range(20, 40))}


def test_space_transfer_without_groups_or_between_groups_of_the_same_poses_is_refused():
    with pytest.raises(ConfigError, match="all samples are of group 'g0'; it needs at least two"):
        SpaceTransfer().splits(samples_in_groups(10), n_splits=None, seed=0)
    samples = samples_in_groups(5, 5)
    same = replace(samples, pose_id=np.tile(samples.pose_id[:5], 2))
    with pytest.raises(ConfigError, match="every pose stands in several of the groups g0, g1"):
        SpaceTransfer().splits(same, n_splits=None, seed=0)


def samples_of_sizes(n):
    """Return samples under forces of 1 to n newtons in turning directions."""
    angle = np.random.default_rng(0).permutation(np.linspace(0.0, 1.0, n))
    directions = np.stack([np.cos(angle), np.zeros(n), np.sin(angle)], axis=1)
    return samples_of(np.arange(1, n + 1)[:, None] * directions)


def test_models_learn_from_light_loads_or_some_directions_and_are_tested_under_the_others():
    samples = samples_of_sizes(40)
    heavy_split, turned_split = LoadExtrapolation().splits(samples, n_splits=None, seed=0)
    assert [heavy_split.condition, turned_split.condition] == [
        HEAVY + ALL_POSES,
        TURNED + ALL_POSES,
    ]
    assert sorted(heavy_split.test) == list(range(28, 40))  # the heaviest 30 %
    assert sorted(learned(heavy_split)) == list(range(28))
    assert len(heavy_split.validation) == 6
    rise = samples.wrench[:, 2] / np.linalg.norm(samples.wrench[:, :3], axis=1)
    assert len(turned_split.test) == 12
    assert rise[turned_split.test].min() > rise[learned(turned_split)].max()


def test_poses_with_light_and_heavy_loads_keep_those_of_one_side():
    loads, n_poses = 5, 20
    force = np.tile(np.arange(1.0, loads + 1)[:, None] * [[0.0, 0.0, -1.0]], (n_poses, 1))
    samples = samples_of(force, np.repeat(np.arange(n_poses).astype(str), loads))
    splits = LoadExtrapolation(by="size").splits(samples, n_splits=3, seed=0)
    assert_no_pose_is_parted(samples, splits)
    for split in splits:
        size = np.linalg.norm(samples.wrench[:, :3], axis=1)
        assert set(size[split.test]) == {5.0}
        assert set(size[learned(split)]) == {1.0, 2.0, 3.0, 4.0}
        assert len(split.test) == 10  # half of the poses, each with its one heavy load


def test_a_heaviest_load_that_many_samples_share_is_tested_whole():
    force = np.repeat([[0.0, 0.0, 50.0], [0.0, 0.0, 100.0], [0.0, 0.0, 150.0]], 10, axis=0)
    (split,) = LoadExtrapolation(by="size").splits(samples_of(force), n_splits=None, seed=0)
    assert sorted(split.test) == list(range(20, 30))  # a third, though 30 % were asked for


@pytest.mark.parametrize(
    ("by", "condition", "force"),
    [
        ("size", HEAVY, 7.0 * np.stack([np.cos(np.arange(20)), np.sin(np.arange(20))], axis=1)),
        ("direction", TURNED, np.arange(1, 21)[:, None] * [[0.1, 0.2]]),
    ],
)
def test_loads_that_differ_only_by_rounding_do_not_differ(by, condition, force):
    samples = samples_of(np.hstack([force, np.full((20, 1), 0.3) * force[:, :1] * (by != "size")]))
    with pytest.raises(ConfigError, match=f"{condition}: the samples' loads do not differ"):
        LoadExtrapolation(by=by).splits(samples, n_splits=None, seed=0)


def test_one_pose_cannot_part_its_loads():
    force = np.arange(1.0, 6.0)[:, None] * [[0.0, 0.0, 1.0]]
    with pytest.raises(ConfigError, match="too few poses to part the loads"):
        LoadExtrapolation(by="size").splits(samples_of(force, ["p"] * 5), n_splits=None, seed=0)


def test_direction_of_no_force_at_all_is_no_number_error():
    force = np.vstack([np.zeros((4, 3)), np.tile([[0.0, 0.0, 9.0]], (6, 1))])
    (split,) = LoadExtrapolation(by="direction").splits(samples_of(force), n_splits=None, seed=0)
    assert sorted(split.test) == list(range(4, 10))
