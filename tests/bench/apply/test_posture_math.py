"""Check postures at a point and along a path against closed forms and enumeration."""

from __future__ import annotations

from itertools import product

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from helpers.made_robots import chain, planar_arm
from stiff_apply.posture_math import (
    BRANCHES,
    all_postures,
    best_courses,
    branch_numbers,
    nearest_turns,
    turned,
)
from stiff_datasets.robots.shipped_robots import named_robot, shipped_robots
from stiff_protocols.contract.errors import ConfigError
from stiff_protocols.paths.inverse import all_configurations, is_singular

UPPER_ARM, FOREARM, TOOL = 0.6, 0.5, 0.1
DOWN = np.diag([1.0, -1.0, -1.0])
ALL_FREE = np.ones(6, dtype=bool)


def wrist_arm(limit=np.pi):
    """Return an arm with shoulder in the origin, elbow and spherical wrist.

    The tool lies along the last axis.
    """
    placements = np.tile(np.eye(4), (6, 1, 1))
    placements[2, 2, 3], placements[3, 2, 3] = UPPER_ARM, FOREARM
    along, across = (0.0, 0.0, 1.0), (0.0, 1.0, 0.0)
    return chain(
        "wrist-arm",
        ("revolute",) * 6,
        placements,
        joint_names=tuple(f"J{i + 1}" for i in range(6)),
        axes=np.array([along, across, across, along, across, along]),
        lower=np.full(6, -limit),
        upper=np.full(6, limit),
        tcp=np.array([0.0, 0.0, TOOL]),
    )


def tool_at(robot, q):
    poses = robot.forward(np.atleast_2d(q))
    return poses.points[:, -1], poses.rotation


def elbows(x, z):
    """Return x of both elbow positions: the intersections of two circles."""
    distance = np.hypot(x, z)
    along = (UPPER_ARM**2 - FOREARM**2 + distance**2) / (2.0 * distance)
    across = np.sqrt(UPPER_ARM**2 - along**2)
    return (along * x - across * z) / distance, (along * x + across * z) / distance


@pytest.mark.parametrize("height", [0.4, -0.4])
def test_with_a_soft_elbow_the_best_branch_is_that_of_the_elbow_over_the_load(height):
    """A force along z turns joint 3 by its horizontal lever from the elbow to the tool."""
    robot, compliance, force = wrist_arm(), np.array([0.0, 0, 1e-5, 0, 0, 0]), -100.0
    x, z = 0.55, height
    tilted = DOWN @ Rotation.from_euler("y", 0.7).as_matrix()
    tool = TOOL * tilted[:, 2]  # from the wrist, which is at (x, z)
    position = np.array([[x + tool[0], 0.0, z + tool[2]]])
    rotations = turned(tilted[None], np.array([0.0, 0.0, 1.0]), np.zeros(1))
    postures = all_postures(robot, position, rotations, near=np.zeros(6)).q[0, 0]
    is_reached = ~np.isnan(postures[:, 0])
    wrench = np.tile([0.0, 0.0, force, 0.0, 0.0, 0.0], (is_reached.sum(), 1))
    size = np.full(8, np.inf)
    size[is_reached] = np.abs(
        robot.joint_deflection(compliance, postures[is_reached], wrench)[:, 2]
    )
    front = np.array([name.startswith("front") for name in BRANCHES])
    for name, elbow in zip(("up", "down"), elbows(x, z), strict=True):
        sizes = [size[BRANCHES.index(f"front {name} {wrist}")] for wrist in "+-"]
        assert sizes == pytest.approx([1e-5 * abs(force) * (x + tool[0] - elbow) ** 2] * 2)
    best_branch = BRANCHES[int(np.argmin(np.where(front, size, np.inf)))]
    up, down = elbows(x, z)
    nearer_elbow = "up" if abs(x + tool[0] - up) < abs(x + tool[0] - down) else "down"
    assert best_branch.split()[1] == nearer_elbow


@pytest.mark.slow
@pytest.mark.parametrize("name", shipped_robots())
def test_every_configuration_of_a_shipped_arm_has_a_branch_of_its_own(name):
    robot, rng = named_robot(name).robot(), np.random.default_rng(0)
    low, high = np.maximum(robot.lower, -np.pi), np.minimum(robot.upper, np.pi)
    for q in rng.uniform(low, high, size=(12, 6)):
        configurations = all_configurations(robot, *tool_at(robot, q))[0]
        configurations = configurations[~np.isnan(configurations[:, 0])]
        numbers = branch_numbers(robot, configurations)
        assert len(set(numbers)) == len(configurations) >= 2
        assert branch_numbers(robot, configurations + 2.0 * np.pi).tolist() == numbers.tolist()


