"""The `bench data` commands: what they write, what they print, how they refuse."""

from __future__ import annotations

import csv
import os
from importlib.resources import files
from pathlib import Path
from unittest import mock

import numpy as np
import pandas as pd
import pytest

from helpers.command_line import assert_refused, bench_here, started
from helpers.made_robots import arm_lines, gripper_lines, tree_urdf
from stiff_datasets.measured.kr10_measured import registration
from stiff_datasets.measured.sample_file import read_samples
from stiff_datasets.measured.sheet_files import sample_table

ROBOTS = files("stiff_datasets") / "robots"
FANUC_CSV = str(files("stiff_datasets") / "data" / "fanuc_r2000ic.csv")


@pytest.fixture()
def home(tmp_path):
    return {"STIFFBENCH_HOME": str(tmp_path / "home")}


def filled_in(plan: Path, kr10) -> Path:
    """The plan as a careful user would return it: deflections of the twin in its empty columns."""
    from stiff_datasets.twin.constants import shipped_constants
    from stiff_datasets.twin.twin import DigitalTwin

    rows = list(csv.DictReader(plan.read_text().splitlines()))
    q = np.deg2rad([[float(row[f"q{i}_deg"]) for i in range(1, 7)] for row in rows])
    names = ("fx_N", "fy_N", "fz_N", "tx_Nm", "ty_Nm", "tz_Nm")
    wrench = np.array([[float(row[name]) for name in names] for row in rows])
    twin = DigitalTwin(kr10, shipped_constants("kr10_r1100_2").springs)
    for row, moved in zip(rows, twin.readings(q, wrench) * 1000, strict=True):
        row |= dict(zip(("dx_mm", "dy_mm", "dz_mm"), moved.round(5), strict=True))
    path = plan.with_name("measured.csv")
    with path.open("w", newline="") as file:
        writer = csv.DictWriter(file, rows[0])
        writer.writeheader()
        writer.writerows(rows)
    return path


def test_a_plan_that_is_not_filled_in_is_refused_in_one_line(tmp_path, fanuc):
    plan = sample_table(fanuc.samples, fanuc.robot).assign(dx_mm="", dy_mm="", dz_mm="")
    plan.to_csv(tmp_path / "plan.csv", index=False)
    robot = ("--robot", "fanuc-r2000ic")
    for words in (
        ("run", "--model", "vjm", "--data", "plan.csv"),
        ("fit", "--model", "vjm", "--data", "plan.csv", "--output", "vjm.stiff"),
    ):
        refused = bench_here(*words, *robot, cwd=tmp_path)
        assert refused.returncode == 2
        (line,) = refused.stderr.splitlines()
        assert "plan.csv: this plan is not filled in yet: 43 of 43 rows" in line
    validated = bench_here("data", "validate", "plan.csv", *robot, cwd=tmp_path)
    assert validated.returncode == 2 and "invalid, 1 error" in validated.stdout


@pytest.mark.slow
def test_from_the_plan_to_the_leaderboard_with_ones_own_file(tmp_path, home, kr10):
    planned = bench_here("data", "plan", "--output", "plan.csv", cwd=tmp_path)
    assert planned.returncode == 0, planned.stderr
    assert "151 poses" in planned.stdout and "mean of 20 random" in planned.stdout
    path = filled_in(tmp_path / "plan.csv", kr10)
    assert len(read_samples(path, kr10)) == 151
    words = ["data", "validate", "measured.csv"]
    assert "every torque is zero" in bench_here(*words, cwd=tmp_path).stdout
    checked = bench_here(*words, "--no-torque", cwd=tmp_path)
    assert checked.returncode == 0, checked.stdout
    assert checked.stdout.startswith("measured.csv: ok")
    assert "kr10-r1100-2, the default" in checked.stdout
    words = ["run", "--model", "vjm", "--format", "csv"]
    by_name = bench_here(*words, "--data", "measured.csv", "--robot", "kr10-r1100-2", cwd=tmp_path)
    registered = bench_here(
        "data", "register", "kr10-measured", "measured.csv", cwd=tmp_path, env=home
    )
    assert registered.returncode == 0, registered.stderr
    by_key = bench_here(*words, "--dataset", "kr10-measured", cwd=tmp_path, env=home)
    values = [
        [row["value"] for row in csv.DictReader(done.stdout.splitlines()) if row["dataset"]]
        for done in (by_name, by_key)
    ]
    assert len(values[0]) == 9 and values[0] == values[1]
    listed = bench_here("list", "datasets", cwd=tmp_path, env=home).stdout
    assert "no file registered" not in listed


