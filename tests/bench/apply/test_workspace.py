"""Check grids of the workspace, and the configurations at their points."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from helpers.made_robots import planar_arm, seven_joint_arm
from stiff_apply.workspace import grid_configurations, plane_grid, reach_box, reached_poses
from stiff_protocols.contract.errors import DataError
from stiff_protocols.contract.training_range import TrainingRange
from stiff_protocols.paths.inverse import all_configurations, is_singular

FREE = np.full(6, np.nan)
READY = np.radians([0.0, -90.0, 90.0, 0.0, 60.0, 0.0])
REGION = np.array([[0.2, 1.2], [0.0, 0.0], [0.0, 1.0]])


def trained_at(q):
    """Return the range of a model that was trained at (n, 6) poses."""
    return TrainingRange(
        q.min(axis=0), q.max(axis=0), 100.0, 0.0, q, np.array([[0.0, 0.0, -1.0, 0.0, 0.0, 0.0]])
    )


@pytest.fixture(scope="module")
def grid():
    return plane_grid("xz", 0.1, REGION, 21)


@pytest.fixture(scope="module")
def grid_q(kr10, grid, rotation):
    """Return all configurations at the points of the grid."""
    return grid_configurations(kr10, grid, rotation, FREE)


@pytest.fixture(scope="module")
def rotation(kr10):
    return kr10.forward(READY[None]).rotation[0]


def test_a_grid_lies_in_its_plane_with_square_cells():
    region = np.array([[0.0, 2.0], [-1.0, 1.0], [0.5, 1.5]])
    points = plane_grid("yz", 0.3, region, 5)
    assert points.shape == (3, 5, 3)
    np.testing.assert_allclose(points[..., 0], 0.3)
    np.testing.assert_allclose(np.diff(points[0, :, 1]), 0.5)
    np.testing.assert_allclose(np.diff(points[:, 0, 2]), 0.5)


def test_the_reach_of_a_planar_arm_is_its_length():
    ends = reach_box(planar_arm(2, (0.0, 0.0, 1.0)))
    np.testing.assert_allclose(ends, [[-2.0, 2.0], [-2.0, 2.0], [0.0, 0.0]], atol=0.02)


@pytest.mark.slow
def test_waves_find_all_that_random_seeds_find_at_every_point(kr10, grid, rotation, grid_q):
    points = grid.reshape(-1, 3)
    searched_points = [
        all_configurations(kr10, point[None], rotation[None])[0] for point in points[::7]
    ]
    for point_q, expected_q in zip(grid_q[::7], searched_points, strict=True):
        for q in expected_q[~np.isnan(expected_q[:, 0])]:
            if not is_singular(kr10, q[None], np.isnan(FREE))[0]:
                distance = np.abs(np.sin(0.5 * (point_q - q))).max(axis=1)
                assert np.nanmin(distance) < 1e-6
    has_q = ~np.isnan(grid_q[..., 0])
    tcp = kr10.tcp_position(grid_q[has_q])
    np.testing.assert_allclose(tcp, points[np.nonzero(has_q)[0]], atol=1e-7)


@pytest.mark.slow
def test_the_edge_of_the_reach_is_a_sphere_about_the_shoulder(kr10, rotation):
    region = np.array([[0.0, 1.6], [0.0, 0.0], [-1.0, 1.6]])
    points = plane_grid("xz", 0.0, region, 53)
    q = grid_configurations(kr10, points, rotation, FREE)
    reached = ~np.isnan(q[:, 0, 0])
    pose = kr10.forward(q[reached, 0])
    wrist, shoulder = pose.points[:, 4], pose.points[:, 1]  # axes 4 to 6 cross at frame 5
    lever = (pose.points[0, -1] - wrist[0])[[0, 2]]
    distance = np.linalg.norm(
        points.reshape(-1, 3)[:, [0, 2]] - lever - shoulder[0, [0, 2]], axis=1
    )
    longest = distance[reached].max()
    assert reached[distance < 0.95 * longest].mean() > 0.97  # except in the hole about the shoulder


@pytest.mark.slow
def test_the_nearest_configuration_inside_the_limits_is_taken(kr10, grid, rotation, grid_q):
    upright, bent = READY, READY + np.radians([0.0, 30.0, -40.0, 180.0, -100.0, 180.0])
    for pose in (upright, bent):
        all_rows_q, blank = reached_poses(kr10, grid, rotation, trained_at(np.stack([pose, pose])))
        reached = blank == ""
        q = all_rows_q[reached]
        assert np.isnan(all_rows_q[~reached]).all()
        assert ((q >= kr10.lower - 1e-5) & (q <= kr10.upper + 1e-5)).all()
        assert not is_singular(kr10, q, np.isnan(FREE)).any()
        all_q = grid_q[reached.ravel()]
        inside = ((all_q >= kr10.lower) & (all_q <= kr10.upper)).all(axis=2)
        distances = np.where(inside, np.linalg.norm(all_q - pose, axis=2), np.inf)
        assert (np.linalg.norm(q - pose, axis=1) <= distances.min(axis=1) + 1e-5).all()


def test_points_are_blank_for_a_stated_reason(kr10, rotation):
    narrow_robot = replace(kr10, lower=np.radians([-5.0, -190, -120, -185, -120, -350]))
    narrow_robot = replace(narrow_robot, upper=np.radians([5.0, 45, 156, 185, 120, 350]))
    grid = plane_grid("xy", 0.5, np.array([[-1.0, 3.0], [-0.5, 0.5], [0, 0]]), 17)
    _, blank = reached_poses(narrow_robot, grid, rotation, trained_at(READY[None]))
    assert blank[2, 16] == "out of reach"  # at x = 3 m
    assert blank[4, 7] == "joint limits"  # joint 1 would turn by 34 deg
    assert blank[2, 7] == ""  # straight ahead


def test_an_arm_of_seven_joints_is_mapped_with_one_joint_held():
    robot, held = seven_joint_arm(), np.where(np.arange(7) == 2, 0.3, np.nan)
    ready = np.array([[0.1, 0.6, 0.3, -1.2, 0.2, 0.8, 0.3]])
    points = robot.tcp_position(ready)[0] + np.linspace(0.02, 0.1, 5)[:, None, None] * [1.0, 0, 0]
    rotation = robot.forward(ready).rotation[0]
    q, blank = reached_poses(robot, points, rotation, trained_at(ready), held)
    assert (blank == "").all()
    np.testing.assert_array_equal(q[..., 2], 0.3)
    np.testing.assert_allclose(robot.tcp_position(q[:, 0]), points[:, 0], atol=1e-7)
    with pytest.raises(DataError, match="7 joints move"):
        reached_poses(robot, points, rotation, trained_at(ready))
