"""Check shapes of paths, and joint positions along them against Pinocchio."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pinocchio as pin
import pytest
from scipy.spatial.transform import Rotation

from helpers.made_robots import random_chain, seven_joint_arm
from stiff_datasets.robots.shipped_robots import named_robot
from stiff_protocols.contract.errors import ConfigError, DataError
from stiff_protocols.paths.inverse import (
    all_configurations,
    follow,
    is_singular,
    joint_number,
    judged,
)
from stiff_protocols.paths.path import SHAPES, ToolPath, shaped

LOAD = (0.0, 0.0, -85.0, 0.0, 0.0, 0.0)
READY = np.radians([0.0, -90.0, 90.0, 0.0, 60.0, 0.0])
N = 201


def tool_at(robot, q):
    """Return the tool's position and orientation."""
    frames = robot.forward(np.atleast_2d(q))
    return frames.points[:, -1], frames.rotation


def path_of(robot, name="square", size=0.2):
    (centre,), (rotation,) = tool_at(robot, READY)
    return shaped(name, centre, size, N, rotation=rotation, wrench=LOAD)


@pytest.mark.parametrize("name", SHAPES)
def test_shape_has_its_size_points_and_load_and_lies_about_its_centre(name):
    path = shaped(name, (1.0, 2.0, 3.0), 0.3, N, rotation=np.eye(3), wrench=LOAD)
    assert path.position.shape == (N, 3)
    np.testing.assert_array_equal(path.wrench, np.tile(LOAD, (N, 1)))
    spans = {"square": [0.3, 0.3, 0], "circle": [0.3, 0.3, 0], "line": [0.3, 0, 0]}
    iso = 0.8 * 0.3 * np.ones(3)  # a tenth of the diagonal away from both corners
    np.testing.assert_allclose(np.ptp(path.position, axis=0), spans.get(name, iso), atol=1e-4)
    middle = 0.5 * (path.position.min(axis=0) + path.position.max(axis=0))
    np.testing.assert_allclose(middle, [1.0, 2.0, 3.0], atol=1e-4)
    assert (path.position[0] == path.position[-1]).all() or name in ("line", "circle")


@pytest.mark.parametrize("n", [5, 6, 50, 401])
def test_every_corner_of_a_square_is_a_point_of_the_path(n):
    path = shaped("square", (0, 0, 0), 2.0, n, rotation=np.eye(3), wrench=LOAD)
    for corner in ((-1, -1, 0), (1, -1, 0), (1, 1, 0), (-1, 1, 0)):
        assert np.linalg.norm(path.position - corner, axis=1).min() < 1e-12


@pytest.mark.parametrize(
    ("changes", "match"),
    [
        ({"size": 0.0}, "size is 0"),
        ({"n_points": 4}, "at least 5"),
        ({"rotation": 2.0 * np.eye(3)}, "not a rotation"),
        ({"rotation": np.diag([1.0, 1.0, -1.0])}, "not a rotation"),
        ({"centre": (0.0, np.nan, 0.0)}, "centre"),
    ],
)
def test_a_shape_that_is_none_is_refused(changes, match):
    arguments = {"centre": (0, 0, 0), "size": 1.0, "n_points": 9, "rotation": np.eye(3)}
    with pytest.raises(DataError, match=match):
        shaped("square", **{**arguments, "wrench": LOAD, **changes})


@pytest.mark.parametrize("name", SHAPES)
def test_joint_positions_put_pinocchios_tool_on_the_path_without_a_jump(kr10, kr10_chain, name):
    path = path_of(kr10, name)
    course = follow(kr10, path.position, path.rotation)
    assert course.ok.all()
    assert np.abs(np.diff(course.q, axis=0)).max() < 0.05
    model = kr10_chain.model
    data = model.createData()
    for q, position, rotation in zip(course.q, path.position, path.rotation, strict=True):
        pin.forwardKinematics(model, data, q)
        tool = data.oMi[model.njoints - 1] * pin.SE3(np.eye(3), kr10_chain.robot.tcp)
        np.testing.assert_allclose(tool.translation, position, atol=2e-8)
        np.testing.assert_allclose(tool.rotation, rotation, atol=2e-8)


def test_points_far_apart_and_a_point_alone_are_reached_in_one_configuration(kr10):
    path = path_of(kr10, size=0.4)
    dense_course = follow(kr10, path.position, path.rotation, READY)
    corners = path.take(np.arange(0, N, 50))
    sparse_course = follow(kr10, corners.position, corners.rotation, READY)
    np.testing.assert_allclose(sparse_course.q, dense_course.q[::50], atol=1e-6)
    single = follow(kr10, path.position[:1], path.rotation[:1], READY)
    np.testing.assert_allclose(single.q, dense_course.q[:1], atol=1e-6)


