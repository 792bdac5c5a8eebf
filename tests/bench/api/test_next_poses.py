"""`bench data plan --after`: the next poses, their gain, and refusals."""

from __future__ import annotations

import re

import numpy as np
import pandas as pd
import pytest

import planned_poses
import stiffbench as sb
from helpers.command_line import assert_refused, bench_here
from stiff_datasets.measured.sheet_files import sample_table, write_table
from stiff_datasets.twin.robot_twin import Ur5Twin

UR5 = ("data", "plan", "--robot", "ur5", "--candidates", "200", "--output", "next.csv")


@pytest.fixture(scope="module")
def ur5():
    return Ur5Twin().load()


@pytest.fixture()
def measured(ur5, tmp_path):
    """A function that writes the first poses of the UR5's twin as a user's file."""

    def write(n_poses, name="my.csv"):
        write_table(
            tmp_path / name, [sample_table(ur5.samples.take(np.arange(n_poses)), ur5.robot)]
        )
        return name

    return write


def lowered(text):
    """Return the standard error before, with the plan, random poses and the best of them."""
    table = text.partition("prediction with poses")[2].partition("\n\n")[0]
    return [float(line.split()[-2]) for line in table.splitlines()[2:]]


def test_the_next_poses_lower_the_interval_more_than_random_ones(tmp_path, measured):
    done = bench_here(*UR5, "--after", measured(20), "--poses", "6", cwd=tmp_path)
    assert done.returncode == 0, done.stderr
    before, plan, random, best = lowered(done.stdout)
    assert plan < best <= random < before
    ratio = float(re.search(r"([\d.]+) times as much as random", done.stdout)[1])
    assert ratio > 1.2
    table = pd.read_csv(tmp_path / "next.csv")
    assert len(table) == 6 and table["dx_mm"].isna().all()


def test_a_process_chooses_by_its_own_intervals(tmp_path, measured):
    words = [*UR5, "--after", measured(12), "--poses", "4"]
    process = bench_here(*words, "--model", "vjm-gp", cwd=tmp_path)
    assert process.returncode == 0, process.stderr
    before, plan, random, best = lowered(process.stdout)
    assert plan < best <= random < before
    assert "Predictions of vjm-gp" in process.stdout


def test_a_workspace_of_ones_own_rows_without_loads_has_no_share_to_gain(tmp_path, measured):
    work = pd.read_csv(tmp_path / measured(14))
    loads = [name for name in work if name.lower().startswith(("f", "t", "m"))]
    work.assign(**dict.fromkeys(loads, 0.0)).to_csv(tmp_path / "work.csv", index=False)
    words = [*UR5, "--after", "my.csv", "--poses", "4", "--workspace", "work.csv"]
    done = bench_here(*words, cwd=tmp_path)
    assert done.returncode == 0, done.stderr
    assert "14 rows of work.csv" in done.stdout and lowered(done.stdout) == [0.0] * 4
    assert "lowers" not in done.stdout


def test_a_plan_and_what_was_measured_of_it_are_one_file(tmp_path, measured, ur5):
    sb.plan_poses(tmp_path / "plan.csv", robot="ur5", poses=12, candidates=50)
    rows = pd.read_csv(tmp_path / "plan.csv").assign(dx_mm=0.1, dy_mm=-0.2, dz_mm=0.3)
    rows.to_csv(tmp_path / "my.csv", index=False)
    sb.plan_poses(
        tmp_path / "more.csv", robot="ur5", poses=5, candidates=50, after=tmp_path / "my.csv"
    )
    more = pd.read_csv(tmp_path / "more.csv")
    all_rows = pd.concat([rows, more.assign(dx_mm=0.1, dy_mm=-0.2, dz_mm=0.3)])
    assert all_rows["pose_id"].is_unique
    all_rows.to_csv(tmp_path / "both.csv", index=False)
    assert len(sb.read_samples(tmp_path / "both.csv", robot="ur5")) == 17


def test_what_cannot_be_planned_after_a_measurement_is_refused(tmp_path, measured):
    words = [*UR5, "--after", measured(9)]
    for options, parts in (
        (["--model", "vjm-gp"], ["my.csv: 9 poses", "at least 10 poses", "--model vjm"]),
        (["--model", "ft-mlp"], ["--model 'ft-mlp'", "valid: vjm", "gp-springs"]),
        (["--model", "gp", "--criterion", "d-optimal"], ["--criterion d-optimal", "i-optimal"]),
    ):
        assert_refused(bench_here(*words, *options, cwd=tmp_path), *parts)
    assert not (tmp_path / "next.csv").exists()


@pytest.mark.filterwarnings("ignore:joint stiffness not identifiable")  # of few poses
@pytest.mark.slow
def test_planned_poses_inform_a_fifth_more_than_random_poses_on_twins():
    """docs/faults.md states the ratios, also for other models."""
    case = planned_poses.CASES[0]
    outcomes = {
        twin: [planned_poses.outcome(twin, *case, seed) for seed in range(planned_poses.SEEDS)]
        for twin in planned_poses.TWINS
    }
    for twin_outcomes in outcomes.values():
        assert np.mean([outcome.ratio for outcome in twin_outcomes]) > 1.2
    errors = [outcome.errors for twin_outcomes in outcomes.values() for outcome in twin_outcomes]
    _, random, planned = np.mean(errors, axis=0)
    assert planned < 0.97 * random
