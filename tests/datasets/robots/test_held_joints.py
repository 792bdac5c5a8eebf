"""Check joints of a URDF that stand still, mimic joints that follow them, and another base link."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pinocchio as pin
import pytest

from helpers.made_robots import arm_lines, tree_urdf
from stiff_datasets.planning.reachable import keeps_clear
from stiff_datasets.robots.urdf_reader import read_chain
from stiff_protocols.contract.errors import ConfigError, DataError
from stiff_protocols.contract.types import BenchmarkData, Samples

TRACK = f"base cart prismatic axis=y z=0.3 limits=0..4\n{arm_lines('cart', 'a', 6)}"
GRIPPER = """
    a6 palm fixed x=0.1
    palm grip prismatic axis=x z=0.1
    palm jaw2 prismatic axis=y mimic=to_grip
    grip pad revolute axis=y mimic=to_grip
    pad tool0 fixed z=0.05
"""
TORSO = f"base lift prismatic z=0.5\nlift torso revolute axis=y\n{arm_lines('torso', 'a', 6)}"


def chain_of(tmp_path, joints, **options):
    return read_chain(tree_urdf(tmp_path / "made.urdf", joints), **options)


def points(model, positions, names):
    """Return poses of links and the joints' torques against the weights, by Pinocchio."""
    q, data = pin.neutral(model), model.createData()
    for name, value in positions.items():
        q[model.joints[model.getJointId(name)].idx_q] = value
    pin.framesForwardKinematics(model, data, q)
    places = [data.oMf[model.getFrameId(name, pin.FrameType.BODY)] for name in names]
    torque = pin.computeGeneralizedGravity(model, data, q)
    return places, torque


@pytest.mark.parametrize(
    ("hold", "positions"),
    [
        ({"to_cart": 1500.0}, {"to_cart": 1.5}),
        ({"J1": 1500.0}, {"to_cart": 1.5}),
        ({"to_cart": 1500.0, "4": 30.0}, {"to_cart": 1.5, "to_a3": np.pi / 6}),
        ({"to_a6": -20.0}, {"to_a6": -np.pi / 9}),
    ],
)
def test_held_joints_are_part_of_the_links_as_in_pinocchio(tmp_path, rng, hold, positions):
    chain = chain_of(tmp_path, TRACK, hold=hold, tcp=(0.06, 0.0, 0.08))
    robot, model = chain.robot, pin.buildModelFromUrdf(str(tmp_path / "made.urdf"))
    assert not {*robot.joint_names} & {*positions}
    assert robot.n_joints == 7 - len(positions)
    q = rng.uniform(-1.0, 1.0, size=robot.n_joints)
    moved = dict(zip(robot.joint_names, q, strict=True))
    (tip,), torque = points(model, moved | positions, ["a6"])
    expected = tip.act(np.array([0.06, 0.0, 0.08]))
    np.testing.assert_allclose(robot.tcp_position(q[None])[0], expected, atol=1e-12)
    entries = [model.joints[model.getJointId(name)].idx_v for name in robot.joint_names]
    np.testing.assert_allclose(robot.gravity_torque(q[None])[0], -torque[entries], atol=1e-9)
    assert np.allclose(chain.model.gravity.linear, robot.gravity)


def test_the_position_of_a_held_joint_is_in_the_robot_and_the_hash(tmp_path, rng):
    chains = [chain_of(tmp_path, TRACK, hold={"to_cart": x}) for x in (500.0, 500.0, 501.0)]
    assert chains[0].robot.held == ("to_cart=500 mm",)
    assert "to_cart=500 mm" in repr(chains[0].robot)
    name = np.ones(1).astype(str)
    samples = Samples(
        q=rng.normal(size=(1, 6)),
        wrench=np.ones((1, 6)),
        deflection=np.ones((1, 3)),
        pose_id=name,
        load_id=name,
        group=name,
    )
    first_hash, same_hash, next_hash = (
        BenchmarkData(samples, chain.robot).sha256 for chain in chains
    )
    assert first_hash == same_hash != next_hash
    unnamed = replace(chains[0].robot, held=())  # the hash is of numbers that models see
    assert BenchmarkData(samples, unnamed).sha256 == first_hash


