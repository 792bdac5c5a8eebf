"""Check reading a twin's TOML file, and the errors of a wrong one."""

from __future__ import annotations

from importlib.resources import files

import numpy as np
import pytest

from helpers.made_robots import track_lines, tree_urdf
from stiff_datasets.twin.constants import (
    CATALOGUE,
    read_constants,
    specimen_springs,
)
from stiff_datasets.twin.robot_twin import RobotTwin
from stiff_datasets.twin.spring_law import SlideSprings
from stiff_protocols.contract.errors import DataError, StiffBenchWarning

JOINT = """
[[joint]]
gear = 25
structure_Nm_per_rad = 1e5
tilting_ratio = 4.0
lost_motion_arcmin = 1.0
"""
SLIDE = """
[[joint]]
drive_N_per_m = 2e7
guide_Nm_per_rad = 5e6
"""
BEAMS = "[beams]\nmodulus_Pa = 7e10\npoisson = 0.3\n" + 8 * (
    "[[beams.segment]]\nouter_m = 0.2\nwall_m = 0.01\n"
)
OWN_GEAR = "{slopes_Nm_per_rad = [1e6, 2e6, 2e6], breakpoints_Nm = [100, 300], rated_Nm = 900}"
TOP = (
    'name = "t"\nurdf = "ur5"\ntcp_m = [0.0, 0.06, 0.08]\npayload_kg = 5.0\nhook_m = [0, 0.05, 0]\n'
)


def write(tmp_path, text):
    path = tmp_path / "my.toml"
    path.write_text(text)
    return path


def test_constants_are_converted_to_springs_in_si_units(tmp_path):
    text = TOP + 5 * JOINT + JOINT.replace("25", OWN_GEAR)
    spring, *_, custom_spring = springs = read_constants(write(tmp_path, text)).springs
    assert len(springs) == 6 and custom_spring.gear.slopes_Nm_per_rad == (1e6, 2e6, 2e6)
    assert spring.gear == CATALOGUE[25]
    assert spring.structure == 1e5 and spring.tilting == (4 * 5e4, 4 * 5e4)
    assert spring.lost_motion == pytest.approx(np.deg2rad(1 / 60))


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("name = ", "not TOML"),
        (6 * JOINT, "name: Field required"),
        (
            TOP.replace("payload_kg", "payload") + JOINT,
            "unknown key 'payload'; did you mean 'payload_kg'",
        ),
        *(
            (TOP + JOINT.replace("gear = 25", f"gear = {gear}"), "joint.1.gear.*integer size or a")
            for gear in ('"25"', "25.0", "[1]", "nan")
        ),
        (TOP + JOINT.replace("25", "23"), r"joint.1.*gear size 23 \(valid: 14, 17, 20, 25, 32\)"),
        (TOP + JOINT.replace("4.0", "9"), r"joint.1.tilting_ratio: 9: .*1 to 8, nor inf"),
        (TOP + SLIDE + "gear = 25\n", r"joint.1: unknown key 'gear' \(valid: drive_N_per_m, guide"),
        (TOP.replace("5.0", "nan") + JOINT, r"payload_kg: nan: .* finite number"),
        (TOP.replace('"t"', '"a/b"') + JOINT, r"name: 'a/b': .* pattern"),
        (
            TOP + JOINT.replace("25", OWN_GEAR.replace("rated_Nm", "rated")),
            r"joint.1.gear: unknown key 'rated'; did you mean 'rated_Nm'",
        ),
        (
            TOP + JOINT.replace("25", OWN_GEAR.replace("100, 300", "300, 100")),
            r"joint.1.gear.*breakpoints_Nm 300, 100: the second must be larger",
        ),
    ],
)
def test_what_is_wrong_is_named_with_file_key_and_value(tmp_path, text, message):
    with pytest.raises(DataError, match=rf"my\.toml: {message}"):
        read_constants(write(tmp_path, text))


def test_a_missing_joint_and_a_missing_file_are_named(tmp_path):
    constants = read_constants(write(tmp_path, TOP + 5 * JOINT))
    with pytest.raises(DataError, match=r"my\.toml: 5 tables \[\[joint\]\] for the joints of ur5"):
        constants.chain()
    with pytest.raises(DataError, match=r"absent\.toml: cannot be read"):
        read_constants(tmp_path / "absent.toml")


def test_a_robot_is_simulated_from_its_constants_and_the_urdf_next_to_them(tmp_path):
    urdf = (files("stiff_datasets") / "robots" / "ur5.urdf").read_text()
    (tmp_path / "mine.urdf").write_text(urdf.replace('robot name="ur5"', 'robot name="mine"'))
    path = write(tmp_path, TOP.replace('"ur5"', '"mine.urdf"') + 6 * JOINT)
    data, second_data = (
        RobotTwin(constants=path, poses=20, loads_per_pose=2, seed=3).load() for _ in range(2)
    )
    assert data.robot.name == "mine" and len(data.samples) == 40
    assert second_data.sha256 == data.sha256
    lower, upper = data.robot.lower, data.robot.upper
    assert (data.samples.q >= lower).all() and (data.samples.q <= upper).all()
    assert np.linalg.norm(data.samples.deflection, axis=1).max() < 0.05


def on_a_track(tmp_path, joints, words=""):
    tree_urdf(tmp_path / "track.urdf", track_lines() + "\na6 tool0 fixed\na6 camera fixed")
    top = TOP.replace('"ur5"', '"track.urdf"') + words
    return read_constants(write(tmp_path, top + joints))


def test_a_track_has_a_drive_and_a_guide_and_its_scatter(tmp_path):
    constants = on_a_track(tmp_path, SLIDE + 6 * JOINT, 'tip = "camera"\n')
    assert constants.chain().notes == ()
    slide, *_ = constants.springs
    assert slide == SlideSprings(2e7, (5e6, 5e6))
    specimen_slide, *_ = specimen_springs(constants, 3)
    assert 0.5 < specimen_slide.drive / slide.drive < 2.0 and specimen_slide.drive != slide.drive


def test_a_twin_on_a_track_moves_along_it_and_records_millimetres(tmp_path):
    constants = on_a_track(tmp_path, SLIDE + 6 * JOINT)
    with pytest.warns(StiffBenchWarning, match="'tool0'"):
        data = RobotTwin(constants=constants._path, poses=30).load()
    cart = data.samples.q[:, 0]
    assert cart.min() < 0.5 and cart.max() > 3.5
    np.testing.assert_allclose(1000 * cart, (1000 * cart).round(4), atol=1e-9)


@pytest.mark.parametrize(
    ("joints", "words", "message"),
    [
        (7 * JOINT, "", "7 revolute for 1 prismatic, 6 revolute"),
        (6 * JOINT + SLIDE, "", "6 revolute, 1 prismatic for 1 prismatic, 6 revolute"),
        (SLIDE + 6 * JOINT, 'tip = "tol0"\n', "did you mean 'tool0'"),
        (SLIDE + 6 * JOINT + BEAMS, "", r"\[beams\] with a prismatic joint"),
    ],
)
def test_a_track_without_its_own_table_is_refused(tmp_path, joints, words, message):
    with pytest.raises(DataError, match=rf"my\.toml: .*{message}"):
        on_a_track(tmp_path, joints, words).chain()
