"""Robots of a test's own making."""

from __future__ import annotations

import numpy as np

from stiff_protocols.contract.types import JointType, Robot


def random_chain(rng: np.random.Generator, kinds: tuple[JointType, ...]) -> Robot:
    """A chain with joints of these kinds, whose axes and offsets lie anyhow."""
    n = len(kinds)
    placements = np.tile(np.eye(4), (n, 1, 1))
    placements[:, :3, 3] = rng.normal(size=(n, 3))
    placements[:, :3, :3] = [np.linalg.qr(rng.normal(size=(3, 3)))[0] for _ in range(n)]
    placements[:, :3, :3] *= np.linalg.det(placements[:, :3, :3])[:, None, None]
    axes = rng.normal(size=(n, 3))
    return Robot(
        name="chain",
        joint_names=tuple(f"j{i}" for i in range(n)),
        joint_types=kinds,
        placements=placements,
        axes=axes / np.linalg.norm(axes, axis=1, keepdims=True),
        lower=np.full(n, -3.0),
        upper=np.full(n, 3.0),
        masses=np.zeros(n),
        centres_of_mass=np.zeros((n, 3)),
        tcp=rng.normal(size=3),
    )
