"""`bench fit`, `bench predict` and `bench export`: their files, and notes on rows."""

from __future__ import annotations

import re
from datetime import date
from io import StringIO

import numpy as np
import pandas as pd
import pytest

import stiffbench as sb
from helpers.command_line import bench_here
from helpers.made_robots import arm_lines, planar_arm, track_lines, tree_urdf
from helpers.made_samples import samples_with
from stiff_bench.api.model import load_model
from stiff_datasets.measured.table_reader import sample_table, write_table
from stiff_datasets.robots.urdf_reader import read_robot
from stiff_models import load
from stiff_protocols.contract.errors import ConfigError, DataError

JOINTS = "q1_deg,q2_deg,q3_deg,q4_deg,q5_deg,q6_deg"
WRENCH = "fx_N,fy_N,fz_N,tx_Nm,ty_Nm,tz_Nm"
HEADER = f"{JOINTS},{WRENCH}"
DEFLECTION = ["dx_mm", "dy_mm", "dz_mm"]
PREDICTED = [*DEFLECTION, "extrapolates"]
ROW = "10,-60,70,0,40,0,50,10,-80,1,2,0"
FIT_TWIN = ("fit", "--dataset", "kr10-twin")


@pytest.fixture()
def bench(tmp_path):
    """A function that runs a command to success and returns its output and warnings."""

    def run(*words: object) -> str:
        done = bench_here(*map(str, words), cwd=tmp_path)
        assert done.returncode == 0, done.stderr
        return done.stdout + done.stderr

    return run


@pytest.fixture()
def predict(vjm_file, tmp_path, bench):
    """A function that predicts lines of a file with the VJM and returns table and text."""

    def make(*lines: str) -> tuple[pd.DataFrame, str]:
        (tmp_path / "poses.csv").write_text("\n".join(lines) + "\n")
        text = bench("predict", "--model", vjm_file, "--input", "poses.csv", "--output", "out.csv")
        return pd.read_csv(tmp_path / "out.csv", dtype={"pose_id": str}), text

    return make


def test_a_fit_prints_a_row_per_spring_and_marks_those_that_are_not_identifiable(bench):
    words = ("--dataset", "fanuc-r2000ic", "--output", "springs.stiff")
    text = bench("fit", "--model", "vjm-multisegment", *words)
    rows = [line for line in text.splitlines() if "[Nm/rad]" in line and " to " in line]
    assert [row[:12] for row in rows] == [f"J{j} segment {k}" for j in range(1, 7) for k in (1, 2)]
    assert 0 < sum("not identifiable" in row for row in rows) < len(rows)


def test_a_group_of_springs_that_the_samples_do_not_need_is_printed_as_none_found():
    robot, rng = planar_arm(2, (0.0, 1.0, 0.0), mass=2.0), np.random.default_rng(0)
    q, wrench = rng.uniform(-1.5, 1.5, (40, 2)), 50.0 * rng.normal(size=(40, 6))
    deflection = robot.joint_deflection(np.array([1e-5, 2e-5]), q, wrench)
    samples = samples_with(q, wrench, deflection + 1e-6 * rng.normal(size=(40, 3)))
    model = sb.make_model("bayes-springs", groups="joints+lost motion")
    model.fit(sb.Dataset.from_samples(samples, robot))
    assert "- contribution of lost motion [mm]: none found" in model.learned
    assert model.diagnostics["contribution of lost motion [mm]"] == 0.0
    assert model.diagnostics["contribution of joints [mm]"] > 0.0
    assert "none found" in str(model)


def test_predictions_are_the_models_in_millimetres_next_to_the_rows(predict, vjm_file):
    names = f"pose_id,{HEADER}"  # measured deflections are not read
    table, text = predict(f"{names},dx_mm", f"007,{ROW},99", f"008,{ROW},nonsense")
    assert "2 rows" in text and "warning" not in text
    assert table["extrapolates"].isna().all()
    assert list(table.columns) == [*names.split(","), *PREDICTED]
    assert table["pose_id"].tolist() == ["007", "008"]
    q = np.deg2rad([[10.0, -60, 70, 0, 40, 0]])
    truth = load(vjm_file).predict(q, np.array([[50.0, 10, -80, 1, 2, 0]]))
    np.testing.assert_allclose(table[DEFLECTION] / 1000, np.tile(truth, (2, 1)), rtol=1e-9)


def test_other_columns_stay_in_the_predictions_and_earlier_predictions_go(predict, vjm_file):
    names = f"part,{HEADER},T [C],dx_lower_mm,extrapolates,part"
    table, _ = predict(names, f'"Träger, links",{ROW},"21,5",7,load,B')
    assert list(table.columns) == [*HEADER.split(","), "part", "T [C]", "part.1", *PREDICTED]
    assert table[["part", "T [C]", "part.1"]].iloc[0].tolist() == ["Träger, links", "21,5", "B"]
    assert table["extrapolates"].isna().all()


