"""Check the UR5's description against the published rows, limits, efforts and masses."""

from __future__ import annotations

import numpy as np
import pinocchio as pin

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
    """Return the flange by the published distal Denavit-Hartenberg rows."""
    pose = np.eye(4)
    for row, angle in zip(DH_ROWS, q, strict=True):
        pose = pose @ dh_step(row, angle)
    return pose


def flange_poses(angles):
    """Return the flange's poses by the shipped URDF, (n, 4, 4)."""
    model = shipped_chain("ur5", (0, 0, 0)).model
    data, flange = model.createData(), model.getFrameId("flange")
    poses = []
    for q in angles:
        pin.framesForwardKinematics(model, data, q)
        poses.append(data.oMf[flange].homogeneous)
    return np.stack(poses)


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
