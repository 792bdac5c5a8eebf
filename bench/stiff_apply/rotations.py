"""Convert between rotation matrices and the orientations of robot controllers."""

from __future__ import annotations

import warnings
from typing import Literal

import numpy as np
from scipy.spatial.transform import Rotation

from stiff_protocols.contract.types import FloatArray

Order = Literal["ZYX", "xyz"]


def euler_rotations(order: Order, angles: FloatArray) -> FloatArray:
    """Return (n, 3, 3) rotations of (n, 3) angles, deg; `order` as in scipy's Rotation."""
    return np.asarray(Rotation.from_euler(order, angles, degrees=True).as_matrix())


def euler_angles(order: Order, rotations: FloatArray) -> FloatArray:
    """Return (n, 3) angles, deg, of rotations; the third is zero if only a sum is defined."""
    with warnings.catch_warnings():
        warnings.filterwarnings("ignore", "Gimbal lock")
        return np.asarray(Rotation.from_matrix(rotations).as_euler(order, degrees=True))


def quaternion_rotations(quaternions: FloatArray) -> FloatArray:
    """Return (n, 3, 3) rotations of (n, 4) quaternions, w first, of any length."""
    return np.asarray(Rotation.from_quat(quaternions, scalar_first=True).as_matrix())


def quaternions(rotations: FloatArray) -> FloatArray:
    """Return (n, 4) unit quaternions, w first and not negative."""
    turns = Rotation.from_matrix(rotations).as_quat(canonical=True, scalar_first=True)
    return np.asarray(turns)


def vector_rotations(vectors: FloatArray) -> FloatArray:
    """Return (n, 3, 3) rotations of (n, 3) rotation vectors, rad."""
    return np.asarray(Rotation.from_rotvec(vectors).as_matrix())
