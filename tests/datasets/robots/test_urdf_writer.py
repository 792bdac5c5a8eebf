"""Check that robots written as URDF read back unchanged."""

from __future__ import annotations

from dataclasses import replace
from xml.etree import ElementTree

import numpy as np
import pinocchio as pin
import pytest

from helpers.made_robots import planar_arm, random_chain, seven_joint_arm
from stiff_datasets.robots.shipped_robots import named_robot, shipped_robots
from stiff_datasets.robots.urdf_reader import read_robot
from stiff_datasets.robots.urdf_writer import robot_urdf, shipped_urdf
from stiff_protocols.contract.types import BenchmarkData, Robot, Samples
from stiff_protocols.springs.identification import IdentifiedSprings

ARRAYS = "placements axes lower upper masses gravity flange".split()


def read_back(robot: Robot, folder, text: str = "") -> Robot:
    path = folder / "robot.urdf"
    path.write_text(text or robot_urdf(robot))
    return read_robot(path, tcp=robot.tcp_on_flange.tolist())


def assert_same(actual: Robot, robot: Robot) -> None:
    for name in ("name", "joint_names", "joint_types"):
        assert getattr(actual, name) == getattr(robot, name)
    for name in ARRAYS:
        np.testing.assert_allclose(getattr(actual, name), getattr(robot, name), atol=1e-14)
    moments = (arm.masses[:, None] * arm.centres_of_mass for arm in (actual, robot))
    np.testing.assert_allclose(*moments, atol=1e-13)
    np.testing.assert_allclose(actual.tcp, robot.tcp, atol=1e-9)  # given to 1 nm


@pytest.mark.parametrize("name", shipped_robots())
def test_a_shipped_robot_reads_back(name, tmp_path):
    robot = named_robot(name).robot()
    assert_same(read_back(robot, tmp_path), robot)


@pytest.mark.parametrize("name", shipped_robots())
def test_its_own_file_gives_the_same_hash(name, tmp_path):
    robot = named_robot(name).robot()
    read = read_back(robot, tmp_path, shipped_urdf(named_robot(name)))
    none = np.zeros((0, 6))
    samples = Samples(none[:, : robot.n_joints], none, none[:, :3], *(np.array([], str),) * 3)
    assert BenchmarkData(samples, read).sha256 == BenchmarkData(samples, robot).sha256


def test_robots_with_other_joints_read_back(tmp_path):
    rng = np.random.default_rng(0)
    kinds = ("prismatic", "revolute", "revolute", "prismatic", "revolute")
    for robot in (
        seven_joint_arm(),
        planar_arm(3, (0.0, 1.0, 0.0), mass=2.0),
        random_chain(rng, kinds),
    ):
        assert_same(read_back(robot, tmp_path), robot)


def test_a_joint_without_limits_and_a_name_with_xml_signs_read_back(tmp_path):
    robot = replace(planar_arm(2, (0.0, 0.0, 1.0)), name='"a" <b> & c')
    free = replace(robot, lower=np.array([-np.inf, -1.0]), upper=np.array([np.inf, 1.0]))
    assert_same(read_back(free, tmp_path), free)


def test_springs_and_tcp_are_ignored_or_read_by_pinocchio(tmp_path):
    robot = replace(planar_arm(2, (0.0, 1.0, 0.0), mass=2.0), joint_names=("A", "A 1"))
    stiffness = np.array([2.0e4, 3.0e4, 5.0e4])
    springs = IdentifiedSprings(
        compliance=np.append(1.0 / stiffness, 0.0),
        is_identified=np.array([True, False, True, True]),
        log_error=np.zeros(4),
        rank=4,
        condition=1.0,
        names=("A", "A 1 rz", "A rz", "A 1 ry"),
        units=("Nm/rad",) * 4,
    )
    path = tmp_path / "fitted.urdf"
    path.write_text(robot_urdf(robot, springs))
    model = pin.buildModelFromUrdf(str(path))
    data, q = model.createData(), np.array([0.3, -0.8])
    pin.framesForwardKinematics(model, data, q)
    tcp = data.oMf[model.getFrameId("tcp")].translation
    np.testing.assert_allclose(tcp, robot.tcp_position(q[None])[0], atol=1e-12)
    np.testing.assert_allclose(read_robot(path).tcp, robot.tcp, atol=1e-12)
    written = {
        (joint.get("name"), spring.get("spring")): (float(spring.get("value")), spring.attrib)
        for joint in ElementTree.parse(path).iter("joint")
        for spring in joint.iter("stiffness")
    }
    assert [*written] == [("A", "A"), ("A", "A rz"), ("A 1", "A 1 rz"), ("A 1", "A 1 ry")]
    values = [value for value, _ in written.values()]
    np.testing.assert_allclose(values, [2.0e4, 5.0e4, 3.0e4, np.inf])
    identified = [attributes["identified"] for _, attributes in written.values()]
    assert identified == ["true", "true", "false", "true"]
