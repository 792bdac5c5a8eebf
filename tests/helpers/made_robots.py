"""Robots of a test's own making."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np

from stiff_protocols.contract.types import FloatArray, JointType, Robot


def chain(name: str, kinds: Sequence[JointType], placements: FloatArray, **others: Any) -> Robot:
    """A robot without masses whose joints turn to 3 rad, where nothing else is said."""
    n = len(kinds)
    usual = {
        "joint_names": tuple(f"j{i + 1}" for i in range(n)),
        "lower": np.full(n, -3.0),
        "upper": np.full(n, 3.0),
        "masses": np.zeros(n),
        "centres_of_mass": np.zeros((n, 3)),
    }
    about = {"name": name, "joint_types": tuple(kinds), "placements": placements}
    return Robot(**(usual | about | others))


def random_chain(rng: np.random.Generator, kinds: tuple[JointType, ...]) -> Robot:
    """A chain with joints of these kinds, whose axes and offsets lie anyhow."""
    n = len(kinds)
    placements = np.tile(np.eye(4), (n, 1, 1))
    placements[:, :3, 3] = rng.normal(size=(n, 3))
    placements[:, :3, :3] = [np.linalg.qr(rng.normal(size=(3, 3)))[0] for _ in range(n)]
    placements[:, :3, :3] *= np.linalg.det(placements[:, :3, :3])[:, None, None]
    axes = rng.normal(size=(n, 3))
    axes /= np.linalg.norm(axes, axis=1, keepdims=True)
    return chain("chain", kinds, placements, axes=axes, tcp=rng.normal(size=3))


def planar_arm(n_joints: int, axis: tuple[float, float, float], mass: float = 0.0) -> Robot:
    """Links of 1 m along x that turn about `axis`, each link's mass [kg] at its end."""
    placements = np.tile(np.eye(4), (n_joints, 1, 1))
    placements[1:, 0, 3] = 1.0
    along = np.array([1.0, 0.0, 0.0])
    return chain(
        "planar",
        ("revolute",) * n_joints,
        placements,
        axes=np.tile(axis, (n_joints, 1)),
        lower=np.full(n_joints, -np.pi),
        upper=np.full(n_joints, np.pi),
        masses=np.full(n_joints, mass),
        centres_of_mass=np.tile(along, (n_joints, 1)),
        tcp=along,
    )


def seven_joint_arm() -> Robot:
    """An arm with the lengths of a KUKA LBR iiwa 7 and a marker beside its flange."""
    n = 7
    placements = np.tile(np.eye(4), (n, 1, 1))
    placements[:, 2, 3] = (0.15, 0.19, 0.21, 0.19, 0.21, 0.19, 0.081)
    along, across = (0.0, 0.0, 1.0), (0.0, 1.0, 0.0)
    limits = np.deg2rad([170.0, 120.0, 170.0, 120.0, 170.0, 120.0, 175.0])
    return chain(
        "seven",
        ("revolute",) * n,
        placements,
        joint_names=tuple(f"J{i + 1}" for i in range(n)),
        axes=np.array([along, across, along, across, along, across, along]),
        lower=-limits,
        upper=limits,
        masses=np.full(n, 3.0),
        tcp=np.array([0.05, 0.02, 0.12]),
    )
