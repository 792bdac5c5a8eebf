"""`bench fit`, `bench predict` and `bench export`: what they write, and how they refuse."""

from __future__ import annotations

import csv
from pathlib import Path

import click
import numpy as np
import pandas as pd
import pytest
from click.testing import CliRunner

from helpers.command_line import assert_refused, bench_here
from stiff_bench.api.model import load_model
from stiff_bench.cli import models as deploy_cli
from stiff_datasets.measured.sheet_files import sample_table, write_table
from stiff_datasets.robots.urdf_reader import load_robot
from stiff_models import load
from stiff_protocols.contract.errors import DataError
from stiff_protocols.contract.types import Samples

JOINTS = "q1_deg,q2_deg,q3_deg,q4_deg,q5_deg,q6_deg"
WRENCH = "fx_N,fy_N,fz_N,tx_Nm,ty_Nm,tz_Nm"
HEADER = f"{JOINTS},{WRENCH}"
PREDICTED = ("dx_mm", "dy_mm", "dz_mm", "extrapolates")
ROW = "10,-60,70,0,40,0,50,10,-80,1,2,0"


def run(command: click.Command, *words: object) -> str:
    """What a command prints, warnings too; its error is raised."""
    done = CliRunner().invoke(command, [str(word) for word in words])
    if done.exception is not None:
        raise done.exception
    return done.output


@pytest.fixture(scope="module")
def vjm_file(tmp_path_factory) -> Path:
    path = tmp_path_factory.mktemp("models") / "vjm.stiff"
    run(deploy_cli.fit, "--model", "vjm", "--dataset", "kr10-twin", "--output", path)
    return path


@pytest.fixture()
def predict(vjm_file, tmp_path):
    """A function that predicts the lines of a file with the VJM; returns output and text."""

    def make(*lines: str) -> tuple[pd.DataFrame, str]:
        poses, output = tmp_path / "poses.csv", tmp_path / "out.csv"
        poses.write_text("\n".join(lines) + "\n")
        words = ["--model", vjm_file, "--input", poses, "--output", output]
        text = run(deploy_cli.predict, *words)
        return pd.read_csv(output, dtype={"pose_id": str}), text

    return make


def test_a_fit_prints_a_row_a_spring_and_says_which_the_samples_cannot_tell(tmp_path):
    words = ("--dataset", "fanuc-r2000ic", "--output", tmp_path / "springs.stiff")
    text = run(deploy_cli.fit, "--model", "vjm-multisegment", *words)
    rows = [line for line in text.splitlines() if "[Nm/rad]" in line and " to " in line]
    assert [row[:12] for row in rows] == [f"J{j} segment {k}" for j in range(1, 7) for k in (1, 2)]
    assert 0 < sum("not identifiable" in row for row in rows) < len(rows)
    assert "stiffness J1" not in text  # said once
    notes = text.splitlines()[text.splitlines().index(rows[-1]) + 1 :]
    assert notes[0].startswith("rank ") and notes[1].startswith("Springs ")
    assert notes[1].endswith(".")  # a sentence a line


def test_a_fit_prints_the_fitted_point_with_its_interval(tmp_path):
    words = ("--dataset", "fanuc-r2000ic", "--output", tmp_path / "fitted.stiff")
    text = run(deploy_cli.fit, "--model", "vjm@tcp=fit", *words)
    lines = [line for line in text.splitlines() if "fitted geometry, TCP" in line]
    assert len(lines) == 10 and all("[mm]: " in line for line in lines)


