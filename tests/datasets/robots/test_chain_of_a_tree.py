"""Check the serial chain of tree-like descriptions: grippers, hands, two arms, wheels."""

from __future__ import annotations

import numpy as np
import pinocchio as pin
import pytest

from helpers.made_robots import arm_lines, gripper_lines, tree_urdf
from stiff_datasets.robots.urdf_reader import read_chain
from stiff_protocols.contract.errors import ConfigError, DataError

ARM = arm_lines("base", "a", 6)
TORSO = "base torso prismatic z=0.5 limits=0..0.35"
WHEELS = "\nbase wheel_l continuous axis=y\nbase wheel_r continuous axis=y"
HAND = "a7 palm fixed\n" + "\n".join(
    f"{link} {name}{i} revolute axis=y z=0.03"
    for name in ("ring", "index")
    for i, link in enumerate(["palm", f"{name}0", f"{name}1"])
)
MOBILE = (
    f"{TORSO}\n{arm_lines('torso', 'a', 7)}\n{HAND}\ntorso head1 revolute\nhead1 head2 revolute"
)


def chain_of(tmp_path, joints, **options):
    return read_chain(tree_urdf(tmp_path / "made.urdf", joints), **options)


def names(chain):
    return chain.robot.joint_names


def arm_names(n):
    return tuple(f"to_a{i + 1}" for i in range(n))


@pytest.mark.parametrize(
    ("joints", "expected", "tip"),
    [
        (ARM + gripper_lines("a6"), arm_names(6), "hand_tcp"),
        (ARM + "\na6 ee_link fixed\na6 tool0 fixed", arm_names(6), "tool0"),
        (ARM + "\na6 camera fixed\na6 hand fixed\nhand deeper fixed", arm_names(6), "deeper"),
        (ARM + "\na6 tip1 fixed\na6 tip2 fixed", arm_names(6), "tip2"),
        (ARM + "\na6 my_finger prismatic", arm_names(6), "a6"),
        (MOBILE + WHEELS, ("to_torso", *arm_names(7)), "palm"),
        (f"{arm_lines('base', 'b', 5)}\n{ARM}", arm_names(6), "a6"),
        (ARM + "\nbase part floating", arm_names(6), "a6"),
        (ARM + "\nbase puck planar", arm_names(6), "a6"),
    ],
    ids=["gripper", "ur", "deepest", "last", "one finger", "mobile", "two arms", "float", "planar"],
)
def test_the_longest_chain_without_fingers_is_taken_and_the_rest_is_noted(
    tmp_path, joints, expected, tip
):
    chain = chain_of(tmp_path, joints)
    assert names(chain) == expected
    choice = chain.notes[0]
    assert f"'{tip}'" in choice and "--tip LINK" in choice
    assert all("made.urdf" in note for note in chain.notes)


CAMERA = "\na6 camera fixed x=0.2\ncamera lens fixed x=0.3\nlens lens_frame fixed"


@pytest.mark.parametrize(
    ("joints", "tip"),
    [
        ("\na6 link_7 fixed z=0.107\na6 link_6_sc fixed", "link_7"),
        ("\na6 link_6_sc fixed z=0.3\na6 link_7 fixed z=0.107", "link_7"),
        ("\na6 helper fixed\nhelper deeper fixed\na6 link_7 fixed z=0.107", "link_7"),
        ("\na6 link_7 fixed x=0.107\nlink_7 link_7_inertia fixed z=0.4", "link_7"),
        ("\na6 link_7 fixed x=0.107\nlink_7 Collision_7 fixed z=0.4", "link_7"),
        (f"\na6 link_7 fixed z=0.107{CAMERA}", "link_7"),
        ("\na6 a6_visual fixed\na6_visual mark fixed", "a6"),
        ("\na6 sensor fixed\nsensor a7 revolute", "a7"),
    ],
)
def test_the_tip_is_the_end_farthest_out_and_never_a_helper_link(tmp_path, joints, tip):
    chain = chain_of(tmp_path, ARM + joints)
    model = pin.buildModelFromUrdf(str(tmp_path / "made.urdf"))
    place = model.frames[model.getFrameId(tip, pin.FrameType.BODY)].placement
    np.testing.assert_allclose(chain.robot.tcp, place.translation, atol=1e-12)
    if tip != "a7":  # the only end with seven joints
        assert f"'{tip}'" in chain.notes[0] and "--tip LINK" in chain.notes[0]


def test_a_joint_that_slides_a_gripper_is_locked_and_a_short_last_slide_is_noted(tmp_path):
    slide = "\na6 flange fixed z=0.1\nflange {} prismatic axis=y"
    chain = chain_of(tmp_path, ARM + slide.format("gripper"))
    assert names(chain) == arm_names(6)
    assert "'flange'" in chain.notes[0] and "to_gripper" in chain.notes[1]
    chain = chain_of(tmp_path, ARM + slide.format("quill"))
    assert names(chain)[-1] == "to_quill"
    assert any("'to_quill'" in note and "--tip flange" in note for note in chain.notes)
    assert chain_of(tmp_path, ARM + slide.format("quill") + " limits=0..0.3").notes == ()


