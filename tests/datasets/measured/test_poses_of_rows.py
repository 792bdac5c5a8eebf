"""Check that rows within a tolerance are one pose, in any order."""

from __future__ import annotations

import warnings
from dataclasses import replace

import numpy as np
import pandas as pd
import pytest
from scipy.sparse import csr_matrix
from scipy.sparse.csgraph import connected_components

import stiffbench as sb
from helpers.command_line import bench_here
from helpers.made_samples import assert_no_pose_is_parted
from stiff_datasets.measured.file_options import FileOptions
from stiff_datasets.measured.row_checks import linked_rows
from stiff_datasets.measured.sample_file import check_sheet, read_samples
from stiff_datasets.measured.table_reader import read_sheet, sample_table
from stiff_datasets.measured.validation_report import validate
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
    slides = np.zeros(q.shape[1], dtype=bool)
    poses = linked_rows(q, 0.05, slides)
    assert poses.max() + 1 == n_poses
    assert np.diff(np.unique(poses, return_index=True)[1]).min(initial=1) > 0  # as they come
    for seed in range(3):
        order = np.random.default_rng(seed).permutation(len(q))
        shuffled = linked_rows(q[order], 0.05, slides)
        pairs = set(zip(poses[order].tolist(), shuffled.tolist(), strict=True))
        assert len(pairs) == n_poses


@pytest.mark.parametrize(
    ("q", "turns", "n_poses"),
    [
        ([[179.99, -190.0], [-179.99, 170.02]], [True, True], 1),
        ([[0.01, 5.0], [-0.01, 5.0], [359.99, 365.0]], [True, True], 1),
        ([[-1e-20, 0.0], [0.0, -0.0], [720.0, -360.0]], [True, True], 1),
        ([[0.03], [359.98], [359.94], [359.87]], [True], 2),
        ([[179.96], [-179.96]], [True], 2),
        ([[0.0], [360.0]], [False], 2),
        ([[0.0, 0.0], [360.0, 360.0]], [True, False], 2),
    ],
    ids=["wrap", "around zero", "signed zeros", "chain", "0.08 deg", "rail", "turn and rail"],
)
def test_whole_turns_of_revolute_joints_are_one_pose_and_those_of_slides_are_not(q, turns, n_poses):
    assert linked_rows(np.array(q), 0.05, np.array(turns)).max() + 1 == n_poses


@pytest.mark.parametrize("tolerance", [0.0, 0.05, 0.07, 7.0, 10.0])
def test_poses_are_those_of_every_pair_of_rows(tolerance):
    turns, reach = np.array([True, True, False]), tolerance + 1e-6
    q = np.random.default_rng(3).uniform(-2.0, 2.0, (300, 3)) * max(tolerance, 1e-5)
    q[:, 0] += np.random.default_rng(4).choice([-360.0, 0.0, 360.0], 300)
    whole_turns = 360.0 * np.array([-2, -1, 0, 1, 2])[:, None, None, None] * turns
    moves = np.abs(q[:, None] - q[None] + whole_turns).min(axis=0)
    linked = csr_matrix((moves <= reach).all(axis=2))
    assert linked_rows(q, tolerance, turns).tolist() == connected_components(linked)[1].tolist()


def test_many_rows_of_jittering_poses_are_linked_in_time():
    random = np.random.default_rng(0)
    pose = random.integers(0, 2, 20_000)
    q = 90.0 * pose[:, None] + random.normal(scale=0.01, size=(len(pose), 6))
    assert (linked_rows(q, 0.05, np.full(6, True)) == abs(pose - pose[0])).all()


@pytest.fixture()
def turned(repeats, kr10):
    """Return 30 rows of ten poses; q6 differs by whole turns and by an encoder's jitter."""
    names = sorted(set(repeats["pose_id"]))[:10]
    table = repeats[repeats["pose_id"].isin(names)].sort_values("pose_id", kind="stable")
    q6 = np.where(np.arange(30) % 3 == 0, -179.99, 179.99)
    q6[1::3] = -180.01
    return table.assign(q6_deg=q6).sample(frac=1.0, random_state=0)


def test_rows_that_differ_by_whole_turns_are_one_pose_without_names(turned, kr10, tmp_path):
    turned.drop(columns=NAMES).to_csv(tmp_path / "my.csv", index=False)
    with pytest.warns(StiffBenchWarning, match="30 rows grouped into 10 poses"):
        samples = read_samples(tmp_path / "my.csv", kr10)
    pairs = set(zip(samples.pose_id.tolist(), turned["pose_id"], strict=True))
    assert len(pairs) == len(set(samples.pose_id)) == 10


@pytest.mark.slow
def test_the_range_of_an_endless_joint_is_stated_without_whole_turns(turned, kr10, tmp_path):
    turned.assign(load_id=range(30)).to_csv(tmp_path / "my.csv", index=False)
    lower, upper = np.r_[kr10.lower[:5], -np.inf], np.r_[kr10.upper[:5], np.inf]
    robot = replace(kr10, lower=lower, upper=upper)
    facts = [fact.message for fact in validate(tmp_path / "my.csv", robot).facts]
    assert sum("joint A6: -180 to -180 deg" in fact for fact in facts) == 1


