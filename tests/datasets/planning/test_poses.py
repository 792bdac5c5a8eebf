"""Check the paper's plan: 61 + 90 poses inside the limits, on their grids."""

from __future__ import annotations

import numpy as np
import pinocchio as pin
import pytest

from stiff_datasets.planning.poses import (
    bent_wrist_poses,
    cartesian_poses,
    joint_space_poses,
    paper_poses,
)

RADII = {"base column": 0.12, "upper arm": 0.09, "forearm": 0.08, "hand": 0.06}
"""m, for a KR10: about half the width of the widest housing of each; assumption."""
PAIRS = (("base column", "forearm"), ("base column", "hand"), ("upper arm", "hand"))
"""Pairs that can collide; neighbours share a joint and always overlap there."""
STEPS = np.linspace(0.0, 1.0, 101)[:, None]


@pytest.fixture(scope="module")
def bent(kr10):
    return bent_wrist_poses(kr10)


def test_151_different_poses_lie_inside_the_limits_and_in_the_source_domain(kr10):
    joint_space = joint_space_poses()
    q = np.concatenate([joint_space, cartesian_poses(kr10)])
    assert q.shape == (151, 6) and len(np.unique(joint_space.round(9), axis=0)) == 61
    assert (q >= kr10.lower).all() and (q <= kr10.upper).all()
    lower, upper = np.array([-45, -180, 0, 0, 0, 0]), np.array([45, 0, 156, 0, 90, 0])
    assert (np.rad2deg(q) >= lower - 1e-9).all() and (np.rad2deg(q) <= upper + 1e-9).all()


def test_the_cartesian_group_puts_the_tcp_on_the_grid(kr10, kr10_chain):
    model, data = kr10_chain.model, kr10_chain.model.createData()
    reached = []
    for q in cartesian_poses(kr10):
        pin.forwardKinematics(model, data, q)
        reached.append(data.oMi[6].act(kr10_chain.robot.tcp) * 1000)
    expected = np.stack(
        np.meshgrid(range(300, 801, 100), range(-300, 301, 150), (300, 550, 800), indexing="ij"), -1
    ).reshape(-1, 3)
    np.testing.assert_allclose(reached, expected, atol=1e-6)


def self_clearance(robot, q):
    """Return an arm's smallest gap to itself, m; a negative gap is an overlap.

    The parts are capsules around sampled centre lines.
    """
    gaps = []
    for points in robot.forward(q).points:
        ends = {
            "base column": (np.zeros(3), points[0]),
            "upper arm": (points[1], points[2]),
            "forearm": (points[3], points[4]),
            "hand": (points[4], points[6]),
        }
        lines = {name: start + STEPS * (end - start) for name, (start, end) in ends.items()}
        gaps.append(
            min(
                np.linalg.norm(lines[a][:, None] - lines[b], axis=2).min() - RADII[a] - RADII[b]
                for a, b in PAIRS
            )
        )
    return np.array(gaps)


def test_no_planned_pose_collides_with_itself(kr10):
    assert self_clearance(kr10, paper_poses(kr10).q).min() > 0


def test_the_bent_wrist_plan_differs_only_in_a5_of_the_joint_space_poses(kr10, bent):
    level = paper_poses(kr10)
    assert (bent.pose_id == level.pose_id).all() and (bent.group == level.group).all()
    joints = [0, 1, 2, 3, 5]
    np.testing.assert_array_equal(bent.q[:, joints], level.q[:, joints])
    np.testing.assert_array_equal(bent.q[61:], level.q[61:])
    a5 = np.rad2deg(bent.q[:61, 4])
    assert (a5 >= 0).all() and (a5 <= 90).all() and (a5 == 90).sum() > 40
