"""Check splits that hold out regions of the workspace."""

from __future__ import annotations

import re
from dataclasses import replace

import numpy as np
import pytest

from helpers.made_robots import planar_arm
from helpers.made_samples import learned, samples_with
from stiff_protocols.contract.errors import ConfigError
from stiff_protocols.contract.types import BenchmarkData, Robot, Samples
from stiff_protocols.splits.extrapolation import ALL_POSES
from stiff_protocols.splits.workspace import WorkspaceExtrapolation

CORNERS = np.array([[0.3, 0.4, 0.1], [0.3, -0.4, 0.1], [0.9, 0.4, 0.5], [0.9, -0.4, 0.5]])  # m
EXPECTED = [
    "region 1 around (300, -400, 100) mm",
    "region 2 around (300, 400, 100) mm",
    "region 3 around (900, -400, 500) mm",
    "region 4 around (900, 400, 500) mm",
]


@pytest.fixture(scope="module")
def portal() -> Robot:
    """Return three slides along x, y and z; their positions are the TCP's."""
    arm, placements = planar_arm(3, (0.0, 0.0, 1.0)), np.tile(np.eye(4), (3, 1, 1))
    kinds = ("prismatic",) * 3
    return replace(arm, joint_types=kinds, placements=placements, axes=np.eye(3), tcp=np.zeros(3))


def around_corners(n_each, loads=1) -> Samples:
    """Return shuffled poses within 5 cm around each corner, which is their mean."""
    rng = np.random.default_rng(1)
    offsets = rng.uniform(-0.05, 0.05, (n_each // 2, 3))
    around = np.vstack([offsets, -offsets])
    position = rng.permutation((CORNERS[:, None] + around).reshape(-1, 3))
    q = np.repeat(position, loads, axis=0)
    samples = samples_with(q, np.zeros((len(q), 6)), np.zeros((len(q), 3)))
    return replace(samples, pose_id=np.repeat(np.arange(len(position)).astype(str), loads))


def split_regions(robot, samples, n_splits=None, seed=0, **options):
    protocol = WorkspaceExtrapolation(**options)
    protocol.prepared(BenchmarkData(samples, robot))
    return protocol.splits(samples, n_splits=n_splits, seed=seed)


def test_each_region_is_held_out_once_and_named_after_its_mean_position_in_mm(portal):
    samples = around_corners(10)
    splits = split_regions(portal, samples)
    assert [split.condition for split in splits] == [f"{name}{ALL_POSES}" for name in EXPECTED]
    for split in splits:
        numbers = re.search(r"\((.*)\) mm", split.condition).group(1)
        centre = np.array([float(number) / 1000.0 for number in numbers.split(",")])
        distance = np.linalg.norm(samples.q - centre, axis=1)
        np.testing.assert_array_equal(split.test, np.flatnonzero(distance < 0.1))
        assert len(split.test) == 10 and len(split.validation) == 6
        np.testing.assert_array_equal(
            np.sort(np.r_[learned(split), split.test]), np.arange(len(samples))
        )


def test_regions_are_of_the_tcp_and_not_of_the_joint_angles(kr10, parts):
    _, train, _, _ = parts
    position = kr10.tcp_position(train.q)
    splits = split_regions(kr10, train, regions=2)
    assert len(splits) == 2
    centres = [position[split.test].mean(axis=0) for split in splits]
    for row, point in enumerate(position):  # what k-means converges to: the nearest mean
        nearest = int(np.argmin([np.linalg.norm(point - centre) for centre in centres]))
        assert row in splits[nearest].test


def test_regions_are_the_same_for_every_seed(portal):
    samples = around_corners(10)
    first, second = (split_regions(portal, samples, n_splits=2, seed=seed) for seed in (1, 2))
    assert [(s.index, s.condition) for s in first] == [(i, c) for i in (0, 1) for c in EXPECTED]
    for split, second_split in zip(first, second, strict=True):
        np.testing.assert_array_equal(split.test, second_split.test)


def test_fewer_positions_than_regions_and_no_robot_are_refused(portal):
    samples = around_corners(2, loads=2)
    same = replace(samples, q=np.tile(CORNERS[0] + 1e-9 * np.arange(16)[:, None], (1, 1)))
    with pytest.raises(ConfigError, match="regions=4: the 8 poses have 1 different TCP positions"):
        split_regions(portal, same)
    with pytest.raises(ConfigError, match="regions=9: the 8 poses have 8 different TCP positions"):
        split_regions(portal, samples, regions=9)
    assert len(split_regions(portal, samples, regions=8)) == 8
    with pytest.raises(ConfigError, match="the robot is not known; call prepared before splits"):
        WorkspaceExtrapolation().splits(around_corners(4), n_splits=None, seed=0)