@pytest.mark.slow
@pytest.mark.parametrize(
    ("first", "second"),
    [("P", "p"), ("pose ", "pose"), ("0", ""), ("", ".0"), ("P", "Q")],
    ids=["case", "blanks", "leading zero", "decimals", "other names"],
)
def test_whole_turns_under_two_names_are_a_suspicion_of_reader_and_validate(
    turned, kr10, tmp_path, first, second
):
    number = turned["pose_id"].factorize()[0] + 1
    names = [
        f"{part}{i}" if not part.startswith(".") else f"{i}{part}"
        for i, part in zip(number, np.where(turned["q6_deg"] > 0, first, second), strict=True)
    ]
    path = tmp_path / "my.csv"
    turned.assign(pose_id=names, load_id=range(30)).to_csv(path, index=False)
    with pytest.warns(StiffBenchWarning, match="20 pose_ids name 10 poses"):
        read_samples(path, kr10)
    assert any(
        "20 pose_ids name 10 poses" in text.message for text in validate(path, kr10).warnings
    )


def test_a_whole_turn_within_one_name_is_allowed_and_a_degree_more_names_its_column(
    turned, kr10, tmp_path
):
    path = tmp_path / "my.csv"
    turned.assign(load_id=range(30)).to_csv(path, index=False)
    assert len(set(read_samples(path, kr10).pose_id)) == 10
    turned.iloc[[29], turned.columns.get_loc("q1_deg")] += 1.0
    turned.assign(load_id=range(30)).to_csv(path, index=False)
    with pytest.raises(DataError, match=r"column q1_deg: .* of the same pose"):
        read_samples(path, kr10)


def test_alike_names_of_poses_beyond_the_tolerance_are_a_suspicion(repeats, kr10, tmp_path):
    table = repeats.drop_duplicates("pose_id").iloc[:4].assign(load_id="1")
    table = table.assign(pose_id=["P1", "p01", "7", "70"])
    table.to_csv(tmp_path / "my.csv", index=False)
    with pytest.warns(StiffBenchWarning, match=r"2 pose_ids differ .*'P1' \(row 2\) and 'p01'"):
        read_samples(tmp_path / "my.csv", kr10)


def test_alike_names_of_groups_are_a_suspicion(repeats, kr10, tmp_path):
    table = repeats.drop_duplicates("pose_id").iloc[:4].assign(load_id="1")
    table.assign(group=["near", "Near ", "far", "far"]).to_csv(tmp_path / "my.csv", index=False)
    with pytest.warns(StiffBenchWarning, match=r"2 groups differ .*'near' \(row 2\) and 'Near'"):
        read_samples(tmp_path / "my.csv", kr10)


def test_a_slow_motion_that_links_all_rows_to_one_pose_is_a_suspicion(repeats, kr10, tmp_path):
    table = pd.concat([repeats.iloc[[0]]] * 60).assign(q1_deg=10.0 + 0.04 * np.arange(60))
    table.drop(columns=NAMES).to_csv(tmp_path / "my.csv", index=False)
    checked = check_sheet(read_sheet(tmp_path / "my.csv"), kr10)
    assert not checked.problems
    (doubt,) = checked.pose_doubts
    assert "2.36 deg in q1_deg" in doubt
    with pytest.warns(StiffBenchWarning, match="2.36 deg in q1_deg"):
        sb.Dataset.from_samples(checked.samples, kr10)


@pytest.mark.slow
def test_a_repeat_a_whole_turn_away_under_another_name_is_named_as_a_repeat(turned, kr10, tmp_path):
    row = turned[turned["q6_deg"] == 179.99].iloc[[0]]
    copy = row.assign(pose_id="copy", q6_deg=row["q6_deg"] - 360.0)
    path = tmp_path / "my.csv"
    pd.concat([turned.assign(load_id=range(30)), copy]).to_csv(path, index=False)
    findings = [text for text in validate(path, kr10).warnings if "same wrench" in text.message]
    assert [text.rows for text in findings] == [(32,)]


def test_rows_of_one_name_may_differ_by_the_tolerance_and_no_more(repeats, kr10, tmp_path):
    table = repeats.assign(load_id=np.arange(len(repeats)))
    table.to_csv(tmp_path / "my.csv", index=False)
    assert len(set(read_samples(tmp_path / "my.csv", kr10).pose_id)) == N_POSES
    with pytest.raises(DataError, match=r"column q\d_deg: .* of the same pose"):
        read_samples(tmp_path / "my.csv", kr10, FileOptions(pose_tolerance=0.0))


def test_poses_of_two_names_are_one_suspicion(file_with_names, kr10, tmp_path):
    (near,) = check_sheet(read_sheet(file_with_names), kr10).pose_doubts
    for part in ("45 pose_ids name 15 poses", "'m0' (row 2)", "one pose_id", "leave the column"):
        assert part in near
    words = ["--data", "named.csv", "--robot", "kr10-r1100-2", "--model", "vjm"]
    stderr = bench_here("run", "--splits", "1", *words, cwd=tmp_path).stderr
    assert stderr.count("45 pose_ids name 15 poses") == stderr.count("warning") == 1


@pytest.mark.slow
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