def test_mimic_joints_off_the_chain_are_named_with_the_joint_that_they_follow(tmp_path):
    notes = chain_of(tmp_path, f"{ARM}\na1 rod revolute mimic=to_a2").notes
    assert any("to_rod (mimics to_a2)" in note for note in notes)


@pytest.mark.parametrize(
    ("link", "name"), [("a6", "side"), ("a3", "a2"), ("base", "a1"), ("universe", "a1")]
)
def test_a_link_with_a_joints_name_is_read_as_pinocchio_reads_it(tmp_path, rng, link, name):
    path = tree_urdf(tmp_path / "made.urdf", f"{ARM}\na2 side revolute axis=y x=0.1")
    text = path.read_text().replace(f'"to_{name}"', f'"{link}"')
    if link == "universe":
        text = path.read_text().replace('"base"', '"universe"')
    path.write_text(text)
    robot, model = read_chain(path).robot, pin.buildModelFromUrdf(str(path))
    q = rng.uniform(-1.0, 1.0, size=6)
    positions = pin.neutral(model)
    for joint_name, value in zip(robot.joint_names, q, strict=True):
        positions[model.joints[model.getJointId(joint_name)].idx_q] = value
    data = model.createData()
    pin.framesForwardKinematics(model, data, positions)
    tip = data.oMf[model.getFrameId("a6", pin.FrameType.BODY)].translation
    np.testing.assert_allclose(robot.tcp_position(q[None])[0], tip, atol=1e-12)
    assert robot.masses.sum() == pytest.approx(7.0)


def test_a_given_tip_is_taken_without_a_note_about_the_choice(tmp_path):
    (note,) = chain_of(tmp_path, MOBILE, tip="head2").notes
    assert "locked at zero" in note and "to_a1" in note and "more" in note
    assert names(chain_of(tmp_path, MOBILE, tip="index2"))[-3:] == (
        *("to_index0", "to_index1", "to_index2"),
    )
    assert chain_of(tmp_path, ARM + "\na6 x fixed\na6 y fixed", tip="x").notes == ()


def test_what_hangs_off_the_chain_is_part_of_its_links_as_in_pinocchio(tmp_path, rng):
    chain = chain_of(tmp_path, MOBILE + WHEELS)
    robot = chain.robot
    np.testing.assert_allclose(robot.masses, [3, 1, 1, 1, 1, 1, 1, 8])  # two in the head, seven
    model = pin.buildModelFromUrdf(str(tmp_path / "made.urdf"))
    q = rng.uniform(0.0, 0.3, size=robot.n_joints)
    positions = pin.neutral(model)
    for name, value in zip(robot.joint_names, q, strict=True):
        positions[model.joints[model.getJointId(name)].idx_q] = value
    data = model.createData()
    gravity = pin.computeGeneralizedGravity(model, data, positions)
    rows = [model.joints[model.getJointId(name)].idx_v for name in robot.joint_names]
    np.testing.assert_allclose(-robot.gravity_torque(q[None])[0], gravity[rows], atol=1e-12)
    pin.framesForwardKinematics(model, data, positions)
    palm = data.oMf[model.getFrameId("palm")].translation
    np.testing.assert_allclose(robot.tcp_position(q[None])[0], palm, atol=1e-12)


@pytest.mark.parametrize(
    ("joints", "tip", "error", "parts"),
    [
        (MOBILE, "head3", ConfigError, ["link 'head3'", "did you mean 'head2'", "palm"]),
        (MOBILE, "base", DataError, ["no moving joint", "'base'"]),
        (ARM + gripper_lines("a6"), "right", DataError, ["'to_right'", "mimic", "'to_left'"]),
        (f"base b floating\n{arm_lines('b', 'a', 3)}", None, DataError, ["to_b", "6 degrees"]),
        (f"base b planar\n{arm_lines('b', 'a', 3)}", None, DataError, ["to_b", "3 degrees"]),
        ("base a1 revolute\na1 a2 revolute\na1 a2 revolute", None, DataError, ["'a2'"]),
    ],
)
def test_a_chain_that_cannot_be_one_is_refused_by_name(tmp_path, joints, tip, error, parts):
    with pytest.raises(error) as caught_error:
        chain_of(tmp_path, joints, tip=tip)
    for part in parts:
        assert part in str(caught_error.value)


def test_limits_that_an_exporter_left_at_zero_are_none(tmp_path):
    pendulum = "base one revolute axis=y limits=0..0\none two revolute axis=y limits=0..0"
    chain = chain_of(tmp_path, pendulum)
    assert np.isinf(chain.robot.lower).all() and np.isinf(chain.robot.upper).all()
    assert "to_one, to_two" in chain.notes[0]
