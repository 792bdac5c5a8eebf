"""Check controllers' joint angles and frames against published poses and closed forms."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from stiff_datasets.robots.shipped_robots import named_robot
from stiff_datasets.robots.urdf_reader import read_robot
from stiff_protocols.contract.errors import DataError

DOWN_X = Rotation.from_euler("y", 90, degrees=True).as_matrix()  # x down, z forward
UP_X = DOWN_X @ Rotation.from_euler("z", 180, degrees=True).as_matrix()


def flange_pose(name, angles_deg):
    """Return the flange's position (mm) and rotation in the controller's world frame."""
    robot = named_robot(name).robot()
    controller = robot.controller
    frames = robot.forward(controller.to_description(np.radians([angles_deg])))
    pose = np.eye(4)
    pose[:3, :3] = frames.rotation[0]
    pose[:3, 3] = frames.points[0, -1] - frames.rotation[0] @ robot.tcp
    pose = np.linalg.inv(controller.world) @ pose @ robot.flange @ controller.flange
    return 1000.0 * pose[:3, 3], pose[:3, :3]


@pytest.mark.parametrize(
    ("name", "angles", "expected_position", "rotation"),
    [
        ("kr10-r1100-2", (0, -90, 90, 0, 0, 0), (630, 0, 985), DOWN_X),
        ("irb120-3-06", (0, 0, 0, 0, 0, 0), (374, 0, 630), DOWN_X),
        ("irb4600-40-255", (0, 0, 0, 0, 0, 0), (1580, 0, 1765), DOWN_X),
        ("lr-mate-200id", (0, 0, 0, 0, 0, 0), (465, 0, 365), UP_X),
        ("m20ib-25", (0, 0, 0, 0, 0, 0), (1040, 0, 1025), UP_X),
        ("fanuc-r2000ic", (0, 0, 0, 0, 0, 0), (1807, 0, 1300), UP_X),
    ],
)
def test_the_flange_at_home_is_where_the_makers_say(name, angles, expected_position, rotation):
    position, flange_rotation = flange_pose(name, angles)
    np.testing.assert_allclose(position, expected_position, atol=0.01)
    np.testing.assert_allclose(flange_rotation, rotation, atol=1e-9)


def test_the_ur5_has_the_makers_denavit_hartenberg_pose():
    rows = zip(
        (0, -0.425, -0.39225, 0, 0, 0),
        (0.089159, 0, 0, 0.10915, 0.09465, 0.0823),
        (np.pi / 2, 0, 0, np.pi / 2, -np.pi / 2, 0),
        angles := np.radians([20, -70, 100, -30, 40, 50]),
        strict=True,
    )
    pose = np.eye(4)
    for a, d, alpha, theta in rows:
        c, s, ca, sa = np.cos(theta), np.sin(theta), np.cos(alpha), np.sin(alpha)
        pose = pose @ np.array(
            [[c, -s * ca, s * sa, a * c], [s, c * ca, -c * sa, a * s], [0, sa, ca, d], [0, 0, 0, 1]]
        )
    position, rotation = flange_pose("ur5", np.degrees(angles))
    np.testing.assert_allclose(position, 1000.0 * pose[:3, 3], atol=0.01)
    np.testing.assert_allclose(rotation, pose[:3, :3], atol=1e-6)


@pytest.mark.parametrize("name", ["lr-mate-200id", "m20ib-25", "fanuc-r2000ic"])
def test_joint_3_of_a_fanuc_is_counted_from_the_ground(name):
    _, upright = flange_pose(name, (0, 0, 20, 0, 0, 0))
    _, leaning = flange_pose(name, (0, 35, 20, 0, 0, 0))
    np.testing.assert_allclose(leaning, upright, atol=1e-9)
    np.testing.assert_allclose(upright[2, 2], np.sin(np.radians(20)), atol=1e-9)  # forearm rises


@pytest.mark.parametrize("name", ["kr10-r1100-2", "irb120-3-06", "fanuc-r2000ic", "ur5"])
def test_joint_angles_come_back_from_the_description(name):
    controller = named_robot(name).robot().controller
    angles = np.random.default_rng(0).uniform(-2.0, 2.0, (20, 6))
    returned_angles = controller.from_description(controller.to_description(angles))
    np.testing.assert_allclose(returned_angles, angles, atol=1e-12)


@pytest.mark.parametrize(
    ("element", "part"),
    [
        ('<controller signs="1 1 1 1 1 2" zeros_deg="0 0 0 0 0 0"/>', "signs"),
        ('<controller signs="1 1 1 1 1" zeros_deg="0 0 0 0 0"/>', "5 joints"),
        ('<controller signs="1 1 1 1 1 1"/>', "zeros_deg"),
        ('<controller signs="a" zeros_deg="0"/>', "signs='a'"),
        (
            '<controller signs="1 1 1 1 1 1" zeros_deg="0 0 0 0 0 0" j3_from_ground="yes"/>',
            "j3_from_ground='yes'",
        ),
        (
            '<controller signs="1 1 1 1 1 1" zeros_deg="0 0 0 0 0 0">'
            '<world xyz="0 0"/></controller>',
            "rpy",
        ),
    ],
)
def test_a_wrong_controller_in_a_urdf_is_refused_with_its_attribute(tmp_path, element, part):
    from importlib.resources import files

    text = (files("stiff_datasets.robots") / "irb120_3_06.urdf").read_text()
    begin, end = text.index("<controller"), text.rindex("</robot>")
    file = tmp_path / "arm.urdf"
    file.write_text(text[:begin] + element + text[end:])
    with pytest.raises(DataError, match=part):
        read_robot(file)