def test_a_chosen_plan_says_what_it_gains_over_chance(tmp_path):
    words = ["data", "plan", "--poses", "40", "--candidates", "400", "--output", "plan.csv"]
    done = bench_here(*words, cwd=tmp_path)
    assert done.returncode == 0, done.stderr
    assert "40 poses" in done.stdout and "chosen, d-optimal" in done.stdout
    (line,) = (line for line in done.stdout.splitlines() if line.startswith("D-efficiency"))
    assert float(line.split()[1]) > 1.3
    assert_refused(bench_here(*words, cwd=tmp_path), "plan.csv: exists")


@pytest.mark.slow
def test_a_stopped_simulation_leaves_nothing_behind(tmp_path):
    words = ["data", "simulate", "--samples", "100000000", "--output", "s.csv"]
    with started(*words, cwd=tmp_path) as running:
        assert "simulate" in running.stderr.readline()
        assert list(tmp_path.iterdir()) != []
        running.terminate()
        running.communicate(timeout=60)
    assert running.returncode == 143
    assert list(tmp_path.iterdir()) == []


def test_a_plan_of_ones_own_robot_needs_its_payload(tmp_path):
    tree_urdf(tmp_path / "arm.urdf", arm_lines("base", "a", 6))
    words = ["data", "plan", "--urdf", "arm.urdf", "--tcp", "0,0.06,0.08"]
    words += ["--candidates", "300", "--poses", "20", "--output", "plan.csv"]
    assert_refused(bench_here(*words, cwd=tmp_path), "--payload of arm", "in kg")
    done = bench_here(*words, "--payload", "5", cwd=tmp_path)
    assert done.returncode == 0 and (tmp_path / "plan.csv").is_file()
    assert "bench data validate plan.csv with the same --urdf" in done.stdout
    assert "worst joint" not in done.stdout  # its error would be relative to nothing known


def test_neither_nothing_nor_a_simulated_file_passes_for_a_measured_kr10(tmp_path, home):
    def refused(*words: str, part: str) -> None:
        assert_refused(bench_here(*words, cwd=tmp_path, env=home), part)

    listed = bench_here("list", "datasets", cwd=tmp_path, env=home).stdout
    (line,) = (line for line in listed.splitlines() if line.startswith("kr10-measured"))
    command = "bench data register kr10-measured"
    assert command in line
    refused("run", "--model", "vjm", "--dataset", "kr10-measured", part=command)
    bench_here("data", "simulate", "--samples", "20", "--output", "s.csv", cwd=tmp_path)
    refused("data", "register", "kr10-measured", "s.csv", part="'simulated'")


def test_validate_leaves_with_1_of_what_is_suspicious_and_with_2_and_every_error_if_invalid(
    tmp_path,
):
    words = ["data", "validate", "my.csv", "--robot", "fanuc-r2000ic"]
    text = Path(FANUC_CSV).read_text()
    (tmp_path / "my.csv").write_text(text)
    done = bench_here(*words, cwd=tmp_path)
    assert done.returncode == 1 and done.stdout.startswith("my.csv: suspicious, ")
    assert "every torque is zero" in done.stdout
    (tmp_path / "my.csv").write_text(text.replace("-0.686", "nan", 1).replace("-0.538", "99", 1))
    done = bench_here(*words, cwd=tmp_path)
    assert done.returncode == 2 and done.stdout.startswith("my.csv: invalid, 2 errors")
    for part in ("row 2, column dx_mm: 'nan'", "row 3, column dx_mm: '99'"):
        assert part in done.stdout


