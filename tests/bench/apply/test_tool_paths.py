"""`bench path`: from an example and a model to corrected commands, and refusals."""

from __future__ import annotations

from functools import partial
from pathlib import Path

import numpy as np
import pandas as pd
import pytest
from PIL import Image
from scipy.spatial.transform import Rotation

import stiffbench as sb
from helpers.command_line import bench_here
from helpers.made_robots import arm_lines, track_lines, tree_urdf
from helpers.made_samples import samples_with
from stiff_apply.example_path import example_path
from stiff_apply.path_file import read_path
from stiff_apply.tool_paths import compensate_path
from stiff_apply.tool_task import tool_of
from stiff_datasets.robots.shipped_robots import shipped_robots
from stiff_protocols.contract.errors import (
    ConfigError,
    DataError,
    ModelError,
    NotFittedError,
    StoreError,
)
from stiff_protocols.paths.inverse import follow

pytestmark = pytest.mark.filterwarnings("ignore:.*beyond the training range")

POSITION, ANGLES = ["x_mm", "y_mm", "z_mm"], ["a_deg", "b_deg", "c_deg"]
JOINTS = [f"q{i}_deg" for i in range(1, 7)]
FORCE = ["fx_N", "fy_N", "fz_N"]
LOADS = [*FORCE, "tx_Nm", "ty_Nm", "tz_Nm"]
HEADER = "x_mm,y_mm,z_mm,a_deg,b_deg,c_deg,fx_N,fy_N,fz_N"
ROW = "700,0,400,180,0,180,0,10,-40"
CSV = partial(pd.read_csv, keep_default_na=False)


@pytest.fixture(scope="module")
def square(tmp_path_factory) -> Path:
    path = tmp_path_factory.mktemp("paths") / "square.csv"
    example_path(path, points=13, load=(0.0, 20.0, -60.0, 0.0, 0.0, 1.0))
    return path


@pytest.fixture()
def corrected(vjm, tmp_path):
    """A function that corrects a path and returns the result and the written table."""

    def make(path: str | pd.DataFrame, model=vjm, **options: object):
        file, output = tmp_path / "path.csv", tmp_path / "corrected.csv"
        output.unlink(missing_ok=True)
        file.write_text(path if isinstance(path, str) else path.to_csv(index=False))
        return compensate_path(model, file, output, **options), CSV(output)

    return make


@pytest.mark.slow
def test_a_path_is_made_corrected_and_drawn_on_the_command_line(vjm_file, tmp_path):
    words = ("--shape", "circle", "--points", "21", "--output", "p.csv")
    made = bench_here("path", "example", *words, cwd=tmp_path)
    assert (made.returncode, made.stderr) == (0, "")
    words = ("--model", vjm_file, "--path", "p.csv", "--output", "c.csv")
    done = bench_here("path", "compensate", *words, "--figure", "c.png", cwd=tmp_path)
    assert done.returncode == 0, done.stderr
    beyond, corrected, removed, remaining = done.stdout.splitlines()[:4]
    share = "of 21 points are beyond the training range: q6"
    assert share in beyond and done.stderr == ""  # the measured poses have A6 at 0
    assert corrected == "21 of 21 points corrected"
    table = pd.read_csv(tmp_path / "c.csv")
    assert len(table) == 21
    for line, column in ((removed, "removed_mm"), (remaining, "expected_error_mm")):
        means = f": {table[column].mean():.3g} mm mean, {table[column].max():.3g} mm largest"
        assert means in line
    with Image.open(tmp_path / "c.png") as image:
        assert image.width > image.height > 500


@pytest.mark.slow
def test_commands_of_a_model_of_another_point_are_for_the_tcp_and_say_so(
    square, corrected, twin, capsys
):
    model = sb.make_model("vjm", tcp="fit").fit(twin)
    corrected_path, written = corrected(pd.read_csv(square), model=model, coverage=0.9)
    wrench = pd.read_csv(square)[LOADS].to_numpy()
    at_tcp = model.fitted.predict_at_tcp(np.radians(written[JOINTS].to_numpy()), wrench)
    np.testing.assert_allclose(corrected_path.compensation.deflection, at_tcp, atol=1e-8)
    interval = corrected_path.prediction_error.interval
    middle = 0.5 * (interval.lower + interval.upper)
    np.testing.assert_allclose(middle, at_tcp, atol=1e-8)
    assert "a tool point other than the TCP" in capsys.readouterr().err


