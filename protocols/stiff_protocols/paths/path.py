"""A path of the tool under its process load, and the shapes that tests of accuracy drive."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from stiff_protocols.contract.arrays import FloatArray, IntArray, frozen_array
from stiff_protocols.contract.errors import DataError

SAME_ROTATION = 1e-6
"""How far a rotation's product with its transpose may be from the unit matrix."""


@dataclass(frozen=True, eq=False)
class ToolPath:
    """Poses of the tool in the order in which it takes them, each under its load.

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
        """Freeze and check every array."""
        n = len(self.position)
        for name, shape in {"position": (n, 3), "rotation": (n, 3, 3), "wrench": (n, 6)}.items():
            object.__setattr__(self, name, frozen_array(getattr(self, name), name, shape))
        if n == 0:
            raise DataError(f"path {self.name!r} has no points")
        gram = self.rotation @ self.rotation.transpose(0, 2, 1)
        turns = np.abs(gram - np.eye(3)).max(axis=(1, 2)) < SAME_ROTATION
        if not (turns & (np.linalg.det(self.rotation) > 0.0)).all():
            row = int(np.argmin(turns & (np.linalg.det(self.rotation) > 0.0)))
            raise DataError(f"path {self.name!r}: rotation[{row}] is no rotation matrix")

    def __len__(self) -> int:
        """Return the number of points."""
        return len(self.position)

    def take(self, rows: IntArray | slice) -> ToolPath:
        """Return the points of the given row numbers, in that order."""
        return ToolPath(self.name, self.position[rows], self.rotation[rows], self.wrench[rows])


def square(
    centre: ArrayLike,
    size: float,
    n_points: int,
    *,
    rotation: ArrayLike,
    wrench: ArrayLike,
    plane: ArrayLike | None = None,
) -> ToolPath:
    """Return a square from one corner round to it again.

    Args:
        centre: (3,) base frame, m.
        size: length of an edge, m.
        n_points: at least one a corner; every corner is a point, those between lie at almost
            equal distances.
        rotation: (3, 3) orientation of the last joint's frame, held along the path.
        wrench: (6,), or (n_points, 6), at the TCP, N and N m, base frame.
        plane: (3, 3) rotation whose first two columns span the plane, base frame; None: the
            horizontal one.
    """
    corners = 0.5 * np.array([[-1, -1, 0], [1, -1, 0], [1, 1, 0], [-1, 1, 0], [-1, -1, 0]])
    return _placed("square", _along(corners, n_points), centre, size, rotation, wrench, plane)


def circle(
    centre: ArrayLike,
    size: float,
    n_points: int,
    *,
    rotation: ArrayLike,
    wrench: ArrayLike,
    plane: ArrayLike | None = None,
) -> ToolPath:
    """Return a circle of diameter `size`, closed; arguments as `square`."""
    angle = np.linspace(0.0, 2.0 * np.pi, _enough(n_points, 4))
    outline = 0.5 * np.stack([np.cos(angle), np.sin(angle), 0.0 * angle], axis=1)
    return _placed("circle", outline, centre, size, rotation, wrench, plane)


def line(
    centre: ArrayLike,
    size: float,
    n_points: int,
    *,
    rotation: ArrayLike,
    wrench: ArrayLike,
    plane: ArrayLike | None = None,
) -> ToolPath:
    """Return a straight line of length `size` along the plane's first axis; see `square`."""
    ends = 0.5 * np.array([[-1, 0, 0], [1, 0, 0]])
    return _placed("line", _along(ends, n_points), centre, size, rotation, wrench, plane)


def iso9283(
    centre: ArrayLike,
    size: float,
    n_points: int,
    *,
    rotation: ArrayLike,
    wrench: ArrayLike,
    plane: ArrayLike | None = None,
) -> ToolPath:
    """Return straight lines through the five test points of ISO 9283; arguments as `square`.

    They lie in a diagonal plane of a cube with edges of `size` along the axes of `plane`: P1 in the
    middle, P2 to P5 a tenth of the plane's diagonal from its corners. The path is P1, P2, P3, P4,
    P5 and P1 again. The standard's cycle has the same points; it drives from point to point.
    """
    x, yz = 0.4, 0.4
    corners = [[x, -yz, -yz], [x, yz, yz], [-x, yz, yz], [-x, -yz, -yz]]
    points = np.array([[0.0, 0.0, 0.0], *corners, [0.0, 0.0, 0.0]])
    return _placed("iso9283", _along(points, n_points), centre, size, rotation, wrench, plane)


SHAPES = {shape.__name__: shape for shape in (square, circle, line, iso9283)}
"""Name of a shape -> what makes it."""


def _enough(n_points: int, least: int) -> int:
    if n_points < least:
        raise DataError(f"{n_points} points, expected at least {least} of this shape")
    return n_points


def _along(corners: FloatArray, n_points: int) -> FloatArray:
    """Return (n_points, 3) straight from corner to corner, each of which is a point."""
    lengths = np.linalg.norm(np.diff(corners, axis=0), axis=1)
    reached = np.r_[0.0, np.cumsum(lengths)] / lengths.sum()
    at = np.rint(reached * (_enough(n_points, len(corners)) - 1))  # number of each corner's point
    points = np.arange(n_points)
    return np.stack([np.interp(points, at, axis) for axis in corners.T], axis=1)


def _placed(
    name: str,
    outline: FloatArray,
    centre: ArrayLike,
    size: float,
    rotation: ArrayLike,
    wrench: ArrayLike,
    plane: ArrayLike | None,
) -> ToolPath:
    """Return an (n, 3) outline of size 1 as a path."""
    if not (np.isfinite(size) and size > 0.0):
        raise DataError(f"{name}: size is {size:g}, expected m, above 0")
    n = len(outline)
    axes = np.eye(3) if plane is None else frozen_array(plane, "plane", (3, 3))
    return ToolPath(
        name,
        frozen_array(centre, "centre", (3,)) + size * outline @ axes.T,
        np.broadcast_to(frozen_array(rotation, "rotation", (3, 3)), (n, 3, 3)),
        np.broadcast_to(np.asarray(wrench, dtype=np.float64), (n, 6)),
    )
