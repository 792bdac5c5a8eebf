"""Draw loads on a robot: along the line of the paper's Table 5, or at a hook.

Table 5's wrenches lie nearly on one line in wrench space. A single cable cannot produce their
torques. A force F on a lever r gives r x F, perpendicular to F, but the table's first row has
F . T = 1360. Such loads need two cables, or a weight off the cable's line. `line_wrenches` draws
them; `hook_wrenches` represents one cable on one hook.
"""

from __future__ import annotations

from hashlib import sha256
from typing import Literal

import numpy as np

from stiff_protocols.contract.robot import STANDARD_GRAVITY
from stiff_protocols.contract.types import FloatArray


def stream(*words: str | int) -> np.random.Generator:
    """Return a random generator for the words, identical on every machine.

    Generators of different words are independent. So two data sets with the same seed do not share
    loads, noise or specimens, and a comparison over data sets counts no draw twice. A word must not
    contain a slash.
    """
    digest = sha256("/".join(map(str, words)).encode()).digest()
    return np.random.default_rng(int.from_bytes(digest, "little"))


LoadKind = Literal["line", "line-hook", "omni"]
"""line: force and torque along Table 5's line; line-hook: forces along this line, at a hook; omni:
forces in every direction, at a hook."""

TABLE_5 = np.array(  # source paper: Fx, Fy, Fz in N, Ta, Tb, Tc in N m
    [
        [100.0, 40.0, -20.0, 10.0, 10.0, 2.0],
        [80.0, 30.0, -40.0, 8.0, 8.0, 1.0],
        [60.0, 20.0, -60.0, 6.0, 6.0, 0.0],
        [40.0, 10.0, -80.0, 4.0, 4.0, -1.0],
        [20.0, 5.0, -100.0, 2.0, 2.0, -2.0],
    ]
)
TABLE_5_PAYLOAD_KG = 10.0
SCATTER = 0.05
"""Scatter per component of the line's loads: 5 N of 100 N, 0.5 N m of 10 N m; assumption."""
MIN_LOAD_SHARE = 0.2  # of the payload; deflections by smaller loads are below the tracker's noise


def line_wrenches(n: int, payload_kg: float, rng: np.random.Generator) -> FloatArray:
    """Return (n, 6) wrenches [N, N m] along Table 5's line with scatter, within the payload.

    The line is scaled by the payload over the 10 kg of the table's robot.
    """
    scale = payload_kg / TABLE_5_PAYLOAD_KG
    row = rng.uniform(0, len(TABLE_5) - 1, size=n)
    wrench = np.stack([np.interp(row, range(len(TABLE_5)), column) for column in TABLE_5.T], axis=1)
    wrench += rng.normal(size=wrench.shape) * SCATTER * np.repeat([100.0, 10.0], 3)
    wrench *= scale
    size = np.linalg.norm(wrench[:, :3], axis=1, keepdims=True)
    return np.asarray(wrench * np.minimum(1.0, payload_kg * STANDARD_GRAVITY / size))


def omni_forces(
    n: int, payload_kg: float, rng: np.random.Generator, max_share: float = 1.0
) -> FloatArray:
    """Return (n, 3) forces [N] in all directions, a fifth to `max_share` of the payload."""
    direction = rng.normal(size=(n, 3))
    size = rng.uniform(MIN_LOAD_SHARE, max_share, size=(n, 1)) * payload_kg * STANDARD_GRAVITY
    return np.asarray(direction / np.linalg.norm(direction, axis=1, keepdims=True) * size)


def hook_wrenches(force: FloatArray, lever: FloatArray) -> FloatArray:
    """Return the (n, 6) wrenches at the TCP of (n, 3) `force` [N] on (n, 3) `lever` [m]."""
    return np.hstack([force, np.cross(lever, force)])