class Wild:
    """A model whose prediction alternates where the force is large, so that it never converges."""

    def __init__(self, inner) -> None:
        self.inner, self.robot_, self.training_range_ = inner, inner.robot_, inner.training_range_
        self.calls = 0

    def predict(self, q, wrench):
        self.calls += 1
        return self.inner.predict(q, wrench) + 1e-3 * (self.calls % 2) * (wrench[:, 1:2] > 15.0)


class Rounding(Wild):
    """A model of the TCP itself, whose two predictions differ by a rounding error."""

    def predict(self, q, wrench):
        return self.inner.predict(q, wrench)

    def predict_at_tcp(self, q, wrench):
        return self.predict(q, wrench) * (1.0 + 1e-7)


@pytest.mark.slow
def test_a_rounding_difference_is_not_another_tool_point(square, corrected, vjm, capsys):
    model = sb.make_model("vjm")
    model.fitted = Rounding(vjm.fitted)
    corrected(pd.read_csv(square), model=model)
    assert "a tool point other than the TCP" not in capsys.readouterr().err


@pytest.mark.slow
def test_loaded_tool_with_the_written_commands_is_on_the_path(square, corrected, vjm):
    path_table = pd.read_csv(square)
    corrected_path, written = corrected(path_table, tolerance=1e-4)
    q = np.radians(written[JOINTS].to_numpy())
    command = vjm.fitted.robot_.tcp_position(q)
    np.testing.assert_allclose(1000.0 * command, written[POSITION], atol=1e-4)
    deflection = vjm.fitted.predict(q, path_table[LOADS].to_numpy())
    off = 1000.0 * (command + deflection) - path_table[POSITION]
    assert np.linalg.norm(off, axis=1).max() < 2e-4
    np.testing.assert_allclose(1000.0 * deflection, written[["dx_mm", "dy_mm", "dz_mm"]], atol=1e-5)
    np.testing.assert_allclose(1000.0 * corrected_path.removed, written["removed_mm"], atol=1e-7)
    np.testing.assert_allclose(1000.0 * corrected_path.expected_error, written["expected_error_mm"])
    assert set(written["uncorrected"]) == {""}


@pytest.mark.slow
def test_same_path_in_other_words_gets_the_same_commands(square, corrected, tmp_path):
    path_table = pd.read_csv(square)
    unloaded, at_path = corrected(path_table.assign(fz_N=0.0, fy_N=0.0, tz_Nm=0.0))
    np.testing.assert_allclose(unloaded.compensation.position, unloaded.compensation.target)
    usual, written = corrected(path_table)

    def same(path: pd.DataFrame, **options: object) -> pd.DataFrame:
        corrected_path, again = corrected(path, **options)
        np.testing.assert_allclose(corrected_path.compensation.q, usual.compensation.q, atol=1e-7)
        return again

    turn = Rotation.from_euler("ZYX", path_table[ANGLES], degrees=True)
    quaternion = pd.DataFrame(turn.as_quat(scalar_first=True), columns=["qw", "qx", "qy", "qz"])
    same(pd.concat([path_table.drop(columns=ANGLES), quaternion], axis=1))
    metres = path_table.assign(**{name[:2] + "m": path_table[name] / 1000.0 for name in POSITION})
    same(metres.drop(columns=POSITION))
    same(path_table.drop(columns=LOADS), load=path_table.loc[0, LOADS].tolist())
    same(pd.concat([at_path[JOINTS], path_table[LOADS]], axis=1))
    in_tool = path_table.copy()
    in_tool[FORCE] = turn.inv().apply(path_table[FORCE])
    in_tool[LOADS[3:]] = turn.inv().apply(path_table[LOADS[3:]])
    same(in_tool, frame="tool")
    tool = Rotation.from_euler("ZYX", [30.0, 20.0, 10.0], degrees=True)
    tilted = path_table.copy()
    tilted[ANGLES] = (turn * tool).as_euler("ZYX", degrees=True)
    same(tilted, tool=(60.0, 0.0, 80.0, 30.0, 20.0, 10.0))
    table = Rotation.from_euler("ZYX", [90.0, 0.0, 10.0], degrees=True)
    local = path_table.assign(frame="table")
    local[POSITION] = table.inv().apply(path_table[POSITION] - [500.0, 10.0, 300.0])
    local[ANGLES] = (table.inv() * turn).as_euler("ZYX", degrees=True)
    again = same(local, workpiece=(500.0, 10.0, 300.0, 90.0, 0.0, 10.0))
    back = table.apply(again[POSITION])
    back += np.array([500.0, 10.0, 300.0])
    np.testing.assert_allclose(back, written[POSITION], atol=1e-6)
    assert set(again["frame"]) == {"table"}


