"""`bench map`: the answer in the first line, its table and picture, and refusals."""

from __future__ import annotations

import re

import numpy as np
import pandas as pd
import pytest
from PIL import Image

import stiffbench as sb
from helpers.command_line import assert_refused, bench_here
from stiff_protocols.contract.errors import ConfigError, DataError, NotFittedError, StoreError

pytestmark = pytest.mark.filterwarnings("ignore:extrapolation")

LOAD = (0.0, 0.0, -60.0)
BOX = (300.0, 1100.0, 0.0, 0.0, 0.0, 800.0)
SMALL = {"load": LOAD, "box": BOX, "grid": 9}
ANSWER = re.compile(
    r"stiffest (\S+) mm at \((.+?)\) mm, softest (\S+) mm at \((.+?)\) mm; (\d+) of (\d+) points "
    r"reachable, (\d+) of these far from the training poses"
)


@pytest.fixture(scope="module")
def small(vjm):
    with pytest.warns(match="extrapolation"):
        return sb.stiffness_map(vjm, **SMALL)


@pytest.mark.slow
def test_the_first_line_is_the_answer_and_table_and_picture_agree_with_it(vjm_file, tmp_path):
    words = ("--model", vjm_file, "--load", "0,0,-60", "--box", "300,1100,0,0,0,800")
    files = ("--grid", "9", "--output", "map.csv", "--figure", "map.png")
    done = bench_here("map", *words, *files, cwd=tmp_path)
    assert done.returncode == 0, done.stderr
    low, low_at, high, high_at, reached, n_points, far = ANSWER.match(done.stdout).groups()
    table = pd.read_csv(
        tmp_path / "map.csv", keep_default_na=False, na_values={"deflection_mm": ""}
    )
    values = table["deflection_mm"]
    assert len(table) == int(n_points) == 81
    assert values.notna().sum() == (table["blank"] == "").sum() == int(reached)
    assert table["extrapolates"].str.contains("joints|pose-gap").sum() == int(far)
    for value, at, row in (
        (low, low_at, table.loc[values.idxmin()]),
        (high, high_at, table.loc[values.idxmax()]),
    ):
        assert float(value) == pytest.approx(row["deflection_mm"], rel=5e-3)
        assert [float(number) for number in at.split(",")] == [row.x_mm, row.y_mm, row.z_mm]
    assert "extrapolation in" in done.stderr
    with Image.open(tmp_path / "map.png") as picture:
        assert picture.width > 900


@pytest.mark.slow
def test_the_output_may_be_the_picture(vjm_file, tmp_path):
    words = ("--model", vjm_file, "--quantity", "compliance", "--grid", "8", "--plane", "xy")
    done = bench_here("map", *words, "--output", "only.svg", cwd=tmp_path)
    assert done.returncode == 0, done.stderr
    assert "mm/kN" in done.stdout.splitlines()[0]
    assert (tmp_path / "only.svg").stat().st_size > 5000


def test_the_map_is_the_models_prediction_at_its_joint_positions(vjm, small):
    q = small.q[small.is_reached]
    predicted = vjm.fitted.predict(q, np.tile([*LOAD, 0, 0, 0], (len(q), 1)))
    np.testing.assert_allclose(small.deflections[small.is_reached], predicted, atol=1e-15)
    lengths = np.linalg.norm(predicted, axis=1)
    np.testing.assert_allclose(small.values[small.is_reached], lengths)
    tcp = small.robot.tcp_position(q)
    np.testing.assert_allclose(tcp, small.positions[small.is_reached], atol=1e-7)


def test_a_model_with_another_fitted_point_predicts_the_tcp(twin):
    model = sb.make_model("vjm", tcp="fit").fit(twin)
    new_map = sb.stiffness_map(model, **SMALL)
    q = new_map.q[new_map.is_reached]
    predicted = model.fitted.predict_at_tcp(q, np.tile([*LOAD, 0, 0, 0], (len(q), 1)))
    np.testing.assert_allclose(new_map.deflections[new_map.is_reached], predicted, atol=1e-15)


@pytest.mark.slow
def test_the_map_of_compliance_is_that_of_vjms_stiffness_matrix_and_needs_vjm(vjm, twin):
    options = {"quantity": "compliance", "box": BOX, "grid": 6}
    of_vjm = sb.stiffness_map(vjm, **options)
    knn = sb.make_model("knn").fit(twin)
    with pytest.raises(ConfigError, match="quantity compliance requires the model vjm, not knn"):
        sb.stiffness_map(knn, **options)
    with pytest.raises(ConfigError, match="valid: vjm"):
        _ = sb.stiffness_map(knn, **SMALL).cartesian_stiffness
    stiffness = of_vjm.cartesian_stiffness[of_vjm.is_reached]
    inverse = np.linalg.inv(stiffness)[:, :3, :3]
    np.testing.assert_allclose(inverse, of_vjm.compliance[of_vjm.is_reached], rtol=1e-6, atol=1e-12)