def test_intervals_of_a_coverage_go_to_standard_output_next_to_the_predictions(vjm_file, tmp_path):
    (tmp_path / "poses.csv").write_text(f"{HEADER}\n{ROW}\n")
    words = ("--input", "poses.csv", "--output", "-", "--coverage", "0.8")
    done = bench_here("predict", "--model", vjm_file, *words, cwd=tmp_path)
    assert not (tmp_path / "-").exists()
    table, q = pd.read_csv(StringIO(done.stdout)), np.deg2rad([[10.0, -60, 70, 0, 40, 0]])
    wrench = np.array([[50.0, 10, -80, 1, 2, 0]])
    interval = load_model(vjm_file).predict_interval(q, wrench, 0.8)
    for end in ("lower", "upper"):
        columns = [name.replace("_mm", f"_{end}_mm") for name in DEFLECTION]
        np.testing.assert_allclose(table[columns] / 1000, getattr(interval, end), atol=1e-12)


def test_rows_beyond_the_training_range_are_marked_and_one_warning_has_the_numbers(
    predict, vjm_file
):
    heavy = ROW.replace("50,10,-80", "250,50,-400")  # five times the load
    turned = ROW.replace("10,-60", "105,-60")  # 60 degrees beyond the training poses
    table, printed_text = predict(HEADER, ROW, heavy, turned, heavy.replace("10,-60", "-75,-60"))
    marks = table["extrapolates"].fillna("").tolist()
    assert marks == ["", "load", "joints", "joints load"]
    (warning,) = (line for line in printed_text.splitlines() if "warning" in line)
    training_range, force = load(vjm_file).training_range_, np.linalg.norm([250.0, 50.0, 400.0])
    low, high = np.degrees([training_range.lower[0], training_range.upper[0]])
    for part in ("3 of 4 rows", f"q1 105 deg (training: {low:.4g} to {high:.4g})",
                 f"force {force:.4g} N (training: up to {training_range.force:.4g})"):  # fmt: skip
        assert part in warning


def test_a_plugins_model_is_saved_and_read_where_its_file_is_named(plugin_file, tmp_path, bench):
    plugin = plugin_file("mine")
    bench(*FIT_TWIN, "--model", "mine", "--plugin", plugin, "--output", "mine.stiff")
    (tmp_path / "poses.csv").write_text(f"{HEADER}\n{ROW.replace('-80', '-400')}\n")
    words = ("predict", "--model", "mine.stiff", "--input", "poses.csv", "--output", "out.csv")
    refused = bench_here(*words, cwd=tmp_path)
    assert refused.returncode == 2 and "--plugin" in refused.stderr
    bench(*words, "--plugin", plugin)
    assert pd.read_csv(tmp_path / "out.csv")["extrapolates"].tolist() == ["load"]
    plugin.write_text(plugin.read_text() + "\n# plugin file has changed\n")
    (tmp_path / "out.csv").unlink()
    refused = bench_here(*words, "--plugin", plugin, cwd=tmp_path)
    assert refused.returncode == 2 and "plugin file has changed" in refused.stderr


def test_ones_own_robot_with_a_rail_from_a_measurement_to_predictions_in_parquet(
    tmp_path, rng, bench
):
    joints = "base cart prismatic axis=x limits=0..2\ncart arm revolute limits=-3..3"
    urdf = tree_urdf(tmp_path / "slide.urdf", joints)
    robot = read_robot(urdf, tcp=(0.5, 0.0, 0.1))
    q = rng.uniform([0, -3], [2, 3], size=(12, 2))
    wrench = rng.normal(scale=50, size=(12, 6))
    deflection = robot.joint_deflection(np.array([1e-6, 1e-5]), q, wrench)
    measured = deflection + 1e-13  # a column of exact zeros would be refused
    table = sample_table(samples_with(q, wrench, measured), robot)
    write_table(tmp_path / "my.parquet", [table])
    words = ("--data", "my.parquet", "--urdf", urdf, "--tcp", "0.5,0,0.1")
    bench("fit", "--model", "vjm", *words, "--output", "vjm.stiff")
    words = ("--input", "my.parquet", "--output", "out.parquet")
    bench("predict", "--model", "vjm.stiff", *words)
    table = pd.read_parquet(tmp_path / "out.parquet")
    assert list(table.columns)[3:5] == ["q1_mm", "q2_deg"]
    np.testing.assert_allclose(table["q1_mm"], q[:, 0] * 1000, rtol=1e-12)
    np.testing.assert_allclose(table[DEFLECTION] / 1000, deflection, atol=1e-12)