def test_a_mimic_joint_follows_a_held_joint_on_and_off_the_chain(tmp_path):
    path = tree_urdf(tmp_path / "made.urdf", arm_lines("base", "a", 6) + GRIPPER)
    mimic = '<mimic joint="to_grip"/>'
    numbers = '<mimic joint="to_grip" multiplier="-10" offset="0.25"/>'
    path.write_text(path.read_text().replace(mimic, numbers, 2))
    chain = read_chain(path, tip="tool0", hold={"to_grip": 30.0})
    assert chain.robot.n_joints == 6
    assert {*chain.robot.held} >= {"to_grip=30 mm", "to_jaw2=-50 mm"}
    model = pin.buildModelFromUrdf(str(path))
    positions = {"to_grip": 0.03, "to_pad": -0.05, "to_jaw2": -0.05}
    (tip,), torque = points(model, positions, ["tool0"])
    q = np.zeros((1, 6))
    np.testing.assert_allclose(chain.robot.tcp_position(q)[0], tip.translation, atol=1e-12)
    entries = [model.joints[model.getJointId(name)].idx_v for name in chain.robot.joint_names]
    np.testing.assert_allclose(chain.robot.gravity_torque(q)[0], -torque[entries], atol=1e-9)


def test_an_arm_on_a_held_rail_stands_where_the_rail_holds_it(tmp_path):
    chain = chain_of(tmp_path, TRACK, hold={"to_cart": 1500.0})
    np.testing.assert_allclose(chain.robot.stand, [0.0, 1.5, 0.3], atol=1e-12)
    moving = chain_of(tmp_path, TRACK).robot
    q = np.array([[1.5, *np.full(6, 0.3)]])
    place, held_place = moving.arm_base(moving.forward(q).points), chain.robot.arm_base(q)
    np.testing.assert_allclose(held_place, place, atol=1e-12)
    clear = keeps_clear(chain.robot, q[:, 1:], 0.3), keeps_clear(moving, q, 0.3)
    assert clear[0] == clear[1]
    assert not chain_of(tmp_path, TRACK, hold={"to_a1": 0.0}).robot.stand.any()


@pytest.mark.parametrize("base", ["cart", "a1", "mark"])
def test_the_chain_starts_at_a_given_base_link(tmp_path, rng, base):
    chain = chain_of(tmp_path, f"{TRACK}\ncart mark fixed x=0.4", base=base)
    robot, model = chain.robot, pin.buildModelFromUrdf(str(tmp_path / "made.urdf"))
    q = rng.uniform(-1.0, 1.0, size=robot.n_joints)
    moved = dict(zip(robot.joint_names, q, strict=True))
    (start, tip), _ = points(model, moved, [base, "a6"])
    expected = start.actInv(tip.translation)
    np.testing.assert_allclose(robot.tcp_position(q[None])[0], expected, atol=1e-12)
    assert chain.notes == () or "locked" not in chain.notes[-1]
    assert robot.gravity[2] == -9.81


def test_the_weight_points_down_in_a_base_that_a_held_joint_tilts(tmp_path):
    chain = chain_of(tmp_path, TORSO, base="torso", hold={"to_torso": 30.0})
    assert chain.robot.joint_names[0] == "to_a1"
    expected = 9.81 * np.array([np.sin(np.pi / 6), 0.0, -np.cos(np.pi / 6)])
    np.testing.assert_allclose(chain.robot.gravity, expected, atol=1e-12)