@pytest.mark.slow
def test_a_component_is_that_of_the_deflection(vjm, small):
    along_z = sb.stiffness_map(vjm, axis="z", **SMALL)
    np.testing.assert_array_equal(along_z.values, small.deflections[..., 2])
    down = sb.stiffness_map(vjm, axis="tool", **SMALL)
    np.testing.assert_allclose(down.values, -along_z.values, atol=1e-18)
    assert "deflection_z_mm" in along_z.frame()


def test_the_tool_and_a_load_in_its_frame_have_their_orientation_at_every_point(vjm, small):
    load, orientation = (10.0, 0.0, 5.0, 0.0, 2.0, 0.0), (180.0, 0.0, 180.0)
    turned = sb.stiffness_map(
        vjm, **SMALL | {"load": load, "frame": "tool", "orientation": orientation}
    )
    q = turned.q[turned.is_reached]
    rotations = turned.robot.forward(q).rotation @ turned.robot.flange[:3, :3]
    np.testing.assert_allclose(
        rotations, np.tile(np.diag([-1.0, 1.0, -1.0]), (len(q), 1, 1)), atol=1e-7
    )
    in_base = np.tile([-10.0, 0.0, -5.0, 0.0, 2.0, 0.0], (len(q), 1))
    predicted = vjm.fitted.predict(q, in_base)
    np.testing.assert_allclose(turned.deflections[turned.is_reached], predicted, atol=1e-12)


def test_the_plane_is_in_the_middle_of_a_box_or_at_the_chosen_place(vjm):
    box = (400.0, 900.0, -200.0, 200.0, 200.0, 600.0)
    new_map = sb.stiffness_map(vjm, load=LOAD, box=box, grid=6, plane="xy")
    assert new_map.positions[0, 0, 2] == pytest.approx(0.4)
    chosen = sb.stiffness_map(vjm, load=LOAD, box=box, grid=6, plane="xy", at=250.0)
    assert chosen.positions[0, 0, 2] == 0.25


@pytest.mark.slow
def test_far_points_are_those_of_the_rule_and_the_load_does_not_count(vjm, small):
    heavy = sb.stiffness_map(vjm, **SMALL | {"load": (0.0, 0.0, -900.0)})
    np.testing.assert_array_equal(heavy.is_far, small.is_far)
    q = small.q[small.is_reached]
    words = vjm.training_range.extrapolates(q, np.tile([*LOAD, 0, 0, 0], (len(q), 1)))
    assert small.extrapolates[small.is_reached].tolist() == words


REFUSED = {
    "": ["--load is missing", "fx,fy,fz in N", "compliance"],
    "--load 0,0": ["--load", "0,0", "three or six", "fx,fy,fz"],
    "--load 0,0,0": ["--load is zero"],
    "--load 0,0,-9 --orientation 1,2": ["--orientation", "down"],
    "--load 0,0,-9 --box 1,2,3": ["--box", "x0,x1,y0,y1,z0,z1"],
    "--load 0,0,-9 --box 9,2,0,0,0,9": ["--box", "each end at least"],
    "--load 0,0,-9 --box 5,5,0,9,7,7": ["--box", "no extent", "xz"],
    "--load 0,0,-9 --at 5e5": ["--at", "100000"],
    "--load 0,0,-9 --hold A3=3": ["--hold", "no joint to hold"],
    "--load 0,0,-9 --tool 1,2,3,0,0,0": ["--tool", "not the TCP"],
    "--load 0,0,-9 --output map.txt": ["--output", "map.txt", ".csv"],
    "--load 0,0,-9 --figure map.csv": ["map.csv", ".png"],
}


@pytest.mark.slow
def test_bad_input_is_refused_in_one_line_with_the_valid_values(vjm_file, tmp_path):
    for words, parts in REFUSED.items():
        done = bench_here("map", "--model", vjm_file, *words.split(), cwd=tmp_path)
        assert_refused(done, *parts)
    assert not [*tmp_path.iterdir()]


def test_invalid_words_and_existing_files_are_refused_in_python(vjm, tmp_path):
    for name in ("quantity", "axis", "plane", "frame"):
        with pytest.raises(ConfigError, match=f"unknown {name} 'odd'"):
            sb.stiffness_map(vjm, **SMALL | {name: "odd"})
    with pytest.raises(ConfigError, match="nan"):
        sb.stiffness_map(vjm, **SMALL | {"load": (np.nan, 0.0, 0.0)})
    with pytest.raises(DataError, match=r"reaches no point .*: 81 out of reach"):
        sb.stiffness_map(vjm, **SMALL | {"box": (5000.0, 6000.0, 0.0, 0.0, 0.0, 1000.0)})
    with pytest.raises(NotFittedError):
        sb.stiffness_map(sb.make_model("vjm"), **SMALL)
    (tmp_path / "map.csv").write_text("mine")
    with pytest.raises(StoreError, match="exists"):
        sb.stiffness_map(vjm, **SMALL, output=tmp_path / "map.csv")
    with pytest.raises(ConfigError, match="is also the output"):
        sb.stiffness_map(vjm, **SMALL, output=tmp_path / "m.png", figure=tmp_path / "m.png")
