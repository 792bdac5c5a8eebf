"""Check the measured FANUC's kinematics and file against the published figures."""

from __future__ import annotations

import functools
from hashlib import sha256
from importlib.resources import files
from pathlib import Path

import numpy as np
import pinocchio as pin
import pytest
from scipy.optimize import nnls

from stiff_datasets.measured.fanuc_r2000ic import FanucR2000iC
from stiff_datasets.robots.shipped_robots import shipped_chain

HALF = np.pi / 2
TCP = (0.0069, 0.2453, 0.3193)  # m, flange frame, as published
DH_ROWS = [  # alpha(i-1), a(i-1), theta offset, d
    (0, 0, 0, 0.670),
    (-HALF, 0.312, -HALF, 0),
    (0, 1.075, 0, 0),
    (-HALF, 0.225, 0, 1.280),
    (HALF, 0, 0, 0),
    (-HALF, 0, 0, 0.215),
]
LINKS = np.array(  # mass kg, centre of mass in the frame of the link's row m, as published
    [
        (262.614, -0.0139, 0.0765, -0.1107),
        (156.154, 0.4248, 0.04287, 0.2163),
        (149.341, 0.1342, 0.2415, 0.0391),
        (10.190, 0.0, 0.0019, -0.1055),
        (17.698, 0.0, 0.0543, -0.0277),
        (41.450, 0.0005, -0.0336, 0.2654),
    ]
)
SHARED = Path(__file__).parents[4] / "shared" / "data" / "fanuc_r2000ic_sjtu"


def joint_frames(q):
    """Return joint origins (6, 3) and rotations (6, 3, 3) by the published rows."""
    pose, origins, rotations = np.eye(4), [], []
    for (alpha, a, offset, d), angle in zip(DH_ROWS, q, strict=True):
        ca, sa, ct, st = (f(x) for x in (alpha, angle + offset) for f in (np.cos, np.sin))
        pose = pose @ np.array(
            [
                [ct, -st, 0, a],
                [st * ca, ct * ca, -sa, -d * sa],
                [st * sa, ct * sa, ca, d * ca],
                [0, 0, 0, 1],
            ]
        )
        origins.append(pose[:3, 3].copy())
        rotations.append(pose[:3, :3].copy())
    return np.array(origins), np.array(rotations)


def dh_tcp(q):
    """Return the TCP by the published modified Denavit-Hartenberg rows, without a URDF."""
    origins, rotations = joint_frames(q)
    return origins[-1] + rotations[-1] @ TCP


def test_the_urdf_stands_where_the_published_rows_put_it(rng):
    chain = shipped_chain("fanuc_r2000ic", TCP)
    data = chain.model.createData()
    for q in rng.uniform(-3, 3, size=(50, 6)):
        pin.forwardKinematics(chain.model, data, q)
        for link, *frame in zip(list(data.oMi)[1:], *joint_frames(q), strict=True):
            for actual, expected in zip((link.translation, link.rotation), frame, strict=True):
                np.testing.assert_allclose(actual, expected, atol=1e-12)
        np.testing.assert_allclose(data.oMi[6].act(chain.robot.tcp), dh_tcp(q), atol=1e-12)


def weight_torque(q):
    """Return the joint torques of the published links' weight, (n, 6) N m."""
    torques = np.zeros(np.shape(q))
    for torque, joint_angles in zip(torques, q, strict=True):
        origins, rotations = joint_frames(joint_angles)
        for link, (mass, *centre) in enumerate(LINKS):
            mass_position = origins[link] + rotations[link] @ centre
            for joint in range(link + 1):
                moment = np.cross(mass_position - origins[joint], [0.0, 0.0, -9.81 * mass])
                torque[joint] += rotations[joint][:, 2] @ moment
    return torques


@functools.cache
def weight_of_the_samples():
    return weight_torque(FanucR2000iC().load().samples.q)


def test_its_weight_turns_the_joints_as_the_published_links_do(rng):
    q = rng.uniform(-3, 3, size=(20, 6))
    robot, chain = FanucR2000iC().load().robot, shipped_chain("fanuc_r2000ic", TCP)
    data = chain.model.createData()
    balancing_torques = [
        pin.computeGeneralizedGravity(chain.model, data, joint_angles).copy() for joint_angles in q
    ]
    np.testing.assert_allclose(weight_torque(q), np.negative(balancing_torques), atol=1e-8)
    np.testing.assert_allclose(weight_torque(q), robot.gravity_torque(q), atol=1e-8)


def test_limits_are_the_published_ones_except_joint_5_which_a_measured_pose_exceeds():
    data = FanucR2000iC().load()
    published = np.array([(-3.2, 3.2), (-1.0, 1.3), (-2.3, 3.0), (-6.2, 6.2), (-2, 2), (-6.2, 6.2)])
    joints = [0, 1, 2, 3, 5]
    limits = np.stack([data.robot.lower, data.robot.upper], axis=1)
    np.testing.assert_array_equal(limits[joints], published[joints])
    np.testing.assert_allclose(limits[4], np.deg2rad([-125, 125]))
    assert (data.samples.q[:, 4] > published[4, 1]).sum() == 1


