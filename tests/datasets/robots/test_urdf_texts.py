"""Check URDF files that ROS reads though they are not strict XML, and files of other formats."""

from __future__ import annotations

import numpy as np
import pinocchio as pin
import pytest

from helpers.made_robots import arm_lines, tree_urdf
from stiff_datasets.robots.urdf_reader import read_robot
from stiff_protocols.contract.errors import DataError


@pytest.fixture()
def arm_text(tmp_path):
    """Return the text of an arm with six joints."""
    return tree_urdf(tmp_path / "arm.urdf", arm_lines("base", "a", 6)).read_text()


NOTE = "<!-- Prüfstand Süd -->"
ROBOT, END = '<robot name="arm">', "</robot>"
ODD_TEXTS = {
    "Windows-1252": lambda text: (NOTE + text).encode("cp1252"),
    "declared latin-1": lambda text: (
        f'<?xml version="1.0" encoding="ISO-8859-1"?>\n{NOTE}{text}'.encode("latin-1")
    ),
    "Windows-1252 that declares UTF-8": lambda text: (
        f'<?xml version="1.0" encoding="UTF-8"?>{NOTE}{text}'.encode("cp1252")
    ),
    "declared GBK": lambda text: (
        f'<?xml version="1.0" encoding="GBK"?><!-- 机器人 -->{text}'.encode("gbk")
    ),
    "an encoding that does not exist": lambda text: (
        f'<?xml version="1.0" encoding="windows-9"?>{NOTE}{text}'.encode()
    ),
    "UTF-16 of a shell": lambda text: f'<?xml version="1.0"?>{NOTE}{text}'.encode("utf-16"),
    "byte order mark": lambda text: text.encode("utf-8-sig"),
    "blank first lines": lambda text: f'\n\n<?xml version="1.0"?>\n{text}'.encode(),
    "hyphens in a comment": lambda text: f"<!-- ---- <!-- a -- b ---->{text}".encode(),
    "prefix without a namespace": lambda text: text.replace(END, f"<gz:plugin/>{END}").encode(),
    "ampersands": lambda text: text.replace(END, f'<gazebo a="x&y">&nbsp;</gazebo>{END}').encode(),
    "a namespace of its own": lambda text: text.replace(
        ROBOT, '<robot xmlns="http://drake.mit.edu" name="arm">'
    ).encode(),
    "expanded by xacro": lambda text: (
        text.replace(ROBOT, '<robot name="arm" xmlns:xacro="http://www.ros.org/wiki/xacro">')
        .replace(END, f'<gazebo><a filename="$(find b)/${{c}}"/>${{d}}</gazebo>{END}')
        .encode()
    ),
}


@pytest.mark.parametrize("kind", ODD_TEXTS)
def test_a_urdf_that_ros_reads_has_pinocchios_geometry_and_masses(kind, arm_text, tmp_path, rng):
    path = tmp_path / "odd.urdf"
    path.write_bytes(ODD_TEXTS[kind](arm_text))
    robot, model = read_robot(path), pin.buildModelFromXML(arm_text)
    q = rng.uniform(-1.0, 1.0, size=(2, 6))
    data = model.createData()
    for positions, place in zip(q, robot.tcp_position(q), strict=True):
        pin.framesForwardKinematics(model, data, positions)
        np.testing.assert_allclose(place, data.oMf[model.getFrameId("a6")].translation, atol=1e-12)
    np.testing.assert_array_equal(robot.masses, [inertia.mass for inertia in model.inertias][1:])


def test_a_mimic_joint_is_read_in_a_urdf_with_a_namespace(tmp_path):
    lines = arm_lines("base", "a", 2) + "\na2 b revolute mimic=to_a1\nb tool0 fixed"
    path = tree_urdf(tmp_path / "arm.urdf", lines)
    path.write_text(path.read_text().replace(ROBOT, '<robot xmlns="http://a.b" name="arm">'))
    assert [mimic.name for mimic in read_robot(path).mimics] == ["to_b"]


XACRO = '<robot name="r" xmlns:{0}="http://{1}ros.org/wiki/xacro"><{0}:include filename="a"/>{2}'
LFS = "version https://git-lfs.github.com/spec/v1\noid sha256:abc\nsize 12345\n"


@pytest.mark.parametrize(
    ("name", "text", "parts"),
    [
        ("a.xacro", XACRO.format("xacro", "www.", END), ["xacro file", "a.xacro > ", "/a.urdf"]),
        ("a.urdf.xacro", XACRO.format("x", "", END), ["a.urdf.xacro > ", "/a.urdf"]),
        ("a.urdf", '<robot name="${p}"/>', ["a.urdf > ", "/a_expanded.urdf"]),
        ("my arm.xacro", "<robot><xacro:arm/></robot>", ["/my arm.xacro' > '", "/my arm.urdf'"]),
        ("a.sdf", '<sdf version="1.7"><model name="arm"/></sdf>', ["SDF", "URDF"]),
        ("a.xml", '<mujoco model="arm"><worldbody/></mujoco>', ["MJCF", "URDF"]),
        ("a.srdf", '<robot name="r"><group name="g"/></robot>', ["SRDF", "URDF"]),
        ("a.dae", "<COLLADA/>", ["COLLADA", "URDF"]),
        ("a.urdf", "<arm/>", ["<arm>", "<robot>"]),
        ("a.urdf", LFS, ["Git LFS", "git lfs pull"]),
        ("a.urdf", "\n<!DOCTYPE html>\n<html><br></html>", ["web page", "Raw"]),
        ("a.urdf", "<html><body></html>", ["web page", "Raw"]),
        ("a.urdf", "404: Not Found", ["'404: Not Found'", "line 1"]),
        ("a.urdf", "\n\n<robot>\n<!-- \n -- -->\n</robo>", ["line 6"]),
        ("a.urdf", "\0\1\2", ["not XML"]),
    ],
)
def test_a_file_of_another_format_is_named_with_the_next_step(tmp_path, name, text, parts):
    path = tmp_path / name
    path.write_text(text)
    with pytest.raises(DataError) as error:
        read_robot(path)
    for part in [str(path), "not a robot description", *parts]:
        assert part in str(error.value)


def test_comments_that_never_end_are_refused_at_once(tmp_path):
    path = tmp_path / "arm.urdf"
    path.write_text('<robot name="arm">' + "<!-- " * 1_000_000)
    with pytest.raises(DataError, match="not XML"):
        read_robot(path)
