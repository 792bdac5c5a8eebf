"""The `bench data` commands: their files, output and exit status."""

from __future__ import annotations

import contextlib
import os
import re
from dataclasses import replace
from importlib.resources import files
from pathlib import Path
from unittest import mock

import numpy as np
import pandas as pd
import pytest

import stiffbench as sb
from helpers.command_line import assert_refused, bench_here, started, wait_until
from helpers.made_robots import arm_lines, gripper_lines, tree_urdf
from stiff_bench.store.database import read_results
from stiff_datasets.measured.kr10_measured import registration
from stiff_datasets.measured.table_reader import sample_table
from stiff_datasets.measured.validation_report import validate
from stiff_datasets.twin.twin import DigitalTwin
from stiff_datasets.twin.twin_file import shipped_constants, shipped_twins

FANUC_CSV = files("stiff_datasets") / "data" / "fanuc_r2000ic.csv"
LOADS = ["fx_N", "fy_N", "fz_N", "tx_Nm", "ty_Nm", "tz_Nm"]
DEFLECTIONS = ["dx_mm", "dy_mm", "dz_mm"]


@pytest.fixture()
def home(tmp_path):
    return {"STIFFBENCH_HOME": str(tmp_path / "home")}


def filled_in(plan: Path, twin_name: str = "kr10_r1100_2") -> None:
    """Write the twin's deflections into a plan's empty columns."""
    table = pd.read_csv(plan)
    q = np.deg2rad(table[[f"q{i}_deg" for i in range(1, 7)]].to_numpy())
    twin = DigitalTwin.in_world(shipped_constants(twin_name), 0, "clean")
    table[DEFLECTIONS] = (1000.0 * twin.truth(q, table[LOADS].to_numpy())).round(5)
    table.to_csv(plan, index=False)


def test_a_table_is_validated_like_its_file_with_rows_from_zero(tmp_path):
    data = sb.load_dataset("fanuc-r2000ic")
    (few := data[:8].frame()).to_csv(tmp_path / "my.csv", index=False)
    from_file = sb.validate(tmp_path / "my.csv", robot=data.robot, no_torque=True)
    for report in (
        sb.validate(few, robot=data.robot, no_torque=True),
        sb.validate(data[:8], no_torque=True),
    ):
        assert [repr(report).split("\n")[3:6]] == [repr(from_file).split("\n")[3:6]]
        assert report.verdict == from_file.verdict
    few.loc[3, "dx_mm"] = 1e9
    assert sb.validate(few, robot=data.robot).errors[0].rows == (3,)
    (tmp_path / "own-data.md").write_text("| Instrument noise | soft |\n|---|---|\n")
    with contextlib.chdir(tmp_path):  # the card of another file is not read
        assert not any("card" in fact.message for fact in sb.validate(few, robot="ur5").errors)


@pytest.mark.slow
def test_validate_names_where_the_force_acts_and_what_moves_the_tool(tmp_path):
    data = sb.load_dataset("kr10-twin@plan=wide").data
    samples = data.samples.take(np.arange(60))
    lever = data.robot.forward(samples.q).rotation @ np.array([0.012, -0.016, 0.0])
    written = samples.wrench.copy()
    written[:, 3:] -= np.cross(lever, written[:, :3])
    table = sample_table(replace(samples, wrench=written), data.robot)
    table.to_csv(tmp_path / "my.csv", index=False)
    report = sb.validate(tmp_path / "my.csv", robot="kr10-r1100-2")
    messages = {fact.message.partition(": ")[0]: fact.message for fact in report.facts}
    x, y, z = map(int, re.search(r"\((\S+), (\S+), (\S+)\) mm", messages["force point"]).groups())
    assert np.linalg.norm(np.array([x, y, z]) - [12, -16, 0]) < 4
    assert "joints" in messages["what moves the tool"]


@pytest.mark.slow
def test_from_the_plan_to_results_with_ones_own_file(tmp_path, home):
    def bench(*words: str, status: int = 0) -> str:
        done = bench_here(*words, cwd=tmp_path, env=home)
        assert done.returncode == status, done.stderr
        return done.stdout

    planned = bench("data", "plan", "--output", "my.csv")
    assert planned.startswith("my.csv: 60 poses") and "worse" not in planned
    filled_in(tmp_path / "my.csv")
    assert bench("data", "validate", "my.csv").startswith("my.csv: ok")
    bench("data", "register", "my.csv", "--dataset", "kr10-measured")
    assert "no file registered" not in bench("list", "datasets")
    run = ("run", "--model", "vjm", "--output")
    bench(*run, "by-file", "--data", "my.csv", "--robot", "kr10-r1100-2")
    bench(*run, "by-key", "--dataset", "kr10-measured")
    by_file, by_key = (read_results(tmp_path / name)[0] for name in ("by-file", "by-key"))
    np.testing.assert_array_equal(by_file.prediction.predicted, by_key.prediction.predicted)