def test_predictions_are_written_to_standard_output(vjm_file, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    Path("poses.csv").write_text(f"{HEADER}\n{ROW}\n")
    words = ["--model", vjm_file, "--input", "poses.csv", "--output", "-"]
    header, *rows = run(deploy_cli.predict, *words).splitlines()
    assert header.split(",") == [*HEADER.split(","), *PREDICTED]
    assert len(rows) == 1 and not Path("-").exists()


@pytest.mark.slow
def test_fit_predict_and_export_on_the_command_line(tmp_path):
    words = ("--dataset", "kr10-twin", "--output", "vjm.stiff")
    done = bench_here("fit", "--model", "vjm", *words, cwd=tmp_path)
    assert done.returncode == 0, done.stderr
    for part in ("vjm.stiff: vjm", "kr10-twin (simulated, 151 samples)", "seed 0",
                 "A1 [Nm/rad]", "never measured"):  # fmt: skip
        assert part in done.stdout
    lines = (f"pose_id,load_id,group,{HEADER},dx_mm,dy_mm,dz_mm", f"P1,1,all,{ROW},,,")
    (tmp_path / "plan.csv").write_text("\n".join(lines))  # as `bench data plan` writes it
    words = ("--input", "plan.csv", "--output", "out.csv")
    done = bench_here("predict", "--model", "vjm.stiff", *words, cwd=tmp_path)
    assert done.stdout == "out.csv: 1 row predicted by vjm, robot kr10_r1100_2\n"
    with (tmp_path / "out.csv").open() as file:
        assert next(csv.reader(file)) == [
            *"pose_id,load_id,group".split(","), *HEADER.split(","), *PREDICTED,
        ]  # fmt: skip
    options = ("training=best", "width=8", "layers=1", "epochs=3")
    small = [f"--set=mlp.{option}" for option in options]
    words = ("--dataset", "kr10-twin", "--output", "mlp.stiff")
    done = bench_here("fit", "--model", "mlp", *small, *words, cwd=tmp_path)
    assert done.returncode == 0, done.stderr
    assert "of 31 poses chose the number of epochs; 120 samples" in done.stdout
    done = bench_here("export", "--model", "mlp.stiff", "--output", "net.onnx", cwd=tmp_path)
    assert (done.returncode, done.stderr) == (0, "")
    assert "float64" in done.stdout and (tmp_path / "net.onnx").stat().st_size > 0


def test_predictions_are_the_models_in_millimetres_beside_the_rows(predict, vjm_file):
    table, text = predict(f"pose_id,{HEADER}", f"007,{ROW}", f"008,{ROW}")
    assert "2 rows" in text and "warning" not in text
    assert table["extrapolates"].isna().all()
    assert list(table.columns) == [*f"pose_id,{HEADER}".split(","), *PREDICTED]
    assert table["pose_id"].tolist() == ["007", "008"]
    q = np.deg2rad([[10.0, -60, 70, 0, 40, 0]])
    truth = load(vjm_file).predict(q, np.array([[50.0, 10, -80, 1, 2, 0]]))
    ours = table[["dx_mm", "dy_mm", "dz_mm"]].to_numpy() / 1000
    np.testing.assert_allclose(ours, np.tile(truth, (2, 1)), rtol=1e-9)


def test_measured_deflections_are_not_read_and_not_taken_for_predictions(predict):
    table, _ = predict(f"{HEADER},dx_mm,dy_mm,dz_mm", f"{ROW},99,,nonsense")
    assert list(table.columns) == [*HEADER.split(","), *PREDICTED]
    assert (table[["dx_mm", "dy_mm", "dz_mm"]].abs() < 10).all(axis=None)


def test_a_coverage_of_all_axes_at_once_is_a_box_of_wider_intervals_of_each(tmp_path):
    model, poses = tmp_path / "gp.stiff", tmp_path / "poses.csv"
    words = ["--set", "gp.search_rows=20", "--set", "gp.restarts=0", "--set", "gp.ard=false"]
    run(deploy_cli.fit, "--model", "gp", *words, "--dataset", "kr10-twin", "--output", model)
    poses.write_text(f"{HEADER}\n{ROW}\n")

    def predicted(*asked: object) -> pd.DataFrame:
        output = tmp_path / f"{len(list(tmp_path.iterdir()))}.csv"
        run(deploy_cli.predict, "--model", model, "--input", poses, "--output", output, *asked)
        return pd.read_csv(output)

    box, axis = predicted("--coverage-3d", 0.9), predicted("--coverage", 0.9)
    assert box.equals(predicted("--coverage", 1 - 0.1 / 3))
    assert (box["dx_upper_mm"] > axis["dx_upper_mm"]).all()
    with pytest.raises(SystemExit):
        predicted("--coverage-3d", 0.9, "--coverage", 0.9)


def test_what_is_odd_is_predicted_with_a_warning(predict):
    table, said = predict(f"{HEADER},note", f"{ROW},a", ROW.replace("10,", "200,", 1) + ",b")
    assert len(table) == 2
    assert "columns not used: note" in said
    assert "1 row with a joint outside of its limits, the first: row 3, column q1_deg" in said


@pytest.mark.parametrize(
    ("lines", "parts"),
    [
        ([HEADER, ROW.replace("-80", "much")], ["row 2, column fz_N: 'much', expected a finite"]),
        ([HEADER, ROW, ROW.replace("40", "", 1)], ["row 3, column q5_deg: ''"]),
        ([HEADER, ROW.replace("-80", "-8e7")], ["column fz_N", "another unit"]),
        (
            [HEADER.replace("fx_N", "fx_lbf"), ROW],
            ["missing fx_N", "columns not used: fx_lbf", "optional: pose_id"],
        ),
        ([HEADER], ["no data rows"]),
        ([HEADER, ROW.replace("50", "a"), ROW.replace("50", "b")], ["and 1 more"]),
    ],
)
def test_a_bad_value_is_named_with_file_row_and_column(lines, parts, predict):
    with pytest.raises(DataError) as refused:
        predict(*lines)
    file, colon, _ = str(refused.value).partition(": ")
    assert file.endswith("poses.csv") and colon
    for part in parts:
        assert part in str(refused.value)


FIT = ["fit", "--model", "vjm", "--dataset", "kr10-twin", "--output"]
PREDICT = ["predict", "--model", "vjm.stiff", "--input", "loads.csv", "--output"]


@pytest.mark.parametrize(
    ("words", "part"),
    [
        ([*FIT, "vjm.stiff"], "vjm.stiff: exists"),
        ([*PREDICT, "loads.csv"], "loads.csv: exists"),
        (["export", "--model", "vjm.stiff", "--output", "loads.csv"], "loads.csv: exists"),
        ([*FIT, "none/vjm.stiff"], "no folder none"),
        ([*FIT[:3], "--output", "new"], "one of --dataset KEY and --data"),
        ([*FIT, "new", "--data", "my.csv", "--robot", "ur5"], "one of --dataset KEY and --data"),
        ([*PREDICT, "out.xlsx"], "Excel files are read, not written (valid: .csv, .parquet)"),
    ],
)
def test_what_cannot_be_written_is_refused_and_nothing_changes(words, part, vjm_file, tmp_path):
    contents = {"vjm.stiff": vjm_file.read_bytes(), "loads.csv": f"{HEADER}\n{ROW}\n".encode()}
    for name, content in contents.items():
        (tmp_path / name).write_bytes(content)
    assert_refused(bench_here(*words, cwd=tmp_path), part)
    assert {path.name: path.read_bytes() for path in tmp_path.iterdir()} == contents


def test_rows_beyond_the_training_range_are_marked_and_one_warning_has_the_numbers(
    predict, vjm_file
):
    heavy = ROW.replace("50,10,-80", "250,50,-400")  # five times the load
    turned = ROW.replace("10,-60", "105,-60")  # 60 degrees beyond the training poses
    table, said = predict(HEADER, ROW, heavy, turned, heavy.replace("10,-60", "-75,-60"))
    marks = table["extrapolates"].fillna("").tolist()
    assert marks == ["", "load", "joints", "joints load"]
    (warning,) = (line for line in said.splitlines() if "warning" in line)
    known = load(vjm_file).training_range_
    low, high = np.degrees([known.lower[0], known.upper[0]])
    force = np.linalg.norm([250.0, 50.0, 400.0])
    for part in ("3 of 4 rows", f"q1 105 deg (training: {low:.4g} to {high:.4g})",
                 f"force {force:.4g} N (training: up to {known.force:.4g})"):  # fmt: skip
        assert part in warning
    assert "torque" not in warning


def test_a_plugins_model_is_saved_and_read_where_its_file_is_named(plugin_file, tmp_path):
    plugin, saved = plugin_file("mine"), tmp_path / "mine.stiff"
    run(deploy_cli.fit, "--model", "mine", "--plugin", plugin, "--dataset", "kr10-twin",
        "--output", saved)  # fmt: skip
    poses = tmp_path / "poses.csv"
    poses.write_text(f"{HEADER}\n{ROW.replace('-80', '-400')}\n")
    words = ("--model", saved, "--input", poses, "--output", tmp_path / "out.csv")
    with pytest.raises(DataError, match=r"holds mine, a plugin's model.*--plugin"):
        run(deploy_cli.predict, *words)
    run(deploy_cli.predict, *words, "--plugin", plugin)
    assert pd.read_csv(tmp_path / "out.csv")["extrapolates"].tolist() == ["load"]
    plugin.write_text(plugin.read_text() + "\n# other code\n")
    (tmp_path / "out.csv").unlink()
    with pytest.raises(DataError, match="other code"):
        run(deploy_cli.predict, *words, "--plugin", plugin)


SLIDE = (
    '<robot name="slide"><link name="a"/><link name="b"/><link name="c"/>'
    '<joint name="rail" type="prismatic"><parent link="a"/><child link="b"/><axis xyz="1 0 0"/>'
    '<limit lower="0" upper="2" effort="1" velocity="1"/></joint>'
    '<joint name="turn" type="revolute"><parent link="b"/><child link="c"/><axis xyz="0 0 1"/>'
    '<limit lower="-3" upper="3" effort="1" velocity="1"/></joint></robot>'
)


def test_ones_own_robot_with_a_rail_from_a_measurement_to_predictions_in_parquet(tmp_path, rng):
    urdf = tmp_path / "slide.urdf"
    urdf.write_text(SLIDE)
    robot = load_robot(urdf, tcp=(0.5, 0.0, 0.1))
    q = rng.uniform([0, -3], [2, 3], size=(12, 2))
    wrench = rng.normal(scale=50, size=(12, 6))
    names = np.arange(12).astype(str)
    deflection = robot.joint_deflection(np.array([1e-6, 1e-5]), q, wrench)
    measured = Samples(q, wrench, deflection, names, names, names)
    write_table(tmp_path / "my.parquet", [sample_table(measured, robot)])
    run(deploy_cli.fit, "--model", "vjm", "--data", tmp_path / "my.parquet", "--urdf", urdf,
        "--tcp", "0.5,0,0.1", "--output", tmp_path / "vjm.stiff")  # fmt: skip
    run(deploy_cli.predict, "--model", tmp_path / "vjm.stiff", "--input", tmp_path / "my.parquet",
        "--output", tmp_path / "out.parquet")  # fmt: skip
    table = pd.read_parquet(tmp_path / "out.parquet")
    assert list(table.columns)[3:5] == ["q1_mm", "q2_deg"]
    np.testing.assert_allclose(table["q1_mm"], q[:, 0] * 1000, rtol=1e-12)
    ours = table[["dx_mm", "dy_mm", "dz_mm"]].to_numpy() / 1000
    np.testing.assert_allclose(ours, deflection, atol=1e-12)


def test_whatever_a_crafted_model_raises_is_blamed_on_its_file(vjm_file, tmp_path):
    model = load_model(vjm_file)
    model.fitted.springs_ = "no joints"
    poses = tmp_path / "poses.csv"
    poses.write_text(f"{HEADER}\n{ROW}\n")
    with pytest.raises(DataError, match=r"vjm\.stiff: its model cannot predict: AttributeError"):
        model.predict_file(poses, tmp_path / "out.csv")
