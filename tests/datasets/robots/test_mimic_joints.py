"""Check chains whose mimic joints follow joints that move, such as palletizers' parallelograms."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pinocchio as pin
import pytest

from helpers.made_robots import arm_lines, tree_urdf
from stiff_bench.api.data_sets import read_samples
from stiff_bench.api.model import load_model, make_model
from stiff_bench.api.robots import same_geometry, shipped_name
from stiff_bench.store.database import data_content, stored_data
from stiff_datasets.robots.urdf_reader import read_chain
from stiff_datasets.robots.urdf_writer import robot_urdf
from stiff_protocols.contract.errors import DataError
from stiff_protocols.contract.types import BenchmarkData, Samples
from stiff_protocols.kinematics.serial_chain import joint_torque

PALLETIZER = """
    base turn revolute axis=z z=0.5
    turn upper revolute axis=y x=0.2 z=0.3
    upper elbow revolute axis=y z=0.9 mimic=to_upper multiplier=-1 offset=0.2
    elbow fore revolute axis=y z=0
    fore wrist revolute axis=y x=1.0 z=0 mimic=to_fore multiplier=-1 limits=-1..0.5
    wrist flange revolute axis=z z=-0.2
    flange tool0 fixed z=-0.1
"""
"""Two parallelograms keep the flange level; the tool points down."""
MIXED = """
    base a1 revolute axis=y
    a1 b1 prismatic axis=x mimic=to_b3 multiplier=0.3 offset=0.1 limits=-9..9
    b1 b2 revolute axis=x
    b2 b3 revolute axis=z x=0.3
    b3 b4 revolute axis=y mimic=to_b1 multiplier=-2 offset=0.1
    b4 tool0 fixed x=0.2 z=0.1