@pytest.mark.slow
def test_a_file_without_the_rails_column_is_fitted_with_the_rail_held(
    tmp_path, rng, bench, monkeypatch
):
    urdf = tree_urdf(tmp_path / "track.urdf", track_lines(3))
    arm = read_robot(tree_urdf(tmp_path / "arm.urdf", arm_lines("base", "a", 3)), tcp=(0.1, 0, 0.2))
    q, wrench = rng.uniform(-1.5, 1.5, size=(30, 3)), rng.normal(scale=50, size=(30, 6))
    deflection = arm.joint_deflection(np.array([1e-5, 2e-5, 3e-5]), q, wrench)
    write_table(tmp_path / "my.csv", [sample_table(samples_with(q, wrench, deflection), arm)])
    words = ("--urdf", urdf, "--tcp", "0.1,0,0.2", "--hold", "to_cart=500")
    report = bench_here("data", "validate", "my.csv", *words, cwd=tmp_path).stdout
    assert "to_cart=500 mm held" in report
    bench("fit", "--model", "vjm", "--data", "my.csv", *words, "--output", "vjm.stiff")
    model = load_model(tmp_path / "vjm.stiff")
    assert model.fitted.robot_.held == ("to_cart=500 mm",) and "to_cart=500 mm" in repr(model)
    np.testing.assert_allclose(model.fitted.predict(q, wrench), deflection, atol=1e-12)
    place = model.fitted.robot_.tcp_position(q) - arm.tcp_position(q)
    np.testing.assert_allclose(place, np.tile([0.5, 0.0, 0.3], (30, 1)), atol=1e-12)
    plan = ("--payload", "5", "--poses", "4", "--candidates", "50", "--output", "plan.csv")
    assert "--hold to_cart=500 " in bench("data", "plan", *words, *plan)
    monkeypatch.setenv("STIFFBENCH_HOME", str(tmp_path / "home"))
    bench("data", "register", "my.csv", "--dataset", "kr10-measured", *words)
    assert "to_cart=500 mm" in (tmp_path / "my.md").read_text()
    assert sb.load_dataset("kr10-measured").robot.held == ("to_cart=500 mm",)


def test_an_error_of_a_crafted_model_names_its_file(vjm_file, tmp_path):
    model = load_model(vjm_file)
    model.fitted.springs_ = "no joints"
    (tmp_path / "poses.csv").write_text(f"{HEADER}\n{ROW}\n")
    with pytest.raises(DataError, match=r"vjm\.stiff: its model cannot predict: AttributeError"):
        model.predict_file(tmp_path / "poses.csv", tmp_path / "out.csv")


def test_a_fits_urdf_has_the_fitted_tcp_and_its_stiffnesses(bench, tmp_path):
    words = (*FIT_TWIN, "--no-cross-validate", "--model", "vjm@tcp=fit", "--output", "tcp.stiff")
    assert "tcp.urdf: kr10_r1100_2" in bench(*words, "--urdf-out", "tcp.urdf")
    model = load(tmp_path / "tcp.stiff")
    read = read_robot(tmp_path / "tcp.urdf")
    np.testing.assert_allclose(read.tcp, model.geometry_.robot.tcp, atol=1e-12)
    assert np.abs(read.tcp - model.robot_.tcp).max() > 1e-3
    q = np.random.default_rng(0).uniform(-1.0, 1.0, (5, 6))
    moved = model.geometry_.robot.tcp_position(q)
    np.testing.assert_allclose(read.tcp_position(q), moved, atol=1e-12)
    springs = re.findall(
        r'<stiffness spring="(A\d)" value="(.*?)"', (tmp_path / "tcp.urdf").read_text()
    )
    assert [name for name, _ in springs] == [f"A{k}" for k in range(1, 7)]
    stiffness = np.array([float(value) for _, value in springs])
    np.testing.assert_allclose(stiffness, 1.0 / model.springs_.compliance)


@pytest.mark.parametrize("model", ["mean", "fourier-springs", "vjm-full@solver=ridge"])
def test_a_model_without_stiffness_of_single_joints_writes_no_urdf(model, twin, tmp_path):
    fitted = sb.make_model(model).fit(twin)
    with pytest.raises(ConfigError, match=r"no stiffness of single joints.*valid: vjm"):
        fitted.write_urdf(tmp_path / "robot.urdf")
    assert not [*tmp_path.iterdir()]


def test_c_is_written_with_a_header_that_says_what_it_is_from(bench, vjm_file, twin, tmp_path):
    data, made = sb.Dataset.from_samples(twin.samples, twin.robot, name="cell-7"), tmp_path / "c"
    made.mkdir()
    sb.make_model("vjm").fit(data).save(made / "own.stiff", cross_validate=False)
    printed = bench(
        "export", "--model", made / "own.stiff", "--output", made / "a.c", "--format", "c"
    )
    assert "a.c" in printed and "a.h" in printed
    header = (made / "a.h").read_text()
    facts = ("vjm", "cell-7", f"{len(twin.samples)} samples", twin.sha256, twin.robot.name)
    assert [fact for fact in facts if fact not in header] == []
    assert date.today().isoformat() in header and "rad" in header and "N m" in header
    assert (made / "a.c").read_text().startswith(header)
    words = ("--model", made / "own.stiff", "--output", made / "a.c", "--format", "c")
    refused = bench_here("export", *words, cwd=tmp_path)
    assert refused.returncode == 2 and "exists" in refused.stderr
    (made / "b.h").touch()  # the header would be overwritten
    refused = bench_here("export", *words[:3], made / "b.c", "--format", "c", cwd=tmp_path)
    assert refused.returncode == 2 and not (made / "b.c").exists()