def test_start_chooses_the_configuration_with_its_whole_turns(kr10):
    path = path_of(kr10, "line")
    usual_course = follow(kr10, path.position, path.rotation, READY)
    turned = follow(kr10, path.position, path.rotation, READY - [0, 0, 0, 0, 0, 2 * np.pi])
    np.testing.assert_allclose(turned.q[:, 5], usual_course.q[:, 5] - 2 * np.pi, atol=1e-6)
    flipped = follow(
        kr10, path.position, path.rotation, READY * [1, 1, 1, 1, -1, 1] + [0, 0, 0, np.pi, 0, np.pi]
    )
    np.testing.assert_allclose(tool_at(kr10, flipped.q)[0], path.position, atol=1e-7)
    assert (np.sign(flipped.q[:, 4]) == -np.sign(usual_course.q[:, 4])).all()


def test_only_points_out_of_reach_are_named(kr10):
    path = path_of(kr10, "line", size=1.2)
    course = follow(kr10, path.position, path.rotation, READY)
    away = np.linalg.norm(tool_at(kr10, course.q)[0] - path.position, axis=1)
    assert 0 < course.reached.sum() < N
    assert (away[course.reached] < 1e-7).all()
    assert (away[~course.reached] > 1e-6).all()
    reached = np.flatnonzero(course.reached)
    assert len(reached) == reached[-1] - reached[0] + 1


def test_joint_beyond_its_limits_is_named_with_its_rows(kr10):
    path = path_of(kr10)
    unlimited_course = follow(kr10, path.position, path.rotation, READY)
    upper = kr10.upper.copy()
    upper[1] = np.median(unlimited_course.q[:, 1]) + 1e-4
    course = follow(replace(kr10, upper=upper), path.position, path.rotation, READY)
    np.testing.assert_array_equal(course.beyond[:, 1], unlimited_course.q[:, 1] > upper[1])
    assert not np.delete(course.beyond, 1, axis=1).any()


def test_whole_turns_bring_a_joint_into_its_limits_where_no_start_is_given(kr10):
    path = path_of(kr10, "line")
    lower, upper = kr10.lower.copy(), kr10.upper.copy()
    lower[5], upper[5] = 1.5 * np.pi, 3.5 * np.pi
    course = follow(replace(kr10, lower=lower, upper=upper), path.position, path.rotation)
    assert course.ok.all()