@pytest.mark.parametrize(
    ("robot", "options"),
    [
        pytest.param("kr10-r1100-2", {"poses": 20, "candidates": 200}, marks=pytest.mark.slow),
        ("ur5", {"poses": 8, "candidates": 200}),  # few, and its last joint hardly moves the TCP
        pytest.param(
            "gp12",
            {"poses": 12, "candidates": 200, "criterion": "i-optimal"},
            marks=pytest.mark.slow,
        ),
        *(
            pytest.param(name, {}, marks=pytest.mark.slow)
            for name in shipped_twins()
            if name != "kr10-r1100-2-calibration-2"
        ),
    ],
)
def test_a_plan_filled_in_with_correct_readings_is_not_suspicious(tmp_path, robot, options):
    plan, constants = tmp_path / "plan.csv", shipped_twins()[robot]
    clearance = shipped_constants(constants).clearance_m
    sb.plan_poses(plan, robot=robot, clearance=clearance, **options)
    filled_in(plan, constants)
    report = validate(plan, sb.load_robot(robot))
    assert report.verdict == "ok"
    assert {finding.level for finding in report.warnings} <= {"note"}
    table = pd.read_csv(plan)
    table["group"] = "measured"  # by its own plan: were the torques measured?
    table.to_csv(plan, index=False)
    assert "--no-torque" in validate(plan, sb.load_robot(robot)).warnings[0].message


def test_a_chosen_plan_prints_its_gain_over_chance(tmp_path):
    words = "data plan --poses 40 --candidates 400 --output plan.csv".split()
    done = bench_here(*words, cwd=tmp_path)
    assert float(done.stdout.partition("D-efficiency")[2].split()[0]) > 1.3
    assert_refused(bench_here(*words, cwd=tmp_path), "plan.csv: exists")


@pytest.mark.slow
def test_a_stopped_simulation_leaves_nothing_behind(tmp_path):
    words = ["data", "simulate", "--samples", "100000000", "--output", "s.csv"]
    with started(*words, cwd=tmp_path) as running:
        wait_until(lambda: list(tmp_path.iterdir()), running=running)
        running.terminate()
        running.communicate(timeout=60)
    assert running.returncode == 143
    assert list(tmp_path.iterdir()) == []


@pytest.mark.slow
def test_validate_leaves_with_1_of_what_is_suspicious_and_with_2_and_every_error_if_invalid(
    tmp_path,
):
    words = ["data", "validate", "my.csv", "--robot", "fanuc-r2000ic"]
    text = FANUC_CSV.read_text()
    (tmp_path / "my.csv").write_text(text)
    done = bench_here(*words, cwd=tmp_path)
    assert done.returncode == 1 and done.stdout.startswith("my.csv: suspicious, ")
    (tmp_path / "my.csv").write_text(text.replace("-0.686", "nan", 1).replace("-0.538", "99", 1))
    done = bench_here(*words, cwd=tmp_path)
    assert done.returncode == 2 and done.stdout.startswith("my.csv: invalid, 2 errors")
    for part in ("row 2, column dx_mm: 'nan'", "row 3, column dx_mm: '99'"):
        assert part in done.stdout


@pytest.mark.slow
def test_a_description_with_a_gripper_is_planned_read_and_registered_with_one_note(tmp_path, home):
    tree_urdf(tmp_path / "arm.urdf", arm_lines("base", "a", 6) + gripper_lines("a6"))
    plan = ["data", "plan", "--urdf", "arm.urdf", "--payload", "3", "--poses", "8"]
    done = bench_here(*plan, "--tcp", "0.1,0,0", "--output", "p.csv", cwd=tmp_path)
    assert done.returncode == 0, done.stderr
    notes = [line for line in done.stderr.splitlines() if "note" in line]
    assert len(notes) == 2 and "'hand_tcp'" in notes[0] and "to_left, to_right" in notes[1]
    robot = ["--urdf", "arm.urdf", "--tip", "hand", "--tcp", "0.1,0,0.1"]
    table = pd.read_csv(tmp_path / "p.csv").assign(dx_mm=0.1, dy_mm=0.2, dz_mm=-0.3)
    for name in ("a.csv", "b.csv"):
        table.to_csv(tmp_path / name, index=False)
    words = ["run", "--model", "mean", "--data", "a.csv", "--data", "b.csv", "--no-torque", *robot]
    done = bench_here(*words, "--output", "r", cwd=tmp_path)
    assert done.returncode == 0 and done.stderr.count("note:") == 1, done.stderr
    words = ["data", "register", "a.csv", "--dataset", "kr10-measured", "--no-torque", *robot]
    assert bench_here(*words, cwd=tmp_path, env=home).returncode == 0
    with mock.patch.dict(os.environ, home):
        assert registration().tip == "hand"
