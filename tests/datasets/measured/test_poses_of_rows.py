"""Check that rows within a tolerance are one pose, in any order."""

from __future__ import annotations

import warnings
from dataclasses import replace

import numpy as np
import pandas as pd
import pytest

import stiffbench as sb
from helpers.command_line import bench_here
from helpers.made_samples import assert_no_pose_is_parted
from stiff_datasets.measured.file_options import FileOptions
from stiff_datasets.measured.row_checks import linked_rows
from stiff_datasets.measured.sample_file import check_sheet, read_samples
from stiff_datasets.measured.sheet_files import read_sheet, sample_table
from stiff_protocols.contract.errors import ConfigError, DataError, StiffBenchWarning
from stiff_protocols.contract.types import BenchmarkData
from stiff_protocols.splits.random_splits import Holdout

JOINTS = [f"q{i}_deg" for i in range(1, 7)]
NAMES = ["pose_id", "load_id", "group"]
N_POSES = 150


@pytest.fixture(scope="module")
def repeats(twin):
    """Return 150 poses of a twin, each measured three times with an encoder's jitter."""
    rng = np.random.default_rng(0)
    once = sample_table(twin.samples, twin.robot).iloc[:N_POSES]
    table = pd.concat([once] * 3).sample(frac=1.0, random_state=1).reset_index(drop=True)
    table[JOINTS] += rng.normal(0.0, 0.003, (len(table), 6))
    table[["dx_mm", "dy_mm", "dz_mm"]] += rng.normal(0.0, 0.02, (len(table), 3))
    return table.round(5)


@pytest.fixture()
def file_without_names(repeats, tmp_path):
    """Write the repeats to a file without `pose_id`."""
    path = tmp_path / "my.csv"
    repeats.drop(columns=NAMES).to_csv(path, index=False)
    return path


@pytest.fixture()
def file_with_names(repeats, tmp_path):
    """Write 45 repeats to a file in which every row has a different `pose_id`."""
    path = tmp_path / "named.csv"
    rows = repeats[repeats["pose_id"].isin(sorted(set(repeats["pose_id"]))[:15])]
    rows.assign(pose_id=[f"m{i}" for i in range(len(rows))]).to_csv(path, index=False)
    return path


def test_repeats_with_jitter_are_one_pose_and_on_one_side_of_every_split(
    file_without_names, repeats, kr10
):
    with pytest.warns(StiffBenchWarning, match=r"450 rows grouped into 150 poses within 0\.05 deg"):
        samples = read_samples(file_without_names, kr10)
    pairs = set(zip(samples.pose_id.tolist(), repeats["pose_id"], strict=True))
    assert len(pairs) == len(set(samples.pose_id)) == N_POSES
    splits = [*Holdout().splits(samples, n_splits=5, seed=0)]
    assert_no_pose_is_parted(replace(samples, pose_id=repeats["pose_id"].to_numpy(str)), splits)
    assert len(splits) == 5


def test_a_tolerance_of_its_own_gives_other_poses_and_another_hash(file_without_names, kr10):
    with warnings.catch_warnings(action="ignore"):
        usual, none = (
            read_samples(file_without_names, kr10, FileOptions(pose_tolerance=tolerance))
            for tolerance in (0.05, 0.0)
        )
    assert len(set(none.pose_id)) == 3 * N_POSES
    assert BenchmarkData(usual, kr10).sha256 != BenchmarkData(none, kr10).sha256
    with pytest.raises(ConfigError, match="pose-tolerance -1"):
        FileOptions(pose_tolerance=-1.0)


CHAIN = 0.04 * np.arange(8.0)[:, None] * np.ones(3)
EDGE = np.array([[0.0499, 10.0], [0.0501, 10.0], [0.001, 10.0], [0.5, 10.0]])
BEYOND = np.array([[1.0, 2.0], [1.0, 2.06], [1.04, 2.0], [7.0, 2.0]])
EXACT = np.array([[10.0], [10.05], [10.11]])


@pytest.mark.parametrize(
    ("q", "n_poses"),
    [(CHAIN, 1), (EDGE, 2), (BEYOND, 3), (EXACT, 2), (np.full((4, 2), np.nan), 1)],
    ids=["chain", "edge of a grid", "one joint beyond", "just the tolerance", "no numbers"],
)
def test_near_rows_are_linked_in_every_order(q, n_poses):
    poses = linked_rows(q, 0.05)
    assert poses.max() + 1 == n_poses
    assert np.diff(np.unique(poses, return_index=True)[1]).min(initial=1) > 0  # as they come
    for seed in range(3):
        order = np.random.default_rng(seed).permutation(len(q))
        pairs = set(zip(poses[order].tolist(), linked_rows(q[order], 0.05).tolist(), strict=True))
        assert len(pairs) == n_poses


def test_many_rows_of_jittering_poses_are_linked_in_time():
    random = np.random.default_rng(0)
    pose = random.integers(0, 2, 20_000)
    q = 90.0 * pose[:, None] + random.normal(scale=0.01, size=(len(pose), 6))
    assert (linked_rows(q, 0.05) == abs(pose - pose[0])).all()


def test_rows_of_one_name_may_differ_by_the_tolerance_and_no_more(repeats, kr10, tmp_path):
    table = repeats.assign(load_id=np.arange(len(repeats)))
    table.to_csv(tmp_path / "my.csv", index=False)
    assert len(set(read_samples(tmp_path / "my.csv", kr10).pose_id)) == N_POSES
    with pytest.raises(DataError, match=r"column q\d_deg: .* of the same pose"):
        read_samples(tmp_path / "my.csv", kr10, FileOptions(pose_tolerance=0.0))


def test_poses_of_two_names_are_one_suspicion(file_with_names, kr10, tmp_path):
    near = check_sheet(read_sheet(file_with_names), kr10).near_poses
    for part in ("45 pose_ids name 15 poses", "'m0' (row 2)", "one pose_id", "leave the column"):
        assert part in near
    words = ["--data", "named.csv", "--robot", "kr10-r1100-2", "--model", "vjm"]
    stderr = bench_here("run", "--splits", "1", *words, cwd=tmp_path).stderr
    assert stderr.count("45 pose_ids name 15 poses") == stderr.count("warning") == 1


def test_tables_and_arrays_in_memory_are_looked_at_too(repeats, kr10):
    with pytest.warns(StiffBenchWarning, match="450 rows grouped into 150 poses"):
        dataset = sb.Dataset.from_frame(repeats.drop(columns=NAMES), kr10)
    assert len(set(dataset.samples.pose_id)) == N_POSES
    names = np.arange(len(repeats)).astype(str)
    with pytest.warns(StiffBenchWarning, match=r"mine: 450 pose_ids .*\(row 0\)"):
        sb.Dataset.from_samples(replace(dataset.samples, pose_id=names), kr10, name="mine")
    sb.Dataset.from_samples(dataset.samples, kr10)  # and no warning
    numbered_table = repeats.assign(
        pose_id=dataset.samples.pose_id, load_id=np.arange(len(repeats))
    )
    numbered_dataset = sb.Dataset.from_frame(numbered_table.iloc[::-1], kr10)
    assert (
        numbered_dataset.samples.load_id.tolist()
        == numbered_table["load_id"].astype(str).tolist()[::-1]
    )
