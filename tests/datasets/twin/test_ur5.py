"""The UR5: its kinematics against the published rows, and against 1020 real laser readings."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pandas as pd
import pinocchio as pin
import pytest
from scipy.optimize import least_squares
from scipy.spatial.transform import Rotation

from stiff_datasets.robots.shipped_robots import shipped_chain, shipped_robot

HALF = np.pi / 2
DH_ROWS = [  # d, a, alpha: frame i in frame i-1 is Rz(q) Tz(d) Tx(a) Rx(alpha)
    (0.089159, 0, HALF),
    (0, -0.425, 0),
    (0, -0.39225, 0),
    (0.10915, 0, HALF),
    (0.09465, 0, -HALF),
    (0.0823, 0, 0),
]
CENTRES_OF_MASS = [  # m, link i in Denavit-Hartenberg frame i
    (0, -0.02561, 0.00193),
    (0.2125, 0, 0.11336),
    (0.15, 0, 0.0265),
    (0, -0.0018, 0.01634),
    (0, 0.0018, 0.01634),
    (0, 0, -0.001159),
]
TOOL_M = 0.031  # along the flange axis; found from the targets of the real data
SHARED = Path(__file__).parents[4] / "shared" / "data" / "ur5_wam_jacobi" / "UR5"


def dh_step(row, angle):
    d, a, alpha = row
    ca, sa, ct, st = np.cos(alpha), np.sin(alpha), np.cos(angle), np.sin(angle)
    return np.array(
        [
            [ct, -st * ca, st * sa, a * ct],
            [st, ct * ca, -ct * sa, a * st],
            [0, sa, ca, d],
            [0] * 3 + [1],
        ]
    )


def dh_flange(q):
    """The flange by the published distal Denavit-Hartenberg rows, without a URDF."""
    pose = np.eye(4)
    for row, angle in zip(DH_ROWS, q, strict=True):
        pose = pose @ dh_step(row, angle)
    return pose


def flange_poses(angles):
    """The flange by the shipped URDF: (n, 4, 4)."""
    model = shipped_chain("ur5", (0, 0, 0)).model
    data, flange = model.createData(), model.getFrameId("flange")
    poses = []
    for q in angles:
        pin.framesForwardKinematics(model, data, q)
        poses.append(data.oMf[flange].homogeneous)
    return np.stack(poses)


def readings(part):
    """Joint angles [rad], target [m] and error [m] of the real data."""
    table = pd.read_csv(SHARED / f"3D_UR5_uncalibrated_{part}_cleaned.csv")
    q = np.deg2rad(table.filter(like="joint_").to_numpy())
    target, error = table[["x_t", "y_t", "z_t"]], table[["x_dif", "y_dif", "z_dif"]]
    return q, target.to_numpy() / 1000, error.to_numpy() / 1000


def placed(parameters, poses):
    """Where a tool point stands: frame shift (3), frame rotation vector (3), tool point (3)."""
    shift, turn, tool = np.split(parameters, 3)
    points = poses[:, :3, :3] @ tool + poses[:, :3, 3]
    return Rotation.from_rotvec(turn).apply(points) + shift


def size_mm(residual):
    """Rms and largest length of (n, 3) residuals."""
    length = np.linalg.norm(residual, axis=1) * 1000
    return np.sqrt((length**2).mean()), length.max()


def test_the_urdf_stands_where_the_published_rows_put_it(rng):
    angles = rng.uniform(-2 * np.pi, 2 * np.pi, size=(50, 6))
    np.testing.assert_allclose(flange_poses(angles), [dh_flange(q) for q in angles], atol=1e-12)


def test_it_has_the_published_limits_efforts_masses_and_centres_of_mass():
    robot = shipped_robot("ur5", tcp=(0, 0, 0))
    np.testing.assert_allclose(np.rad2deg(robot.upper), [360] * 6)
    np.testing.assert_allclose(np.rad2deg(robot.lower), [-360] * 6)
    efforts = shipped_chain("ur5", (0, 0, 0)).model.effortLimit
    np.testing.assert_allclose(efforts, [150, 150, 150, 28, 28, 28])
    np.testing.assert_allclose(robot.masses, [3.7, 8.393, 2.33, 1.219, 1.219, 0.1879])
    in_joint_frames = [
        (dh_step(row, 0.0) @ [*centre, 1])[:3]
        for row, centre in zip(DH_ROWS, CENTRES_OF_MASS, strict=True)
    ]
    np.testing.assert_allclose(robot.centres_of_mass, in_joint_frames, atol=1e-12)


@pytest.mark.skipif(not SHARED.is_dir(), reason="the UR5 readings are not beside this checkout")
def test_real_angles_give_the_targets_and_real_positions_an_uncalibrated_ur5s_errors():
    measured, poses = {}, {}
    for part in ("grid", "random"):
        q, target, error = readings(part)
        measured[part], poses[part] = target + error, flange_poses(q)
        # no frame is fitted: signs and zeros must be right
        tool = np.r_[np.zeros(6), 0, 0, TOOL_M]
        assert size_mm(placed(tool, poses[part]) - target)[1] < 0.1
    fit = least_squares(
        lambda p: (placed(p, poses["grid"]) - measured["grid"]).ravel(), np.zeros(9), x_scale=0.1
    )
    for part, expected in (("grid", (0.701, 2.287)), ("random", (0.561, 1.139))):
        error = placed(fit.x, poses[part]) - measured[part]
        assert size_mm(error) == pytest.approx(expected, abs=0.002)
