"""The measurement plan: 61 + 90 poses inside the limits, on their grids."""

from __future__ import annotations

import numpy as np
import pinocchio as pin
import pytest

from stiff_datasets.planning.poses import (
    COLUMN,
    FOREARM,
    HAND,
    PAIRS,
    RADII,
    UPPER_ARM,
    bent_wrist_poses,
    cartesian_poses,
    joint_space_poses,
    paper_poses,
    self_clearance,
    tcp_off_a1,
)

TOO_NEAR_A1 = "J01 J08 J09 J16 J17 J24 J25 J31 J32 J33 J40 J41 J42".split()
"""No A5 in 0..90 deg puts the TCP 250 mm off A1's axis."""


@pytest.fixture(scope="module")
def bent(kr10_chain):
    return bent_wrist_poses(kr10_chain)


@pytest.mark.parametrize(
    ("a3", "a2_first", "a2_last", "count"),
    [
        (0, -90, 0, 7),
        (30, -120, -30, 7),
        (60, -150, -30, 9),
        (120, -180, -60, 9),
        (150, -180, -60, 9),
    ],
)
def test_a2_sweeps_as_in_table_1(a3, a2_first, a2_last, count):
    q = np.rad2deg(joint_space_poses()[:-1])
    a2 = q[(q[:, 0] == 0) & np.isclose(q[:, 2], a3), 1]
    assert len(a2) == count
    assert (a2.min(), a2.max()) == pytest.approx((a2_first, a2_last))


def test_151_different_poses_lie_inside_the_limits_and_in_the_source_domain(kr10, kr10_chain):
    joint_space = joint_space_poses()
    q = np.concatenate([joint_space, cartesian_poses(kr10_chain)])
    assert q.shape == (151, 6) and len(np.unique(joint_space.round(9), axis=0)) == 61
    assert (q >= kr10.lower).all() and (q <= kr10.upper).all()
    lower, upper = np.array([-45, -180, 0, 0, 0, 0]), np.array([45, 0, 156, 0, 90, 0])
    assert (np.rad2deg(q) >= lower - 1e-9).all() and (np.rad2deg(q) <= upper + 1e-9).all()


def test_the_cartesian_group_puts_the_tcp_on_the_grid(kr10_chain):
    model, data = kr10_chain.model, kr10_chain.model.createData()
    reached = []
    for q in cartesian_poses(kr10_chain):
        pin.forwardKinematics(model, data, q)
        reached.append(data.oMi[6].act(kr10_chain.tcp) * 1000)
    expected = np.stack(
        np.meshgrid(range(300, 801, 100), range(-300, 301, 150), (300, 550, 800), indexing="ij"), -1
    ).reshape(-1, 3)
    np.testing.assert_allclose(reached, expected, atol=1e-6)


def test_no_planned_pose_collides_with_itself(kr10_chain, bent):
    assert self_clearance(kr10_chain, paper_poses(kr10_chain).q).min() > 0
    assert self_clearance(kr10_chain, bent.q).min() >= 0.02


def test_the_bent_wrist_is_the_same_plan_but_for_a5_in_joint_space(kr10_chain, bent):
    level = paper_poses(kr10_chain)
    assert (bent.pose_id == level.pose_id).all() and (bent.group == level.group).all()
    others = [0, 1, 2, 3, 5]
    np.testing.assert_array_equal(bent.q[:, others], level.q[:, others])
    np.testing.assert_array_equal(bent.q[61:], level.q[61:])
    a5 = np.rad2deg(bent.q[:61, 4])
    assert (a5 >= 0).all() and (a5 <= 90).all() and (a5 == 90).sum() > 40


def test_a_bent_wrist_keeps_the_tcp_off_a1_wherever_a5_permits(kr10_chain, bent):
    near = tcp_off_a1(kr10_chain, bent.q) < 0.25
    assert bent.pose_id[near].tolist() == TOO_NEAR_A1
    for q in bent.q[near]:
        every_a5 = np.tile(q, (91, 1))
        every_a5[:, 4] = np.deg2rad(range(91))
        assert tcp_off_a1(kr10_chain, every_a5).max() < 0.25


def test_a_more_bent_wrist_would_collide_or_bring_the_tcp_nearer(kr10_chain, bent):
    q = np.delete(bent.q[:61], 27, axis=0)  # J28 leaves 90 deg to the reference pose
    q = q[q[:, 4] < np.deg2rad(89)]
    allowed = self_clearance(kr10_chain, q) >= 0.02
    was_off = tcp_off_a1(kr10_chain, q) >= 0.25
    q[:, 4] += np.deg2rad(5)
    collides = self_clearance(kr10_chain, q) < 0.02
    assert len(q) == 14 and allowed.all()
    assert (collides | (was_off & (tcp_off_a1(kr10_chain, q) < 0.25))).all()


STEPS = np.linspace(0.0, 1.0, 101)[:, None]


def sampled_gap(points, first, second):
    """Return the gap of two capsules of one pose, from sampled centre lines."""
    ends = {
        COLUMN: (np.zeros(3), points[0]),
        UPPER_ARM: (points[1], points[2]),
        FOREARM: (points[3], points[4]),
        HAND: (points[4], points[6]),
    }
    lines = [ends[name][0] + STEPS * (ends[name][1] - ends[name][0]) for name in (first, second)]
    distance = np.linalg.norm(lines[0][:, None] - lines[1], axis=2).min()
    return distance - RADII[first] - RADII[second]


def test_the_smallest_gap_is_that_of_sampled_points_in_any_pose(kr10, kr10_chain, rng):
    q = rng.uniform(kr10.lower, kr10.upper, size=(20, 6))
    q[10:, 2:5] = np.deg2rad(rng.uniform((130, -10, 60), (156, 10, 120), size=(10, 3)))  # folded
    sampled = np.array(
        [min(sampled_gap(at, *pair) for pair in PAIRS) for at in kr10.forward(q).points]
    )
    found = self_clearance(kr10_chain, q)
    assert (found <= sampled + 1e-9).all()
    np.testing.assert_allclose(found, sampled, atol=2e-3)
    assert (found < 0).any() and (found > 0).any()


def test_an_upright_arm_is_clear_and_a_folded_one_is_not(kr10_chain):
    upright, folded = (0, -90, 0, 0, 0, 0), (0, -90, 156, 0, 120, 0)
    found = self_clearance(kr10_chain, np.deg2rad([upright, folded]))
    assert found[0] > 0.3 and found[1] < 0
