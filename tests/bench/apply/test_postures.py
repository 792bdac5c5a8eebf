"""`bench posture`: the ranking against Pinocchio, the given posture, paths, refusals."""

from __future__ import annotations

import numpy as np
import pandas as pd
import pinocchio as pin
import pytest
from PIL import Image
from scipy.spatial.transform import Rotation
from scipy.stats import spearmanr

import stiffbench as sb
from helpers.command_line import assert_refused, bench_here
from stiff_apply.postures import axial_compliance, rank_postures
from stiff_datasets.measured.drilled_holes import DRILL_AXIS
from stiff_protocols.contract.errors import ConfigError, DataError, NotFittedError

pytestmark = [
    pytest.mark.filterwarnings("ignore:extrapolation"),
    pytest.mark.filterwarnings("ignore:.*beyond the training range"),
]

POINT = (600.0, 50.0, 500.0, 10.0, 120.0, 5.0)
LOAD = (0.0, 0.0, -60.0, 0.0, 0.0, 0.0)
GIVEN = (6.0, -85.0, 110.0, 20.0, 60.0, 10.0)
JOINTS = [f"q{i}_deg" for i in range(1, 7)]
DEFLECTION = ["dx_mm", "dy_mm", "dz_mm"]
HEADER = "x_mm,y_mm,z_mm,a_deg,b_deg,c_deg\n"


@pytest.fixture(scope="module")
def ranked(vjm):
    return rank_postures(vjm, point=POINT, load=LOAD, frame="tool", coverage=0.9)


@pytest.fixture()
def line(tmp_path):
    """Write a path of eleven points along y."""
    rows = [f"600,{y},500,0,150,0" for y in range(-100, 101, 20)]
    path = tmp_path / "line.csv"
    path.write_text(HEADER + "\n".join(rows) + "\n")
    return path


def test_a_deflection_along_the_axis_is_that_of_pinocchios_jacobian(vjm, ranked, kr10_chain):
    """n^T J K^-1 J^T n F for a force F n, with the identified stiffness K."""
    data = kr10_chain.model.createData()
    flange = kr10_chain.robot
    compliance = vjm.fitted.springs_.compliance
    for _, row in ranked.table.iloc[::10].iterrows():
        q = np.radians(row[JOINTS].to_numpy(dtype=float))
        jacobian = pin.computeJointJacobian(kr10_chain.model, data, q, 6)
        pose = data.oMi[6]
        turn = pose.rotation
        spatial = turn @ jacobian[:3]
        angular = turn @ jacobian[3:]
        lever = turn @ flange.tcp
        at_tcp = spatial + np.cross(angular, lever, axis=0)
        axis = turn @ flange.flange[:3, :3] @ [0.0, 0.0, 1.0]
        expected = 60.0 * (axis @ at_tcp) ** 2 @ compliance
        assert row["along_mm"] == pytest.approx(1000.0 * expected, rel=1e-6)


def test_the_given_posture_is_a_candidate_with_its_own_value(vjm, kr10):
    ranked = rank_postures(vjm, given=GIVEN, load=LOAD)
    (row,) = ranked.table[ranked.table["given"]].to_dict("records")
    q = np.radians([GIVEN])
    deflection = vjm.predict(q, np.array([LOAD]))[0]
    axis = kr10.forward(q).rotation[0] @ kr10.flange[:3, 2]
    assert row["turn_deg"] == 0.0
    assert [row[name] for name in JOINTS] == pytest.approx(GIVEN, abs=1e-4)
    assert row["along_mm"] == pytest.approx(1000.0 * abs(deflection @ axis), rel=1e-6)
    across = np.linalg.norm(deflection - deflection @ axis * axis)
    assert row["across_mm"] == pytest.approx(1000.0 * across, rel=1e-6)
    assert ranked.given.size[0] == pytest.approx(abs(deflection @ axis))
    assert ranked.saving == pytest.approx(ranked.given.size[0] - ranked.best.size[0])
    assert np.isnan(ranked.uncertainty) and not ranked.is_within_uncertainty  # without a coverage


def test_ranked_across_the_axis_the_smallest_deflection_across_comes_first(vjm):
    table = rank_postures(vjm, given=GIVEN, load=LOAD, direction="across").table
    assert (np.diff(table["across_mm"]) >= -1e-6).all()
    assert (np.diff(table["along_mm"]) < 0.0).any()


def test_a_load_in_the_tool_frame_turns_with_the_tool(vjm, kr10):
    """A force along x of the tool: at each turn the table has the model's prediction."""
    table = rank_postures(vjm, given=GIVEN, load=(40.0, 0, 0, 0, 0, 0), frame="tool").table
    q = np.radians(table[JOINTS].to_numpy())
    force = 40.0 * (kr10.forward(q).rotation @ kr10.flange[:3, 0])
    expected = vjm.predict(q, np.hstack([force, np.zeros_like(force)]))
    np.testing.assert_allclose(table[DEFLECTION], 1000.0 * expected, atol=1e-6)


