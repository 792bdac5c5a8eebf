"""A path of the tool under its process load, and shapes for tests of accuracy."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from stiff_protocols.contract.arrays import FloatArray, IntArray, freeze, frozen_array
from stiff_protocols.contract.display import BriefFields
from stiff_protocols.contract.errors import DataError

SAME_ROTATION = 1e-6
"""How far a rotation's product with its transpose may be from the unit matrix."""


@dataclass(frozen=True, eq=False, repr=False)
class ToolPath(BriefFields):
    """Poses of the tool in their order, each with its load.

    Attributes:
        name: of the path.
        position: (n, 3) TCP, base frame, m.
        rotation: (n, 3, 3) orientation of the last joint's frame, base frame, which is the
            `rotation` of `Robot.forward`.
        wrench: (n, 6) that the process exerts at the TCP, N and N m, base frame.
    """

    name: str
    position: FloatArray
    rotation: FloatArray
    wrench: FloatArray

    def __post_init__(self) -> None:
        n = len(self.position)
        freeze(self, position=(n, 3), rotation=(n, 3, 3), wrench=(n, 6))
        if n == 0:
            raise DataError(f"path {self.name!r} has no points")
        gram = self.rotation @ self.rotation.transpose(0, 2, 1)
        turns = np.abs(gram - np.eye(3)).max(axis=(1, 2)) < SAME_ROTATION
        turns &= np.linalg.det(self.rotation) > 0.0
        if not turns.all():
            row = int(np.argmin(turns))
            raise DataError(f"path {self.name!r}: rotation[{row}] is not a rotation matrix")

    def __len__(self) -> int:
        return len(self.position)

    def take(self, rows: IntArray | slice) -> ToolPath:
        """Return the points of the given row numbers, in that order."""
        return ToolPath(self.name, self.position[rows], self.rotation[rows], self.wrench[rows])


def shaped(
    shape: str,
    centre: ArrayLike,
    size: float,
    n_points: int,
    *,
    rotation: ArrayLike,
    wrench: ArrayLike,
) -> ToolPath:
    """Return a path of one of the `SHAPES`, along the axes of the base.

    Args:
        shape: its name.
        centre: (3,) base frame, m.
        size: edge, diameter or length, m; of iso9283 the edge of the cube.
        n_points: at least one a corner; every corner is a point, those between lie at almost
            equal distances.
        rotation: (3, 3) orientation of the last joint's frame, held along the path.
        wrench: (6,), or (n_points, 6), at the TCP, N and N m, base frame.
    """
    if not (np.isfinite(size) and size > 0.0):
        raise DataError(f"{shape}: size is {size:g}, expected m, above 0")
    outline = _outline(shape, n_points)
    n = len(outline)
    return ToolPath(
        shape,
        frozen_array(centre, "centre", (3,)) + size * outline,
        np.broadcast_to(frozen_array(rotation, "rotation", (3, 3)), (n, 3, 3)),
        np.broadcast_to(np.asarray(wrench, dtype=np.float64), (n, 6)),
    )


SHAPES: Mapping[str, Sequence[Sequence[float]]] = {
    "square": ((-0.5, -0.5, 0), (0.5, -0.5, 0), (0.5, 0.5, 0), (-0.5, 0.5, 0), (-0.5, -0.5, 0)),
    "circle": (),
    "line": ((-0.5, 0, 0), (0.5, 0, 0)),
    "iso9283": (
        *((0, 0, 0), (0.4, -0.4, -0.4), (0.4, 0.4, 0.4)),
        *((-0.4, 0.4, 0.4), (-0.4, -0.4, -0.4), (0, 0, 0)),
    ),
}
"""Name of a shape -> its corners at size 1; none of a circle.

iso9283 passes the five test points of ISO 9283, which lie in a diagonal plane of a cube along the
axes of the base: P1 in the middle, P2 to P5 a tenth of the plane's diagonal from its corners. The
path is P1, P2, P3, P4, P5 and P1 again; the standard's cycle drives from point to point.
"""


def _outline(shape: str, n_points: int) -> FloatArray:
    """Return the (n_points, 3) outline of size 1; straight from corner to corner."""
    corners = np.array(SHAPES[shape], dtype=np.float64)
    least = len(corners) or 4
    if n_points < least:
        raise DataError(f"{n_points} points, expected at least {least} of this shape")
    if not len(corners):
        angle = np.linspace(0.0, 2.0 * np.pi, n_points)
        return 0.5 * np.stack([np.cos(angle), np.sin(angle), 0.0 * angle], axis=1)
    lengths = np.linalg.norm(np.diff(corners, axis=0), axis=1)
    reached = np.r_[0.0, np.cumsum(lengths)] / lengths.sum()
    at = np.rint(reached * (n_points - 1))  # number of each corner's point
    return np.stack([np.interp(np.arange(n_points), at, axis) for axis in corners.T], axis=1)