"""
"""A slide before the joint that it follows, and a last joint that follows the slide."""
LAW = {
    PALLETIZER: {"to_elbow": ("to_upper", -1.0, 0.2), "to_wrist": ("to_fore", -1.0, 0.0)},
    MIXED: {"to_b1": ("to_b3", 0.3, 0.1), "to_b4": ("to_b3", -0.6, -0.1)},
}
"""Mimic joint -> independent joint, multiplier, offset."""
TCP = (0.05, 0.02, 0.1)


def chain_of(tmp_path, joints, **options):
    path = tree_urdf(tmp_path / "made.urdf", joints)
    mass = '<origin xyz="0.1 0.02 0.05"/><mass value="3"/>'
    path.write_text(path.read_text().replace('<mass value="1"/>', mass))
    return read_chain(path, **options)


@pytest.fixture(params=LAW, ids=["palletizer", "mixed"])
def made(request, tmp_path, rng):
    """Return a robot, positions of its independent joints, and Pinocchio's numbers there.

    Pinocchio has all joints as independent joints; `coupling` makes them follow.
    """
    robot = chain_of(tmp_path, request.param, tcp=TCP).robot
    model = pin.buildModelFromUrdf(str(tmp_path / "made.urdf"))
    tool = model.frames[model.getFrameId("tool0")]
    place = tool.placement * pin.SE3(np.eye(3), np.array(TCP))
    model.addFrame(pin.Frame("tcp", tool.parentJoint, 0, place, pin.FrameType.OP_FRAME))
    coupling, offset = np.zeros((model.nv, robot.n_joints)), np.zeros(model.nv)
    for joint, name in enumerate([*model.names][1:]):
        master, coupling_entry, offset[joint] = LAW[request.param].get(name, (name, 1.0, 0.0))
        coupling[joint, robot.joint_names.index(master)] = coupling_entry
    q = rng.uniform(-1.5, 1.5, size=(20, robot.n_joints))
    return robot, q, model, coupling, q @ coupling.T + offset


def test_tcp_jacobian_and_weights_follow_the_masters_as_in_pinocchio(made):
    robot, q, model, coupling, every_q = made
    data, frame, poses = model.createData(), model.getFrameId("tcp"), robot.forward(q)
    for row, position in enumerate(every_q):
        pin.framesForwardKinematics(model, data, position)
        np.testing.assert_allclose(poses.points[row, -1], data.oMf[frame].translation, atol=1e-12)
        np.testing.assert_allclose(poses.rotation[row], data.oMf[frame].rotation, atol=1e-12)
        for joint, name in enumerate(robot.joint_names):
            place = data.oMi[model.getJointId(name)]
            np.testing.assert_allclose(poses.points[row, joint], place.translation, atol=1e-12)
            np.testing.assert_allclose(poses.rotations[row, joint], place.rotation, atol=1e-12)
        columns = pin.computeFrameJacobian(model, data, position, frame, pin.LOCAL_WORLD_ALIGNED)
        np.testing.assert_allclose(robot.jacobian(q)[row], columns @ coupling, atol=1e-12)
        torque = pin.computeGeneralizedGravity(model, data, position) @ coupling
        np.testing.assert_allclose(robot.gravity_torque(q)[row], -torque, atol=1e-10)


def test_a_palletizer_is_pinocchios_own_model_with_mimic_joints(tmp_path, rng):
    robot = chain_of(tmp_path, PALLETIZER).robot
    model = pin.buildModelFromUrdf(str(tmp_path / "made.urdf"), mimic=True)
    assert (model.nq, model.njoints) == (robot.n_joints, 7)
    data, q = model.createData(), rng.uniform(-1.5, 1.5, size=(5, 4))
    for row, position in enumerate(q):
        frame = model.getFrameId("tool0")
        jacobian = pin.computeFrameJacobian(model, data, position, frame, pin.LOCAL_WORLD_ALIGNED)
        np.testing.assert_allclose(robot.jacobian(q)[row], jacobian, atol=1e-12)
        torque = pin.computeGeneralizedGravity(model, data, position)
        np.testing.assert_allclose(robot.gravity_torque(q)[row], -torque, atol=1e-10)
    upward = robot.forward(q).rotation[:, 2, 2]  # only the elbow's offset tilts the tool
    np.testing.assert_allclose(upward, np.cos(0.2), atol=1e-12)


def test_jacobian_and_weights_are_derivatives_by_the_independent_joints(made):
    robot, q, model, coupling, every_q = made
    steps = 1e-6 * np.eye(robot.n_joints)
    ends = [[robot.tcp_position(q + sign * step) for sign in (-1.0, 1.0)] for step in steps]
    slopes = np.stack([(after - before) / 2e-6 for before, after in ends], axis=2)
    np.testing.assert_allclose(robot.jacobian(q)[:, :3], slopes, atol=1e-8)
    data = model.createData()
    for joint, move in enumerate(1e-5 * coupling.T):
        before, after = (
            pin.computePotentialEnergy(model, data, every_q[0] + sign * move) for sign in (-1, 1)
        )
        torque = robot.gravity_torque(q)[0, joint]
        assert torque == pytest.approx((before - after) / 2e-5, abs=1e-5)


def test_springs_of_a_master_turn_its_mimic_joints_too(made, rng):
    robot, q, *_ = made
    jacobian, virtual = robot.jacobian(q), robot.virtual_jacobian(q)
    weights = robot.virtual_gravity_torque(q)
    own_motion = [2 if turns else 5 for turns in robot.turns]
    joints = np.arange(robot.n_joints)
    np.testing.assert_allclose(virtual[:, :, joints, own_motion], jacobian, atol=1e-15)
    np.testing.assert_allclose(weights[:, joints, own_motion], robot.gravity_torque(q), atol=1e-13)
    wrench, compliance = rng.normal(size=(20, 6)), rng.uniform(size=robot.n_joints)
    torque = joint_torque(jacobian, wrench)
    truth = np.einsum("nij,nj->ni", jacobian[:, :3], compliance * torque)
    np.testing.assert_allclose(robot.joint_deflection(compliance, q, wrench), truth, atol=1e-13)


def test_inverse_kinematics_reach_a_pose_of_the_mimic_chain(made):
    robot, q, *_ = made
    poses = robot.forward(q)
    found_q, reached = robot.inverse(poses.points[:, -1], poses.rotation, q + 0.05)
    assert reached.all()
    np.testing.assert_allclose(found_q, q, atol=1e-6)


@pytest.mark.parametrize("joints", LAW, ids=["palletizer", "mixed"])
def test_limits_of_a_mimic_joint_restrict_its_master(tmp_path, joints):
    robot = chain_of(tmp_path, joints).robot
    limits = dict(zip(robot.joint_names, zip(robot.lower, robot.upper, strict=True), strict=True))
    if joints == MIXED:
        assert limits["to_b3"] == (-2.0, 2.0)  # the limits of the slide and of joint 4 are wider
    else:
        np.testing.assert_allclose(limits["to_upper"], (-1.8, 2.0), atol=1e-12)
        np.testing.assert_allclose(limits["to_fore"], (-0.5, 1.0), atol=1e-12)


@pytest.mark.parametrize("joints", LAW, ids=["palletizer", "mixed"])
def test_files_keep_the_mimic_joints(tmp_path, joints, rng):
    robot = chain_of(tmp_path, joints, tcp=TCP).robot
    path = tmp_path / "written.urdf"
    path.write_text(robot_urdf(robot))
    again = read_chain(path, tcp=robot.tcp_on_flange).robot
    assert same_geometry(again, replace(robot, mimics=again.mimics)) and not shipped_name(robot)
    q = rng.uniform(-1.0, 1.0, size=(4, robot.n_joints))
    np.testing.assert_allclose(again.tcp_position(q), robot.tcp_position(q), atol=1e-12)
    np.testing.assert_allclose(again.gravity_torque(q), robot.gravity_torque(q), atol=1e-10)
    np.testing.assert_allclose([again.lower, again.upper], [robot.lower, robot.upper], atol=1e-12)
    data = BenchmarkData(samples_of(robot, q, rng), robot)
    stored = stored_data(data_content(data)).robot
    assert stored.mimics == robot.mimics
    unlike = replace(robot, mimics=(replace(robot.mimics[0], multiplier=2.0), robot.mimics[1]))
    assert len({data.sha256, BenchmarkData(data.samples, unlike).sha256}) == 2
    assert not same_geometry(robot, unlike)


def samples_of(robot, q, rng):
    names = np.arange(len(q)).astype(str)
    wrench = 100.0 * rng.normal(size=(len(q), 6))
    deflection = robot.joint_deflection(1e-6 * np.arange(1, robot.n_joints + 1), q, wrench)
    return Samples(q, wrench, deflection, pose_id=names, load_id=names, group=names)


def test_a_vjm_of_a_measured_palletizer_predicts_exactly_from_its_independent_joints(tmp_path, rng):
    robot = chain_of(tmp_path, PALLETIZER, tcp=TCP).robot
    q = rng.uniform(robot.lower, robot.upper, size=(40, 4))
    samples = samples_of(robot, q, rng)
    names = [*(f"q{i}_deg" for i in range(1, 5)), "fx_N", "fy_N", "fz_N"]
    names += ["tx_Nm", "ty_Nm", "tz_Nm", "dx_mm", "dy_mm", "dz_mm"]
    table = np.hstack([np.degrees(q), samples.wrench, 1e3 * samples.deflection])
    file = tmp_path / "samples.csv"
    np.savetxt(file, table, delimiter=",", header=",".join(names), comments="", fmt="%.17g")
    dataset = read_samples(file, robot=robot)
    model = make_model("vjm").fit(dataset)
    model.save(tmp_path / "my.stiff")
    compliance = model.fitted.springs_.compliance
    np.testing.assert_allclose(compliance, 1e-6 * np.arange(1, 5), rtol=1e-6)
    new_q, new_wrench = 0.5 * (q[:-1] + q[1:]), 0.1 * samples.wrench[1:]
    truth = robot.joint_deflection(compliance, new_q, new_wrench)
    np.testing.assert_allclose(model.predict(new_q, new_wrench), truth, atol=1e-12)
    assert load_model(tmp_path / "my.stiff").fitted.robot_.mimics == robot.mimics


@pytest.mark.parametrize(
    ("joints", "parts"),
    [
        # the master is on another branch, or no joint; the rule runs in a circle
        ("base side revolute\na3 b revolute mimic=to_side", ["'to_b'", "--hold to_side=VALUE"]),
        ("a3 b revolute mimic=gone", ["'to_b'", "'gone'"]),
        ("a3 b revolute mimic=to_c\nb c revolute mimic=to_b", ["'to_b'", "mimic"]),
        (
            "a3 b revolute mimic=to_a2 multiplier=1e200\nb c revolute mimic=to_b multiplier=1e200",
            ["'to_c'", "finite"],
        ),
        ("a3 b revolute mimic=to_a2 limits=3..4", ["'to_a2'", "'to_b'", "limits"]),
        ("a3 b planar mimic=to_a2", ["'to_b'", "3 degrees"]),
    ],
)
def test_a_mimic_joint_that_cannot_follow_is_refused_by_name(tmp_path, joints, parts):
    lines = f"{arm_lines('base', 'a', 3)}\n{joints}"
    with pytest.raises(DataError) as caught_error:
        chain_of(tmp_path, lines, tip="c" if "b c" in lines else "b")
    for part in parts:
        assert part in str(caught_error.value)


def test_numbers_of_held_joints_count_the_independent_joints(tmp_path):
    chain = chain_of(tmp_path, PALLETIZER, hold={"J3": 10.0})
    assert chain.robot.joint_names == ("to_turn", "to_upper", "to_flange")
    assert chain.robot.held == ("to_fore=10 deg", "to_wrist=-10 deg")
    assert [mimic.name for mimic in chain.robot.mimics] == ["to_elbow"]