def test_straight_wrist_is_singular_and_passing_it_is_a_flip(kr10):
    q = np.tile(READY, (N, 1))
    q[:, 4] = np.linspace(0.4, -0.4, N)
    straight_course = follow(kr10, *tool_at(kr10, q), q[0])
    assert straight_course.reached.all()
    assert straight_course.singular[N // 2]
    assert not straight_course.singular[[0, -1]].any()
    position, rotation = tool_at(kr10, q)
    tilted = Rotation.from_rotvec([1e-3, 0, 1e-3]).as_matrix() @ rotation
    for course in (straight_course, follow(kr10, position, tilted, q[0])):
        assert abs(int(np.flatnonzero(course.flips)[0]) - N // 2) < 5


@pytest.fixture(scope="module")
def configurations(kr10):
    """Return all joint positions at one pose; some are two or three flips apart."""
    seeds, solutions = np.random.default_rng(0).uniform(-np.pi, np.pi, size=(200, 6)), []
    q, reached = kr10.inverse(*tool_at(kr10, np.tile(READY, (200, 1))), seeds)
    for position in (q[reached] + np.pi) % (2 * np.pi) - np.pi:
        distances = [np.abs(np.sin(0.5 * (position - solution))).max() for solution in solutions]
        if min(distances, default=np.inf) >= 0.01:
            solutions.append(position)
    return np.array(solutions)


def test_given_joint_angles_are_in_one_configuration_only_where_no_part_flips(kr10, configurations):
    assert len(configurations) == 8  # shoulder, elbow and wrist
    sign = np.sign(np.linalg.det(kr10.jacobian(configurations)))
    assert (sign > 0).sum() == 4  # the sign misses three of seven changes
    for i, first in enumerate(configurations):
        for k, second in enumerate(configurations):
            course = judged(kr10, np.stack([first, second, second]))
            assert course.flips.tolist() == [False, i != k, False]


def test_given_joint_angles_far_apart_in_one_configuration_are_no_flip(kr10):
    away = np.array([2.5, 0.3, -0.4, 0.5, -0.3, 3.0])
    assert not judged(kr10, np.stack([READY - 0.5 * away, READY, READY + 0.5 * away])).flips.any()


BENT = np.radians([0.0, 30.0, 20.0, 70.0, 10.0, 50.0, 0.0])


@pytest.mark.parametrize("start", [None, BENT], ids=["found", "given"])
@pytest.mark.parametrize("joint", [0, 2, 6])
def test_a_joint_of_a_redundant_arm_is_held_along_the_path(joint, start):
    arm, held = seven_joint_arm(), np.full(7, np.nan)
    held[joint] = BENT[joint]
    (centre,), (rotation,) = tool_at(arm, BENT)
    path = shaped("square", centre, 0.1, 41, rotation=rotation, wrench=LOAD)
    course = follow(arm, path.position, path.rotation, start, held=held)
    assert course.ok.all()
    np.testing.assert_array_equal(course.q[:, joint], BENT[joint])
    position, tool_rotation = tool_at(arm, course.q)
    np.testing.assert_allclose(position, path.position, atol=1e-8)
    np.testing.assert_allclose(tool_rotation, path.rotation, atol=1e-7)


def test_a_held_joint_makes_the_arm_singular_where_the_others_are(kr10):
    straight = np.append(np.zeros(5), 0.3)
    track = replace(
        random_chain(np.random.default_rng(0), ("prismatic", *kr10.joint_types)),
        placements=np.concatenate([np.eye(4)[None], kr10.placements]),
        axes=np.concatenate([[[1.0, 0.0, 0.0]], kr10.axes]),
        tcp=kr10.tcp,
    )
    q = np.array([[0.5, *straight], [0.5, *READY]])
    held = np.array([0.0, *[np.nan] * 6])
    np.testing.assert_array_equal(judged(track, q, held).singular, judged(kr10, q[:, 1:]).singular)


def test_an_arm_without_limits_is_followed(kr10):
    endless = replace(kr10, lower=np.full(6, -np.inf), upper=np.full(6, np.inf))
    path = path_of(kr10)
    assert follow(endless, path.position, path.rotation).ok.all()


@pytest.mark.parametrize(
    ("name", "number"), [("A3", 2), ("J3", 2), ("q1", 0), ("6", 5), ("A7", None), ("wrist", None)]
)
def test_a_joint_is_called_by_its_name_or_number(kr10, name, number):
    if number is None:
        with pytest.raises(ConfigError, match=rf"joint '{name}'.*valid: A1, "):
            joint_number(kr10.joint_names, name)
    else:
        assert joint_number(kr10.joint_names, name) == number


def test_a_robot_with_a_choice_at_every_point_and_a_path_without_points_are_refused(rng):
    robot = random_chain(rng, ("revolute",) * 7)
    with pytest.raises(DataError, match="redundant"):
        follow(robot, np.zeros((2, 3)), np.tile(np.eye(3), (2, 1, 1)))
    with pytest.raises(DataError, match="no points"):
        ToolPath("none", np.zeros((0, 3)), np.zeros((0, 3, 3)), np.zeros((0, 6)))


@pytest.mark.parametrize("name", ["kr10-r1100-2", "ur5"])
def test_all_configurations_of_neighbouring_poses_are_those_of_a_search_for_each(name):
    robot = named_robot(name).robot()
    rng = np.random.default_rng(3)
    q = rng.uniform(-1.2, 1.2, (20, 6)).repeat(5, axis=0) + rng.normal(0.0, 0.02, (100, 6))
    poses = robot.forward(q)
    configurations = all_configurations(robot, poses.points[:, -1], poses.rotation)
    rows, which = np.nonzero(~np.isnan(configurations[..., 0]))
    reached = robot.forward(configurations[rows, which])
    np.testing.assert_allclose(reached.points[:, -1], poses.points[rows, -1], atol=1e-7)
    np.testing.assert_allclose(reached.rotation, poses.rotation[rows], atol=1e-7)
    near = np.abs(np.sin(0.5 * (configurations - q[:, None]))).max(axis=2)
    regular = ~is_singular(robot, q, np.ones(6, dtype=bool))
    assert regular.sum() > 80
    assert (np.nanmin(near[regular], axis=1) < 1e-6).all()
    for row in range(0, 100, 9):
        single = all_configurations(robot, poses.points[[row], -1], poses.rotation[[row]])
        assert (~np.isnan(single[..., 0])).sum() == (~np.isnan(configurations[row, :, 0])).sum()


def test_a_pose_out_of_reach_has_no_configuration():
    robot = named_robot("kr10-r1100-2").robot()
    configurations = all_configurations(robot, np.array([[9.0, 0.0, 0.0]]), np.eye(3)[None])
    assert np.isnan(configurations).all()