def test_a_saving_within_the_models_uncertainty_is_called_so(ranked, vjm):
    interval = vjm.predict_interval(ranked.best.q, ranked.best.wrench, 0.9)
    axis = Rotation.from_euler("ZYX", POINT[3:], degrees=True).as_matrix()[:, 2]
    half = 0.5 * np.linalg.norm((interval.upper - interval.lower)[0] * axis)
    assert ranked.uncertainty == pytest.approx(np.hypot(half, ranked.given.half_width[0]))
    assert ranked.is_within_uncertainty and "the saving is within it" in repr(ranked)
    assert "extrapolates" in repr(ranked)


@pytest.mark.slow
def test_the_best_turn_along_a_path_is_written_as_joint_angles_that_drive_it(vjm, line, tmp_path):
    constant = rank_postures(vjm, path=line, load=LOAD, output=tmp_path / "one.csv")
    assert constant.best.size.mean() <= constant.given.size.mean() + 1e-12
    written = pd.read_csv(tmp_path / "one.csv")
    np.testing.assert_allclose(np.radians(written[JOINTS]), constant.best.q, atol=1e-9)
    corrected = sb.compensate_path(vjm, tmp_path / "one.csv", tmp_path / "commands.csv")
    np.testing.assert_allclose(corrected.compensation.before, constant.best.deflection, atol=1e-9)
    again = rank_postures(vjm, path=tmp_path / "one.csv", turns=4)
    np.testing.assert_allclose(again.given.q, constant.best.q, atol=1e-6)
    assert again.given_words == "yours"


@pytest.mark.slow
@pytest.mark.parametrize("words", [(), ("--path", "line.csv")])
def test_the_command_prints_the_answer_and_writes_table_and_picture(words, vjm_file, line):
    task = words or ("--point", ",".join(map(str, POINT)), "--coverage", "0.9")
    load = ("--load", "0,0,-60,0,0,0", "--output", "p.csv", "--figure", "p.png")
    done = bench_here("posture", "--model", vjm_file, *task, *load, cwd=line.parent)
    assert done.returncode == 0, done.stderr
    assert done.stdout.startswith("best posture: turn ")
    assert max(map(len, done.stdout.splitlines())) <= 100
    rows = len(pd.read_csv(line.parent / "p.csv"))
    assert rows == 11 if words else rows > 100
    with Image.open(line.parent / "p.png") as picture:
        assert picture.width > 1000


OF_GIVEN = ("--given", "0,-90,90,0,60,0")
REFUSED = [
    (("--point", "5000,0,500,0,120,0"), "does not reach it at any of 72 turns"),
    ((), "--point is missing"),
    (("--given", "0,-90,90,0,60,900"), "--given joint A6 at 900 (valid: "),
    ((*OF_GIVEN, "--point", "600,50,500,10,120,5"), "--given has the tool "),
    ((*OF_GIVEN, "--tool-axis", "0,0,0"), "--tool-axis 0,0,0 has no direction"),
    ((*OF_GIVEN, "--tool", "1,2,3,0,0,0"), "--tool x,y,z of 1,2,3"),
]


@pytest.mark.slow
def test_bad_input_is_one_line_and_leaves_no_file(vjm_file, tmp_path):
    command = ("posture", "--model", vjm_file, "--load", "0,0,-60,0,0,0", "--output", "p.csv")
    for words, message in REFUSED:
        assert_refused(bench_here(*command, *words, cwd=tmp_path), message)
        assert not list(tmp_path.iterdir())


def test_a_missing_or_zero_load_and_an_unfitted_model_are_refused(vjm):
    with pytest.raises(ConfigError, match="load is missing"):
        rank_postures(vjm, given=GIVEN)
    with pytest.raises(ConfigError, match="load is zero"):
        rank_postures(vjm, given=GIVEN, load=(0.0,) * 6)
    with pytest.raises(NotFittedError):
        rank_postures(sb.make_model("vjm"), given=GIVEN, load=LOAD)


def test_a_point_that_is_singular_at_every_turn_is_refused(vjm, kr10):
    """Wrist and arm are straight: no other configuration is near."""
    q = np.radians([[0.0, -60.0, 3.3, 0.0, 0.0, 0.0]])
    poses = kr10.forward(q)
    rotation = poses.rotation[0] @ kr10.flange[:3, :3]
    angles = Rotation.from_matrix(rotation).as_euler("ZYX", degrees=True)
    point = (*1000.0 * poses.points[0, -1], *angles)
    with pytest.raises(DataError, match="singular at every turn and branch"):
        rank_postures(vjm, point=point, load=LOAD, turns=1)


def test_the_drilled_holes_rank_between_sites_and_not_within_them(fanuc):
    """An independent estimate gave 0.83 between sites, and 0.2, -0.6, 0.4, 0.4 within."""
    model, holes = sb.make_model("vjm").fit(fanuc), sb.drilled_holes()
    q = np.radians(holes[JOINTS].to_numpy())
    holes["compliance"] = axial_compliance(model, q, DRILL_AXIS, 500.0)
    drilled = holes[holes.site != "V"]
    within = [spearmanr(s.compliance, s.surge_mm_s).statistic for _, s in drilled.groupby("site")]
    assert spearmanr(drilled.compliance, drilled.surge_mm_s).statistic == pytest.approx(
        0.83, abs=0.01
    )
    assert within == pytest.approx([0.2, -0.6, 0.4, 0.4])
