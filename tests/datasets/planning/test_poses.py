"""The measurement plan: 61 + 90 poses inside the limits, on their grids."""

from __future__ import annotations

import numpy as np
import pinocchio as pin
import pytest

from stiff_datasets.planning.poses import cartesian_poses, joint_space_poses


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