def test_points_that_do_not_converge_stop_the_command_or_stay_uncorrected(vjm, corrected, tmp_path):
    path = "\n".join([HEADER, ROW, ROW.replace(",10,", ",20,"), ROW, ""])
    model = sb.make_model("vjm")
    model.fitted = Wild(vjm.fitted)
    with pytest.raises(ModelError, match=r"1 of 3 points .* row 3"):
        corrected(path, model)
    assert not list(tmp_path.glob("*corrected*"))
    with pytest.warns(UserWarning, match="row 3"):
        corrected_path, written = corrected(path, model, on_failure="keep")
    assert written["uncorrected"].tolist() == ["", "not converged", ""]
    np.testing.assert_array_equal(written.loc[1, POSITION].tolist(), [700.0, 0.0, 400.0])
    assert (written["expected_error_mm"] == "").all() and corrected_path.expected_error is None


@pytest.mark.slow
@pytest.mark.parametrize("robot", ["kr10-r1100-2", "ur5", "fanuc-r2000ic", "tx60", "gp12"])
def test_robots_of_each_kind_have_examples_that_they_can_drive(robot, tmp_path):
    arm, load = shipped_robots()[robot].robot(), (0.0, 0.0, -9.0, 0.0, 0.0, 0.0)
    for shape in ("square", "iso9283"):  # the others lie inside of these
        example_path(tmp_path / f"{shape}.csv", shape=shape, robot=robot, load=load)
        path_file = read_path(tmp_path / f"{shape}.csv", arm, tool_of(arm, None))
        assert (path_file.path.wrench[:, 2] == -9.0).all()
        assert follow(arm, path_file.path.position, path_file.path.rotation).ok.all()


def test_odd_input_is_reported_before_anything_is_computed(corrected, capsys):
    header = HEADER.replace("fx_N", "feed,fx_N")
    with pytest.raises(DataError, match=r"row 2.*joint A5"):
        corrected(f"{header}\n700,0,400,0,0.03,3.1,7,0,0,-40\n")
    unused, radians = capsys.readouterr().err.strip().splitlines()
    assert "not used: feed" in unused and "radians" in radians


ANGLES_AND_FORCE = ",".join([*JOINTS, *FORCE])
WRISTS = [f"0,-60,90,0,{angle},0,0,0,-9" for angle in (30, 31, 32, 33, 34)]
AS_METRES = [f"{0.7 + 0.01 * i:.3f},0,0.4,180,0,180,0,0,-40" for i in range(5)]
QUATERNION = "x_mm,y_mm,z_mm,qw,qx,qy,qz,fx_N,fy_N,fz_N"