def test_files_without_torques_are_used_and_registered_where_that_is_said(tmp_path, home):
    words = ["data", "simulate", "--samples", "40", "--output", "s.csv"]
    bench_here(*words, cwd=tmp_path)
    rows = list(csv.DictReader((tmp_path / "s.csv").read_text().splitlines()))
    names = [name for name in rows[0] if not name.startswith("t")]
    for path in (tmp_path / "a.csv", tmp_path / "b.csv"):
        with path.open("w", newline="") as file:
            writer = csv.DictWriter(file, names, extrasaction="ignore")
            writer.writeheader()
            writer.writerows(row | {"group": "all"} for row in rows)
    run = ["run", "--model", "vjm", "--data", "a.csv", "--data", "b.csv"]
    robot = ["--robot", "kr10-r1100-2", "--no-torque"]
    assert_refused(bench_here(*run, *robot[:2], cwd=tmp_path), "missing tx_Nm", "say no-torque")
    done = bench_here(*run, *robot, cwd=tmp_path)
    assert done.returncode == 0, done.stderr
    assert "**a.csv (user's file)" in done.stdout and "**b.csv (user's file)" in done.stdout
    words = ["data", "register", "kr10-measured", "a.csv", "--no-torque"]
    assert bench_here(*words, cwd=tmp_path, env=home).returncode == 0
    run = ["run", "--model", "vjm", "--dataset", "kr10-measured"]
    assert bench_here(*run, cwd=tmp_path, env=home).returncode == 0


def test_simulated_samples_validate_and_run(tmp_path):
    words = ["data", "simulate", "--twin", "ur5", "--samples", "60", "--output", "s.parquet"]
    done = bench_here(*words, cwd=tmp_path)
    assert done.returncode == 0, done.stderr
    assert "60 SIMULATED samples" in done.stdout
    robot = ["--robot", "ur5"]
    checked = bench_here("data", "validate", "s.parquet", *robot, cwd=tmp_path)
    assert checked.returncode == 0, checked.stdout
    run = bench_here("run", "--model", "vjm", "--data", "s.parquet", *robot, cwd=tmp_path)
    assert run.returncode == 0, run.stderr
    assert "s.parquet (user's file)" in run.stdout


def test_a_robot_of_ones_own_is_simulated_from_urdf_and_constants(tmp_path):
    constants = (files("stiff_datasets") / "twins" / "ur5.toml").read_text()
    (tmp_path / "mine.toml").write_text(constants.replace('urdf = "ur5"', 'urdf = "mine.urdf"'))
    (tmp_path / "mine.urdf").write_text((ROBOTS / "ur5.urdf").read_text())
    words = ["data", "simulate", "--twin", "mine.toml", "--samples", "100", "--output", "s.csv"]
    assert bench_here(*words, cwd=tmp_path).returncode == 0
    words = ["run", "--model", "vjm", "--dataset", "robot-twin"]
    done = bench_here(*words, "--set", "robot-twin.constants=mine.toml", cwd=tmp_path)
    assert done.returncode == 0, done.stderr
    assert "robot-twin@constants=mine.toml (simulated)" in done.stdout


def test_info_prints_card_facts_and_caveats_and_draws_a_picture(tmp_path):
    done = bench_here("data", "info", "fanuc-r2000ic", cwd=tmp_path)
    assert done.returncode == 0, done.stderr
    picture = "results/info/fanuc-r2000ic.png"
    for part in ("drill tip", "Copyright (c) 2026", "sha256", "43", picture):
        assert part in done.stdout
    assert (tmp_path / picture).read_bytes().startswith(b"\x89PNG")


@pytest.mark.slow
def test_info_takes_a_data_sets_options(tmp_path):
    shown = [
        bench_here("data", "info", "kr10-twin", *words, cwd=tmp_path).stdout
        for words in ([], ["--set", "kr10-twin.specimen=3"])
    ]
    hashes = [
        next(line for line in text.splitlines() if "sha256" in line and "|" not in line)
        for text in shown
    ]
    assert hashes[0] != hashes[1]
    assert "options: specimen=3" in shown[1]
    pictures = sorted(path.name for path in (tmp_path / "results/info").iterdir())
    assert pictures == ["kr10-twin.png", "kr10-twin_specimen=3.png"]


