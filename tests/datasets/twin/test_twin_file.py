"""Check reading a twin's TOML file, and the errors of a wrong one."""

from __future__ import annotations

from importlib.resources import files

import numpy as np
import pytest

from helpers.made_robots import track_lines, tree_urdf
from stiff_datasets.twin.robot_twin import RobotTwin
from stiff_datasets.twin.twin import DigitalTwin
from stiff_datasets.twin.twin_file import ARCMIN, read_constants, specimen_law
from stiff_protocols.contract.errors import DataError, StiffBenchWarning

JOINT = """
[[joint]]
gear = "SHG-25"
structure_Nm_per_rad = 1e5
tilting_ratio = 4.0
"""
SLIDE = """
[[joint]]
drive_N_per_m = 2e7
guide_Nm_per_rad = 5e6
"""
BEAMS = "[beams]\nmodulus_Pa = 7e10\npoisson = 0.3\n" + 8 * (
    "[[beams.segment]]\nouter_m = 0.2\nwall_m = 0.01\n"
)
RV_GEAR = "{rigidity_Nm_per_rad = 1e6, rated_Nm = 900}"
OWN_GEAR = "{slopes_Nm_per_rad = [1e6, 2e6, 2e6], breakpoints_Nm = [100, 300], rated_Nm = 900}"
TOP = (
    'name = "t"\nurdf = "ur5"\ntcp_m = [0.0, 0.06, 0.08]\npayload_kg = 5.0\nhook_m = [0, 0.05, 0]\n'
)


def write(tmp_path, text):
    path = tmp_path / "my.toml"
    path.write_text(text)
    return path


def test_constants_are_converted_to_springs_in_si_units(tmp_path):
    joints = 4 * JOINT + JOINT.replace('"SHG-25"', OWN_GEAR) + JOINT.replace('"SHG-25"', RV_GEAR)
    constants = read_constants(write(tmp_path, TOP + joints))
    assert constants.gear_kinds == (*["strain wave"] * 5, "RV")
    law = specimen_law(constants, 0)
    torsion, tilts = law.compliance[:, ::3, 0], law.compliance[:, 1::3, 0]
    structure = 1.0 / 1e5
    for joint, slopes in ((0, (3.1e4, 5e4, 5.7e4)), (4, (1e6, 2e6, 2e6)), (5, (1e6, 1e6, 1e6))):
        np.testing.assert_allclose(torsion[:, joint], 1.0 / np.array(slopes) + structure)
        np.testing.assert_allclose(tilts[:, joint], 1.0 / (4.0 * slopes[1]))
    np.testing.assert_array_equal(law.breakpoints[:, [0, 12], 0].T, [[14, 48], [100, 300]])
    lost_motion = law.lost_motion[::3, 0] / ARCMIN  # of an RV gear only
    assert not lost_motion[:5].any() and 0.1 <= lost_motion[5] <= 0.4


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
            (TOP + JOINT.replace('"SHG-25"', gear), "joint.1.gear.*name of a gear, such as SHG-25")
            for gear in ("25", "25.0", "[1]", "nan")
        ),
        (TOP + JOINT.replace("SHG-25", "SHG-23"), r"joint.1: unknown gear 'SHG-23'.*valid.*SHG-25"),
        (
            TOP + JOINT + "lost_motion_arcmin = 1.0",
            r"joint.1: unknown key 'lost_motion_arcmin' \(valid: gear, structure_Nm_per_rad, tilt",
        ),
        (TOP + JOINT.replace("4.0", "9"), r"joint.1.tilting_ratio: 9: .*1 to 8, nor inf"),
        (TOP + SLIDE + "gear = 25\n", r"joint.1: unknown key 'gear' \(valid: drive_N_per_m, guide"),
        (TOP.replace("5.0", "nan") + JOINT, r"payload_kg: nan: .* finite number"),
        (TOP.replace('"t"', '"a/b"') + JOINT, r"name: 'a/b': .* pattern"),
        (
            TOP + JOINT.replace('"SHG-25"', OWN_GEAR.replace("rated_Nm", "rated")),
            r"joint.1.gear: unknown key 'rated'; did you mean 'rated_Nm'",
        ),
        (
            TOP + JOINT.replace('"SHG-25"', OWN_GEAR.replace("100, 300", "300, 100")),
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
    slide, other_slide = (specimen_law(constants, number).compliance[0, :3] for number in (0, 3))
    np.testing.assert_allclose(slide[:, 0], 1.0 / np.array([2e7, 5e6, 5e6]))
    assert (np.abs(np.log(other_slide / slide)) < 0.7).all() and (other_slide != slide).all()


def test_a_twin_of_a_urdf_with_a_mimic_joint_on_its_chain_is_refused(tmp_path):
    constants = on_a_track(tmp_path, SLIDE + 6 * JOINT, 'tip = "camera"\n')
    tree_urdf(tmp_path / "track.urdf", track_lines() + "\na6 camera revolute mimic=to_a2")
    with pytest.raises(DataError, match=r"track.urdf: to_camera is a mimic joint"):
        constants.chain()


def test_a_drive_alone_gives_force_over_stiffness_along_the_track(tmp_path):
    rigid = "[[joint]]\ngear = {rigidity_Nm_per_rad = 1e10, rated_Nm = 1e9}\n"
    rigid += "structure_Nm_per_rad = inf\ntilting_ratio = inf\n"
    slide = "[[joint]]\ndrive_N_per_m = 1e5\nguide_Nm_per_rad = inf\n"
    twin = DigitalTwin.in_world(on_a_track(tmp_path, slide + 6 * rigid), 0, "clean")
    moved = twin.truth(np.full((1, 7), 0.3), np.array([[60.0, 20.0, -60.0, 3.0, -4.0, 2.0]]))
    np.testing.assert_allclose(moved, [[60.0 / 1e5, 0.0, 0.0]], atol=1e-6)


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


def test_a_world_whose_links_bend_needs_sections(tmp_path):
    path = write(tmp_path, TOP + 6 * JOINT)
    with pytest.raises(DataError, match=r"t: no table \[beams\].*structure and all need"):
        RobotTwin(constants=path, poses=2, world="structure").load()


def test_impossible_tubes_are_named(tmp_path):
    with pytest.raises(DataError, match=r"segment.1.*wall_m 0.2 is more than half"):
        read_constants(write(tmp_path, TOP + 6 * JOINT + BEAMS.replace("0.01", "0.2", 1)))
    with pytest.raises(DataError, match=r"8 tables \[\[beams.segment\]\] for 6 joints \(valid: 7"):
        read_constants(write(tmp_path, TOP + 6 * JOINT + BEAMS)).chain()


def test_a_robot_without_masses_makes_no_twin(tmp_path):
    urdf = (files("stiff_datasets") / "robots" / "ur5.urdf").read_text(encoding="utf-8")
    bare = "".join(part.split("</inertial>")[-1] for part in urdf.split("<inertial>"))
    (tmp_path / "bare.urdf").write_text(bare, encoding="utf-8")
    constants = read_constants(write(tmp_path, TOP.replace('"ur5"', '"bare.urdf"') + 6 * JOINT))
    with pytest.raises(DataError, match=r"my\.toml: no link of bare\.urdf has a mass"):
        constants.chain()
