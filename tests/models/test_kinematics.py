"""The batched Jacobian against Pinocchio, finite differences and the robot's own data sheet."""

from __future__ import annotations

import numpy as np
import pinocchio as pin
import pytest

from stiff_datasets.robots.robot import load_robot
from stiff_models.kinematics import CHUNK, jacobian
from stiff_protocols.errors import DataError


def pinocchio_jacobians(model, tcp, q):
    """One Pinocchio call a sample: the independent truth."""
    data = model.createData()
    frame = model.addFrame(
        pin.Frame(
            "truth_tcp", model.njoints - 1, 0, pin.SE3(np.eye(3), tcp), pin.FrameType.OP_FRAME
        )
    )
    data = model.createData()
    out = np.empty((len(q), 6, model.nv))
    for i, position in enumerate(q):
        out[i] = pin.computeFrameJacobian(model, data, position, frame, pin.LOCAL_WORLD_ALIGNED)
    return out


def random_chain_urdf(rng, n_joints):
    lines = ['<robot name="random_chain"><link name="l0"/>']
    for i in range(n_joints):
        kind = "prismatic" if rng.random() < 0.3 else "revolute"
        axis = rng.normal(size=3)
        xyz, rpy = rng.normal(size=3), rng.uniform(-3, 3, size=3)
        text = [" ".join(map(repr, map(float, v))) for v in (xyz, rpy, axis / np.linalg.norm(axis))]
        lines.append(
            f'<joint name="j{i}" type="{kind}"><parent link="l{i}"/><child link="l{i + 1}"/>'
            f'<origin xyz="{text[0]}" rpy="{text[1]}"/><axis xyz="{text[2]}"/>'
            f'<limit lower="-3" upper="3" effort="1" velocity="1"/></joint><link name="l{i + 1}"/>'
        )
    return "".join(lines) + "</robot>"


def assert_relatively_equal(ours, truth):
    assert np.abs(ours - truth).max() <= 1e-12 * np.abs(truth).max()


def test_jacobian_equals_pinocchio_on_1000_random_poses_of_the_kr10(kr10, kr10_chain, rng):
    q = rng.uniform(kr10.lower, kr10.upper, size=(1000, 6))
    truth = pinocchio_jacobians(kr10_chain.model.copy(), kr10_chain.tcp, q)
    assert_relatively_equal(jacobian(kr10, q), truth)


@pytest.mark.parametrize("n_joints", range(3, 9))
def test_jacobian_equals_pinocchio_on_random_chains(n_joints, rng, tmp_path):
    for trial in range(5):
        urdf = tmp_path / f"chain_{trial}.urdf"
        urdf.write_text(random_chain_urdf(rng, n_joints))
        tcp = rng.normal(size=3)
        robot = load_robot(urdf, tcp=tcp)
        q = rng.uniform(-3, 3, size=(50, n_joints))
        truth = pinocchio_jacobians(pin.buildModelFromUrdf(str(urdf)), robot.tcp, q)
        assert_relatively_equal(jacobian(robot, q), truth)


def test_random_chains_contain_both_kinds_of_joint(rng, tmp_path):
    urdf = tmp_path / "chain.urdf"
    urdf.write_text(random_chain_urdf(rng, 30))
    assert set(load_robot(urdf).joint_types) == {"revolute", "prismatic"}


def test_translational_rows_are_the_central_difference_of_the_tcp_position(kr10, kr10_chain, rng):
    model, data = kr10_chain.model, kr10_chain.model.createData()

    def position(q):
        pin.forwardKinematics(model, data, q)
        return data.oMi[6].act(kr10_chain.tcp)

    step = 1e-6
    for q in rng.uniform(kr10.lower, kr10.upper, size=(20, 6)):
        difference = np.stack(
            [(position(q + step * e) - position(q - step * e)) / (2 * step) for e in np.eye(6)],
            axis=1,
        )
        np.testing.assert_allclose(jacobian(kr10, q[None])[0, :3], difference, atol=1e-8)


def test_a_batch_of_several_chunks_equals_its_rows_one_at_a_time(kr10, rng):
    q = rng.uniform(kr10.lower, kr10.upper, size=(CHUNK + 7, 6))
    batch = jacobian(kr10, q)
    for row in (0, CHUNK - 1, CHUNK, CHUNK + 6):
        np.testing.assert_allclose(batch[row], jacobian(kr10, q[row : row + 1])[0], atol=1e-15)


def test_planar_arm_has_the_textbook_jacobian(tmp_path):
    urdf = tmp_path / "planar.urdf"
    urdf.write_text(
        '<robot name="planar"><link name="l0"/><link name="l1"/><link name="l2"/>'
        '<joint name="a" type="continuous"><parent link="l0"/><child link="l1"/>'
        '<axis xyz="0 0 1"/></joint>'
        '<joint name="b" type="continuous"><parent link="l1"/><child link="l2"/>'
        '<origin xyz="2 0 0"/><axis xyz="0 0 1"/></joint></robot>'
    )
    robot = load_robot(urdf, tcp=(1.0, 0.0, 0.0))
    a, b = 0.3, 1.1
    expected = [
        [-2 * np.sin(a) - np.sin(a + b), -np.sin(a + b)],
        [2 * np.cos(a) + np.cos(a + b), np.cos(a + b)],
    ]
    np.testing.assert_allclose(jacobian(robot, np.array([[a, b]]))[0, :2], expected, atol=1e-15)


def test_wrong_number_of_joint_angles_is_refused(kr10):
    with pytest.raises(DataError, match=r"\(2, 5\), expected \(n, 6\)"):
        jacobian(kr10, np.zeros((2, 5)))