@pytest.mark.parametrize(
    ("words", "parts"),
    [
        (["plan", "--robot", "kr11", "--output", "p.csv"], ["robot 'kr11'", "kr10-r1100-2"]),
        (["plan", "--robot", "ur5", "--urdf", "x", "--output", "p.csv"], ["--robot ur5", "one of"]),
        (["plan", "--poses", "9", "--clearance", "5", "--output", "p.csv"], ["clearance", "5 m"]),
        (["plan", "--tcp", "0,0,0.3", "--output", "p.csv"], ["the paper's poses", "clearance"]),
        (["plan", "--poses", "1", "--output", "p.csv"], ["poses is 1, expected 2"]),
        (["plan", "--output", "p.parquet"], ["p.parquet", ".csv"]),
        (["plan", "--output", "absent/p.csv"], ["no folder absent"]),
        (["simulate", "--twin", "ur6", "--output", "s.csv"], ["--twin 'ur6'", "ur5"]),
        (["simulate", "--twin", "x.toml", "--output", "s.csv"], ["x.toml: cannot be read"]),
        (["simulate", "--output", "s.xls"], ["s.xls", ".csv, .parquet"]),
        (["info", "my.csv"], ["my.csv: needs its robot too: --urdf FILE.urdf or --robot NAME"]),
        (["info", "kr10-twn"], ["unknown dataset 'kr10-twn'", "did you mean 'kr10-twin'"]),
        (["info", "robot-twin"], ["robot-twin", "robot-twin@constants=..."]),
        (["info", "kr10-twin", "--robot", "ur5"], ["kr10-twin: no file of samples", ".xlsx"]),
        (["info", "kr10-twin", "--no-torque"], ["kr10-twin: no file of samples", ".xlsx"]),
        (["info", "my.CSV", "--set", "a.b=1"], ["--set 'a.b=1'", "my.CSV has no options"]),
        (["info", "kr10-twin", "--output", "/dev/null/x"], ["/dev/null/x: cannot be made"]),
    ],
)
def test_bad_words_are_refused_in_one_line(tmp_path, words, parts):
    assert_refused(bench_here("data", *words, cwd=tmp_path), *parts)
    assert list(tmp_path.iterdir()) == []


def test_a_description_with_a_gripper_is_planned_read_and_registered_with_one_note(tmp_path, home):
    tree_urdf(tmp_path / "arm.urdf", arm_lines("base", "a", 6) + gripper_lines("a6"))
    plan = ["data", "plan", "--urdf", "arm.urdf", "--payload", "3", "--poses", "8"]
    done = bench_here(*plan, "--tcp", "0.1,0,0", "--output", "p.csv", cwd=tmp_path)
    assert done.returncode == 0, done.stderr
    notes = [line for line in done.stderr.splitlines() if "note" in line]
    assert len(notes) == 2 and "'hand_tcp'" in notes[0] and "to_left, to_right" in notes[1]
    robot = ["--urdf", "arm.urdf", "--tip", "hand", "--tcp", "0.1,0,0.1"]
    done = bench_here(*plan, *robot[2:], "--output", "q.csv", cwd=tmp_path)
    assert "hand_tcp" not in done.stderr and "the same --urdf, --tip" in done.stdout
    assert (tmp_path / "p.csv").read_text() == (tmp_path / "q.csv").read_text()
    table = pd.read_csv(tmp_path / "p.csv").assign(dx_mm=0.1, dy_mm=0.2, dz_mm=-0.3)
    for name in ("a.csv", "b.csv"):
        table.to_csv(tmp_path / name, index=False)
    words = ["run", "--model", "mean", "--data", "a.csv", "--data", "b.csv", "--no-torque", *robot]
    done = bench_here(*words, "--output", "r", cwd=tmp_path)
    assert done.returncode == 0, done.stderr
    assert done.stderr.count("note:") == 1
    words = ["data", "register", "kr10-measured", "a.csv", "--no-torque"]
    assert_refused(bench_here(*words, "--tip", "hand", cwd=tmp_path, env=home), "--tip hand")
    assert bench_here(*words, *robot, cwd=tmp_path, env=home).returncode == 0
    with mock.patch.dict(os.environ, home):
        assert registration().tip == "hand"


def test_an_unknown_tip_is_refused_with_the_links_that_there_are(tmp_path):
    tree_urdf(tmp_path / "arm.urdf", arm_lines("base", "a", 6) + gripper_lines("a6"))
    words = ["data", "plan", "--urdf", "arm.urdf", "--payload", "3", "--output", "p.csv"]
    done = bench_here(*words, "--tip", "hand_tpc", cwd=tmp_path)
    assert_refused(done, "--tip", "'hand_tpc'", "did you mean 'hand_tcp'", "(valid: hand_tcp, ")