def test_it_holds_the_43_measured_samples():
    samples = FanucR2000iC().load().samples
    force = np.linalg.norm(samples.wrench[:, :3], axis=1)
    size_mm = np.linalg.norm(samples.deflection, axis=1) * 1000
    assert len(samples) == 43
    assert (force.min(), force.max()) == pytest.approx((115.3, 1166.1), abs=0.1)
    assert (size_mm.min(), size_mm.max()) == pytest.approx((0.45, 3.66), abs=0.01)
    assert not samples.wrench[:, 3:].any()


def test_the_data_card_names_source_licence_and_checksum():
    folder = files("stiff_datasets") / "data"
    card = (folder / "fanuc_r2000ic.md").read_text()
    checksum = sha256((folder / "fanuc_r2000ic.csv").read_bytes()).hexdigest()
    facts = (checksum, "e5c2f795", "MIT", "(c) 2026 longton2001-pixel", "drill tip")
    assert all(fact in card for fact in facts)


@pytest.mark.skipif(not SHARED.is_dir(), reason="needs the original files")
def test_the_shipped_file_holds_the_original_numbers():
    samples = FanucR2000iC().load().samples
    angles, force, move = (
        np.loadtxt(SHARED / name, delimiter=",", skiprows=1)
        for name in ("joint_angles.csv", "forces.csv", "deltaX.csv")
    )
    r1, r2, r3, r4, r5, r6 = angles.T
    np.testing.assert_allclose(
        samples.q, np.stack([r1, r2, -(r2 + r3), -r4, -r5, -r6], axis=1), atol=2e-10
    )
    np.testing.assert_array_equal(samples.wrench[:, :3], force)
    np.testing.assert_allclose(samples.deflection, move, rtol=1e-12)
    links = np.loadtxt(SHARED / "fanuc_link_inertials.csv", delimiter=",", skiprows=1)
    np.testing.assert_array_equal(LINKS, links[:, 1:])


def rotation_effects(samples):
    """Return the TCP's motion by each joint-frame axis, and the torque about the axis.

    Axes x, y, z of joint 1, then of joint 2, ...; (n, 3, 18) m/rad and (n, 18) N m.
    """
    moves, torques = [], []
    for q, force in zip(samples.q, samples.wrench[:, :3], strict=True):
        origins, rotations = joint_frames(q)
        axes = rotations.transpose(0, 2, 1).reshape(18, 3)
        move = np.cross(axes, dh_tcp(q) - np.repeat(origins, 3, axis=0)).T
        moves.append(move)
        torques.append(move.T @ force)
    return np.array(moves), np.array(torques)


def six_springs(moves, torques, train):
    return moves[:, :, 2::3] * torques[:, None, 2::3]


def eighteen_rotational_springs(moves, torques, train):
    return moves * torques[:, None, :]


def two_segments_a_joint(moves, torques, train, weight=0.0):
    """Return the regressor of springs with two slopes per joint.

    The slope changes where |torque| passes the training part's 25 % quantile. With a weight,
    the quantile is of both torques' sum; the deflection under the weight is subtracted.
    """
    move, load, parts = moves[:, :, 2::3], torques[:, 2::3], 0.0
    loaded = weight + load
    bend = np.quantile(np.abs(loaded[train]), 0.25, axis=0)
    for torque, sign in ((loaded, 1.0), (weight, -1.0)):
        soft = np.clip(torque, -bend, bend)
        parts = parts + sign * np.concatenate([soft, torque - soft], axis=-1)
    return np.concatenate([move, move], axis=2) * parts[:, None]


def two_segments_a_joint_and_weight(moves, torques, train):
    return two_segments_a_joint(moves, torques, train, weight_of_the_samples())


@pytest.mark.parametrize(
    ("springs", "independent_mm"),
    [
        (six_springs, (0.211, 0.161, 0.130)),
        (eighteen_rotational_springs, (0.121, 0.136, 0.126)),
        (two_segments_a_joint, (0.205, 0.150, 0.129)),
        (two_segments_a_joint_and_weight, (0.202, 0.143, 0.128)),  # by this function only
    ],
)
def test_left_out_samples_are_predicted_as_well_as_independently_found(springs, independent_mm):
    samples = FanucR2000iC().load().samples
    moves, torques = rotation_effects(samples)
    errors = []
    for i in range(len(samples)):
        train = np.delete(np.arange(len(samples)), i)
        regressor = springs(moves, torques, train)
        rows = regressor[train].reshape(-1, regressor.shape[2])
        compliance, _ = nnls(rows, samples.deflection[train].reshape(-1))
        errors.append(np.abs(regressor[i] @ compliance - samples.deflection[i]))
    np.testing.assert_allclose(np.mean(errors, axis=0) * 1000, independent_mm, atol=0.002)


def test_least_squares_on_all_samples_gives_the_independent_stiffnesses():
    samples = FanucR2000iC().load().samples
    regressor = six_springs(*rotation_effects(samples), None).reshape(-1, 6)
    compliance = np.linalg.lstsq(regressor, samples.deflection.reshape(-1), rcond=None)[0]
    np.testing.assert_allclose(
        1 / compliance, [8.6e5, 2.7e6, 2.0e6, 2.7e5, 4.2e5, 2.1e5], rtol=0.03
    )
