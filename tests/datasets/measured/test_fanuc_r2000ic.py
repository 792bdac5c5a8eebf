"""The measured FANUC: its kinematics, its file, and the published figures it must give."""

from __future__ import annotations

from hashlib import sha256
from importlib.resources import files
from pathlib import Path

import numpy as np
import pinocchio as pin
import pytest
from scipy.optimize import nnls

from stiff_datasets.measured.fanuc_r2000ic import CSV_SHA256, FanucR2000iC
from stiff_datasets.robots.shipped import named_robot

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
SHARED = Path(__file__).parents[4] / "shared" / "data" / "fanuc_r2000ic_sjtu"


def joint_frames(q):
    """Origins (6, 3) and rotations (6, 3, 3) of the joints by the published rows."""
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
    """The TCP by the published modified Denavit-Hartenberg rows, without a URDF."""
    origins, rotations = joint_frames(q)
    return origins[-1] + rotations[-1] @ TCP


def test_the_urdf_stands_where_the_published_rows_put_it(rng):
    chain = named_robot("fanuc-r2000ic").chain()
    data = chain.model.createData()
    for q in rng.uniform(-3, 3, size=(50, 6)):
        pin.forwardKinematics(chain.model, data, q)
        np.testing.assert_allclose(data.oMi[6].act(chain.tcp), dh_tcp(q), atol=1e-12)


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
    assert sha256((folder / "fanuc_r2000ic.csv").read_bytes()).hexdigest() == CSV_SHA256
    facts = (CSV_SHA256, "e5c2f795", "MIT", "(c) 2026 longton2001-pixel", "drill tip")
    assert all(fact in card for fact in facts)


@pytest.mark.skipif(not SHARED.is_dir(), reason="the original files are not beside this checkout")
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


def rotation_effects(samples):
    """Per sample: how each of the 18 joint-frame axes moves the TCP, and the torque about it.

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


def two_segments_a_joint(moves, torques, train):
    """The angle's slope changes where |torque| passes the training part's 25 % quantile."""
    move, torque = moves[:, :, 2::3], torques[:, 2::3]
    size, bend = np.abs(torque), np.quantile(np.abs(torque[train]), 0.25, axis=0)
    soft = np.sign(torque) * np.minimum(size, bend)
    effects = [move * soft[:, None], move * (torque - soft)[:, None]]
    return np.concatenate(effects, axis=2)


@pytest.mark.parametrize(
    ("springs", "independent_mm"),
    [
        (six_springs, (0.211, 0.161, 0.130)),
        (eighteen_rotational_springs, (0.121, 0.136, 0.126)),
        (two_segments_a_joint, (0.205, 0.150, 0.129)),
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
