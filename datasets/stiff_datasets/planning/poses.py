"""List the poses of the source paper's Table 1: 61 joint-space and 90 Cartesian poses.

The paper leaves some details open. They are chosen so that every pose lies in the simulated source
domain (Table 4: A4 = A6 = 0, A5 in 0..90 deg, A1 in -45..45 deg):

* A2 steps by 15 deg, which gives 60 poses; the 61st is a reference pose with the tool down.
* "A5 and A6 adjusted to the measurement": A6 = 0, and A5 keeps the tool level if it can within
  0..90 deg; otherwise it is at the nearer end.
* The Cartesian group's three levels are 300, 550 and 800 mm (a step of 250; the printed "interval
  300" does not give three levels inside 300..800). The tool lies in the arm's plane. A5 takes 15,
  30, 45, 60 and 75 deg in turn, because A4 affects the deflection only if A5 is bent. If the joint
  limits exclude this angle, A5 takes the nearest of the five.

`bent_wrist_poses` chooses A5 of the joint-space group differently: as near to 90 deg as possible,
in steps of 5 deg. The TCP has to be 250 mm off A1's axis, and the arm 20 mm clear of itself
(capsules along base column, upper arm, forearm and hand). At 13 poses no A5 in 0..90 deg reaches
the 250 mm; there only the second condition applies.
`tests/datasets/planning/test_poses.py` computes it.

Collisions with objects around the robot are not checked.
"""

from __future__ import annotations

import itertools
from dataclasses import dataclass, replace

import numpy as np

from stiff_protocols.contract.errors import DataError
from stiff_protocols.contract.types import FloatArray, Robot, TextArray

A2_STEP_DEG = 15
# A1, first A2, last A2, A3 in deg
_SWEEPS = (
    (0, -90, 0, 0),
    (0, -120, -30, 30),
    (0, -150, -30, 60),
    (0, -150, -60, 90),
    (0, -180, -60, 120),
    (0, -180, -60, 150),
)
_SIDE_A1_DEG = (-15, -30)
_SIDE_A2_A3_DEG = ((0, 0), (-30, 30), (-30, 60), (-60, 90), (-60, 120), (-60, 150))
_REFERENCE_POSE_DEG = (0, -90, 90, 0, 90, 0)

CARTESIAN_X_MM = (300, 400, 500, 600, 700, 800)
CARTESIAN_Y_MM = (-300, -150, 0, 150, 300)
CARTESIAN_Z_MM = (300, 550, 800)

_CARTESIAN_A5_DEG = (15, 30, 45, 60, 75)
_A5_RANGE_DEG = (0.0, 90.0)
_BENT_A5_DEG = {
    **{26: 75, 28: 85, 34: 35, 35: 70, 40: 35, 41: 40, 42: 40, 43: 15, 44: 25, 45: 25, 46: 25},
    **{47: 20, 48: 5, 54: 5, 60: 5},
}
"""Number of a joint-space pose -> A5 of `bent_wrist_poses`; 90 at the others."""
_START = np.deg2rad((-90.0, 90.0))
"""A2 and A3 at the start of the inverse kinematics: elbow up."""
_MAX_STEP = 0.3  # rad; a full Newton step may change the elbow configuration


@dataclass(frozen=True, eq=False)
class Poses:
    """Poses of a measurement.

    Attributes:
        q: (n, n_joints) rad.
        pose_id: (n,) names.
        group: (n,) parts of the plan.
    """

    q: FloatArray
    pose_id: TextArray
    group: TextArray


def paper_poses(robot: Robot) -> Poses:
    """Return the 61 + 90 poses of the KR10, named J01.. and C01..; see `cartesian_poses`."""
    joint_space, cartesian = joint_space_poses(), cartesian_poses(robot)
    names = [f"J{i + 1:02d}" for i in range(len(joint_space))]
    names += [f"C{i + 1:02d}" for i in range(len(cartesian))]
    return Poses(
        q=np.concatenate([joint_space, cartesian]),
        pose_id=np.array(names),
        group=np.repeat(["joint-space", "cartesian"], [len(joint_space), len(cartesian)]),
    )


def bent_wrist_poses(robot: Robot) -> Poses:
    """Return `paper_poses` with another A5 in joint space, and its errors."""
    level = paper_poses(robot)
    q = level.q.copy()
    numbers = range(1, (level.group == "joint-space").sum() + 1)
    q[: len(numbers), 4] = np.deg2rad([_BENT_A5_DEG.get(number, 90) for number in numbers])
    return replace(level, q=q)


def joint_space_poses() -> FloatArray:
    """Return the (61, 6) joint-space group, rad."""
    arm = [
        (a1, a2, a3)
        for a1, first, last, a3 in _SWEEPS
        for a2 in range(first, last + 1, A2_STEP_DEG)
    ]
    arm += [(a1, a2, a3) for a1 in _SIDE_A1_DEG for a2, a3 in _SIDE_A2_A3_DEG]
    poses = [(a1, a2, a3, 0.0, np.clip(-(a2 + a3), *_A5_RANGE_DEG), 0.0) for a1, a2, a3 in arm]
    return np.deg2rad(np.array([*poses, _REFERENCE_POSE_DEG], dtype=np.float64))


def cartesian_poses(robot: Robot) -> FloatArray:
    """Return the (90, 6) poses that put the KR10's TCP on the grid, rad.

    Raises:
        DataError: a grid point cannot be reached inside the joint limits.
    """
    grid = np.array([*itertools.product(CARTESIAN_X_MM, CARTESIAN_Y_MM, CARTESIAN_Z_MM)])
    angles = np.array(_CARTESIAN_A5_DEG)
    preferred_a5 = np.resize(angles, len(grid))
    nearest = np.argsort(np.abs(angles - preferred_a5[:, None]), axis=1, kind="stable")
    poses = np.full((len(grid), robot.n_joints), np.nan)
    for a5_deg in angles[nearest].T:
        unsolved = np.flatnonzero(np.isnan(poses[:, 0]))
        q = _inverse_kinematics(robot, grid[unsolved] / 1000.0, np.deg2rad(a5_deg[unsolved]))
        inside = ((robot.lower <= q) & (q <= robot.upper)).all(axis=1)
        poses[unsolved[inside]] = q[inside]
    if np.isnan(poses).any():
        point = grid[np.isnan(poses[:, 0])][0]
        raise DataError(f"the TCP cannot reach {point} mm inside the joint limits")
    return poses


def _inverse_kinematics(robot: Robot, targets: FloatArray, a5: FloatArray) -> FloatArray:
    """Return (n, 6) poses for TCPs `targets` (n, 3) m and A5 (n,) rad; NaN: no solution.

    Newton's method on A1, A2 and A3 with A4 = A6 = 0.
    """
    q = np.zeros((len(targets), 6))
    q[:, 0], q[:, 1:3], q[:, 4] = -np.arctan2(targets[:, 1], targets[:, 0]), _START, a5
    for _ in range(100):
        missing = targets - robot.tcp_position(q)
        is_off = np.abs(missing).max(axis=1, initial=0.0) >= 1e-12
        if not is_off.any():
            break
        rows = robot.jacobian(q[is_off])[:, :3, :3]
        step = (np.linalg.pinv(rows, rcond=1e-6) @ missing[is_off, :, None])[:, :, 0]
        q[is_off, :3] += np.clip(step, -_MAX_STEP, _MAX_STEP)
    return np.where(is_off[:, None], np.nan, q)