def test_a_branch_is_named_as_the_arm_looks():
    robot = wrist_arm()
    q = np.array(
        [
            [0.0, 0.3, 1.2, 0.0, 0.5, 0.0],  # reaches forwards, elbow above, joint 5 positive
            [0.0, 1.5, -1.2, 0.0, -0.5, 0.0],  # elbow below
            [2.0, 0.3, 1.2, 0.0, -0.5, 0.0],  # turned: still its front
        ]
    )
    names = [BRANCHES[number] for number in branch_numbers(robot, q)]
    assert [name.split()[1:] for name in names] == [["up", "+"], ["down", "-"], ["up", "-"]]
    overhead = np.array([[0.0, -0.3, -1.2, 0.0, 0.5, 0.0]])  # reaches back over its head
    behind = BRANCHES[branch_numbers(robot, overhead)[0]]
    assert {behind.split()[0], names[0].split()[0]} == {"front", "back"}


def test_postures_reach_the_point_with_the_axis_inside_limits_away_from_singularities():
    robot = named_robot("kr10-r1100-2").robot()
    q = np.radians([[10.0, -80.0, 100.0, 20.0, 60.0, 0.0]])
    position, rotation = tool_at(robot, q)
    axis = np.array([0.0, 0.6, 0.8])
    angles = 2.0 * np.pi * np.arange(24) / 24
    rotations = turned(rotation, axis, angles)
    postures = all_postures(robot, position, rotations, near=np.zeros(6))
    row, turn, branch = np.nonzero(~np.isnan(postures.q[..., 0]))
    joint_positions = postures.q[row, turn, branch]
    assert 24 < len(joint_positions) <= postures.n_inside[0] < postures.n_reached[0]
    reached_positions, orientation = tool_at(robot, joint_positions)
    np.testing.assert_allclose(
        reached_positions, np.tile(position, (len(joint_positions), 1)), atol=1e-7
    )
    np.testing.assert_allclose(orientation, rotations[0, turn], atol=1e-6)
    np.testing.assert_allclose(
        orientation @ axis, np.tile(rotation[0] @ axis, (len(joint_positions), 1)), atol=1e-6
    )
    assert ((joint_positions >= robot.lower - 1e-6) & (joint_positions <= robot.upper + 1e-6)).all()
    assert not is_singular(robot, joint_positions, ALL_FREE).any()
    assert (branch_numbers(robot, joint_positions) == branch).all()
    angle = Rotation.from_matrix(rotation[0].T @ orientation).as_rotvec() @ axis
    np.testing.assert_allclose(np.cos(angle), np.cos(angles[turn]), atol=1e-6)


def test_whole_turns_of_a_joint_are_taken_next_to_the_wanted_ones_inside_the_limits():
    robot = wrist_arm(limit=np.radians(350.0))
    q = np.radians([[10.0, 0.0, 0.0, 170.0, 0.0, -100.0]])
    near = np.radians([0.0, 0.0, 0.0, -180.0, 0.0, 300.0])
    postures = np.degrees(nearest_turns(robot, q, near))[0]
    np.testing.assert_allclose(postures, [10.0, 0.0, 0.0, -190.0, 0.0, 260.0])


def made_postures(rng, n, m):
    """Return joint positions that hardly change between points; some are missing."""
    q = np.tile(rng.uniform(-0.3, 0.3, size=(1, m, 8, 6)), (n, 1, 1, 1))
    q[rng.random((n, m, 8)) < 0.2] = np.nan
    return q


def test_the_courses_are_those_that_enumeration_finds():
    rng, n, m = np.random.default_rng(0), 4, 7
    q, cost = made_postures(rng, n, m), rng.random((n, m, 8))
    courses = best_courses(wrist_arm(), q, cost, np.zeros(6))
    expected_costs = {
        (branch, turn): cost[:, turn, branch].mean()
        for branch, turn in product(range(8), range(m))
        if not np.isnan(q[:, turn, branch]).any()
    }
    best_costs = {(course.branch, course.turn): course.cost for course in courses}
    assert best_costs == pytest.approx(expected_costs)
    assert [course.cost for course in courses] == sorted(best_costs.values())
    for course in courses:
        np.testing.assert_allclose(course.q, q[:, course.turn, course.branch])


def test_a_joint_that_would_turn_beyond_its_limit_along_the_path_ends_the_course():
    n = 12
    q = np.full((n, 1, 8, 6), np.nan)
    q[:, 0, 0] = 0.0
    q[:, 0, 0, 5] = (np.linspace(2.0, 6.0, n) + np.pi) % (2.0 * np.pi) - np.pi
    cost = np.ones((n, 1, 8))
    assert not best_courses(wrist_arm(), q, cost, np.zeros(6))
    (course,) = best_courses(wrist_arm(limit=4.4), q, cost, np.zeros(6))
    assert np.abs(np.diff(course.q[:, 5])).max() < 0.5
    np.testing.assert_allclose(course.q[:, 5], np.linspace(2.0, 6.0, n) - 2.0 * np.pi)


def test_an_arm_that_is_no_six_axis_arm_is_refused():
    robot = planar_arm(3, (0.0, 0.0, 1.0))
    with pytest.raises(ConfigError, match="3 joints move, 3 of them turn"):
        all_postures(robot, np.zeros((1, 3)), np.eye(3)[None, None], near=np.zeros(3))