@pytest.mark.slow
@pytest.mark.parametrize(
    ("rows", "parts"),
    [
        (["x_mm,y_mm,a_deg,b_deg,c_deg,fx_N,fy_N,fz_N", "1,2,3,4,5,6,7,8"], ["missing z_mm"]),
        ([f"{HEADER},q1_deg", f"{ROW},0"], ["more than one of these", "q1_deg"]),
        ([HEADER, *AS_METRES], ["look like metres"]),
        ([HEADER, *[ROW] * 6, "", ROW.replace("700", "2000")], ["row 9", "2000,0,400", "reaches"]),
        ([HEADER, ROW, ROW.replace("180", "1e300")], ["row 3", "a_deg", "1e300", "+-10000"]),
        ([f"{HEADER},frame", *[f"{ROW},base"] * 4, f"{ROW},table"], ["row 6", "'table'"]),
        ([ANGLES_AND_FORCE, WRISTS[0].replace("-60", "60")], ["row 2", "q2_deg", "-190..45 deg"]),
        ([ANGLES_AND_FORCE, *WRISTS, "0,-60,90,0,-35,0,0,0,-9"], ["row 7", "configuration"]),
        ([QUATERNION, "700,0,400,2,0,0,0,0,0,-9"], ["row 2", "qw", "length 1"]),
    ],
)
def test_a_bad_path_is_refused_with_its_row_and_what_is_valid(rows, parts, corrected, tmp_path):
    with pytest.raises((ConfigError, DataError)) as refused:
        corrected("\n".join([*rows, ""]))
    assert all(part in str(refused.value) for part in parts)
    assert [file.name for file in tmp_path.iterdir()] == ["path.csv"]


def test_invalid_arguments_and_existing_files_are_refused(vjm, square, tmp_path):
    with pytest.raises(StoreError, match="exists"):
        compensate_path(vjm, square, square)
    with pytest.raises(StoreError, match="exists"):
        example_path(square, shape="line")
    with pytest.raises(NotFittedError):
        compensate_path(sb.make_model("vjm"), square, tmp_path / "c.csv")
    for wrong in ({"on_failure": "go on"}, {"frame": "world"}, {"iterations": 0}):
        with pytest.raises(ConfigError, match="valid: "):
            compensate_path(vjm, square, tmp_path / "c.csv", **wrong)
    with pytest.raises(DataError, match="frame has shape"):
        compensate_path(vjm, square, tmp_path / "c.csv", workpiece=(1.0, 2.0))


@pytest.mark.slow
def test_an_example_path_is_for_a_urdf_that_is_read_with_held_joints(tmp_path):
    lines = f"""
        base side revolute
        base lift prismatic mimic=to_side multiplier=0.5 limits=0..4
        {arm_lines("lift", "a", 6)}
    """
    tree_urdf(tmp_path / "lift.urdf", lines)
    words = "example --urdf lift.urdf --tip a6 --tcp 0.1,0,0.1 --size 100 --points 9"
    words += " --load 0,0,-40 --output"
    refused = bench_here("path", *words.split(), "e.csv", cwd=tmp_path)
    assert refused.returncode == 2 and "--hold to_side=VALUE" in refused.stderr
    done = bench_here("path", *words.split(), "e.csv", "--hold", "to_side=60", cwd=tmp_path)
    assert done.returncode == 0, done.stderr
    height = 650.0 + 500.0 * np.pi / 3.0  # 650 mm with the lift at zero
    assert pd.read_csv(tmp_path / "e.csv")["z_mm"][0] == pytest.approx(height, abs=1e-3)


@pytest.mark.slow
def test_a_track_is_held_along_a_path_that_lies_before_it(tmp_path, rng):
    urdf, where = tree_urdf(tmp_path / "track.urdf", track_lines()), 3000.0
    robot = sb.read_robot(urdf, tcp=(0.1, 0, 0.1))
    q = rng.uniform(robot.lower, robot.upper, size=(60, 7))
    wrench = rng.normal(size=(60, 6)) * np.repeat([50.0, 5.0], 3)
    deflection = robot.joint_deflection(np.array([1e-6, *[2e-5] * 6]), q, wrench)
    data = sb.Dataset.from_samples(samples_with(q, wrench, deflection), robot)
    sb.make_model("vjm").fit(data).save(tmp_path / "t.stiff")
    words = f"--points 9 --size 100 --urdf {urdf} --tcp 0.1,0,0.1 --load 0,10,-40,0,0,0"
    for command in (
        f"example {words} --hold to_cart={where} --output e.csv",
        f"compensate --model t.stiff --path e.csv --hold to_cart={where} --output c.csv",
    ):
        done = bench_here("path", *command.split(), cwd=tmp_path)
        assert done.returncode == 0, done.stderr
    table = pd.read_csv(tmp_path / "c.csv")
    assert (table["q1_mm"] == where).all() and (table["removed_mm"] > 0.0).all()
    assert (table["x_mm"] > where).all()
