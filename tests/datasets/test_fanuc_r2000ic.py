"""The measured FANUC: its kinematics, its file, and the published figures it must give."""

from __future__ import annotations

from hashlib import sha256
from importlib.resources import files
from pathlib import Path

import numpy as np
import pinocchio as pin
import pytest

from stiff_datasets.fanuc_r2000ic import CSV_SHA256, TCP, FanucR2000iC
from stiff_datasets.robots.robot import shipped_chain

HALF = np.pi / 2
DH_ROWS = [  # alpha(i-1), a(i-1), theta offset, d
    (0, 0, 0, 0.670),
    (-HALF, 0.312, -HALF, 0),
    (0, 1.075, 0, 0),
    (-HALF, 0.225, 0, 1.280),
    (HALF, 0, 0, 0),
    (-HALF, 0, 0, 0.215),
]
SHARED = Path(__file__).parents[3] / "shared" / "data" / "fanuc_r2000ic_sjtu"


def dh_tcp(q):
    """The TCP by the published modified Denavit-Hartenberg rows, without a URDF."""
    pose = np.eye(4)
    for (alpha, a, offset, d), angle in zip(DH_ROWS, q, strict=True):
        ca, sa, ct, st = (
            np.cos(alpha),
            np.sin(alpha),
            np.cos(angle + offset),
            np.sin(angle + offset),
        )
        pose = pose @ np.array(
            [
                [ct, -st, 0, a],
                [st * ca, ct * ca, -sa, -d * sa],
                [st * sa, ct * sa, ca, d * ca],
                [0, 0, 0, 1],
            ]
        )
    return pose[:3, :3] @ np.array(TCP) + pose[:3, 3]


def test_the_urdf_stands_where_the_published_rows_put_it(rng):
    chain = shipped_chain("fanuc_r2000ic", tcp=TCP)
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
    for fact in (
        CSV_SHA256,
        "e5c2f795",
        "MIT",
        "Copyright (c) 2026 longton2001-pixel",
        "drill tip",
    ):
        assert fact in card


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