@pytest.mark.parametrize(
    ("count", "options", "kept_joints"),
    [
        (7, {}, [0, 1, 2, 3, 4, 5, 6]),
        (7, {"hold": {"to_cart": 5.0}}, [1, 2, 3, 4, 5, 6]),
        (7, {"base": "cart"}, [1, 2, 3, 4, 5, 6]),
        (7, {"hold": {"to_a2": 5.0, "to_a6": 5.0}}, [0, 1, 3, 4, 5]),
        (6, {"hold": {"to_cart": 5.0}}, [0, 1, 2, 3, 4, 5]),
    ],
)
def test_the_controllers_list_of_the_whole_chain_leaves_out_held_joints(
    tmp_path, count, options, kept_joints
):
    signs, zeros = np.where(np.arange(count) % 2, -1.0, 1.0), np.arange(count) + 1.0
    path = with_controller(tree_urdf(tmp_path / "made.urdf", TRACK), signs, zeros)
    controller = read_chain(path, **options).robot.controller
    np.testing.assert_array_equal(controller.signs, signs[kept_joints])
    np.testing.assert_allclose(controller.zeros, np.radians(zeros[kept_joints]))


@pytest.mark.parametrize(
    ("count", "hold", "from_ground", "parts"),
    [
        (5, {"to_cart": 5.0}, False, ["controller has 5", "6"]),
        (7, {"to_cart": 5.0}, True, ["controller", "joint 3", "ground"]),
        (7, {"to_a2": 5.0}, True, ["controller", "joint 3", "ground"]),
    ],
)
def test_a_controllers_list_that_fits_no_chain_is_refused(
    tmp_path, count, hold, from_ground, parts
):
    path = tree_urdf(tmp_path / "made.urdf", TRACK)
    with_controller(path, np.ones(count), np.zeros(count), from_ground=from_ground)
    with pytest.raises(DataError) as caught_error:
        read_chain(path, hold=hold)
    for part in ("made.urdf", *parts):
        assert part in str(caught_error.value)


def with_controller(path, signs, zeros, *, from_ground=False):
    """Add a <controller> to a URDF."""
    words = [" ".join(f"{number:g}" for number in numbers) for numbers in (signs, zeros)]
    ground = str(from_ground).lower()
    element = f'<controller signs="{words[0]}" zeros_deg="{words[1]}" j3_from_ground="{ground}"/>'
    path.write_text(path.read_text().replace("</robot>", f"{element}</robot>"))
    return path


@pytest.mark.parametrize(
    ("options", "error", "parts"),
    [
        ({"hold": {"rail": 1.0}}, ConfigError, ["hold", "made.urdf", "'rail'", "to_cart"]),
        ({"hold": {"8": 1.0}}, ConfigError, ["hold", "'8'", "to_cart"]),
        ({"hold": {"to_cart": None}}, ConfigError, ["hold", "to_cart", "missing", "mm"]),
        ({"hold": {"to_cart": 4001.0}}, ConfigError, ["hold", "to_cart=4001", "0..4000 mm"]),
        ({"hold": {"to_cart": np.nan}}, ConfigError, ["hold", "to_cart=nan", "0..4000 mm"]),
        ({"hold": {"to_a1": 120.0}}, ConfigError, ["hold", "to_a1=120", "114.592 deg"]),
        ({"hold": {"to_cart": 1.0, "1": 1.0}}, ConfigError, ["hold", "to_cart", "twice"]),
        ({"hold": {"to_pad": 1.0}}, ConfigError, ["hold", "to_pad", "follows to_grip"]),
        ({"hold": {"to_puck": 1.0}}, ConfigError, ["hold", "to_puck", "3 degrees"]),
        ({"hold": {str(i): 1.0 for i in range(1, 8)}, "tip": "a6"}, DataError, ["no moving"]),
        ({"base": "chart"}, ConfigError, ["base", "'chart'", "did you mean 'cart'"]),
        ({"base": "puck"}, ConfigError, ["base", "puck", "'a6'"]),
        ({"base": "a3"}, ConfigError, ["base", "a3", "gravity", "to_a2"]),
        ({"base": "a6"}, DataError, ["base", "a6", "no moving"]),
        ({"base": "cart", "hold": {"to_cart": 5.0}}, ConfigError, ["hold", "to_cart", "leave"]),
    ],
)
def test_what_cannot_be_held_or_a_base_is_refused_by_name(tmp_path, options, error, parts):
    with pytest.raises(error) as caught_error:
        chain_of(tmp_path, f"{TRACK}\nbase puck planar{GRIPPER}", **({"tip": "a6"} | options))
    for part in parts:
        assert part in str(caught_error.value)
