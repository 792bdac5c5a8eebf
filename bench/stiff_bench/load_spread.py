"""How loads lie in space: along a line, in a plane or over the whole sphere.

A network that is trained on loads of one direction knows nothing about the others, so a data set
says how its loads lie.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from stiff_protocols.types import FloatArray

COUNTING_SHARE = 0.05
"""A principal axis counts when it holds this share of the vectors' squared length. Directions
spread evenly within 26 degrees of a line then lie along it, within 22 degrees of a plane in it."""
ONE_SIDED = 0.4
"""Length of the mean of unit vectors: 1 for one direction, 0.64 for half a circle, 0.5 for half
a sphere; 0 for a whole circle or sphere and for both ways of a line."""
NO_SCATTER = 0.01
"""Vectors that scatter about their mean by less than this share of their own size are one."""


@dataclass(frozen=True)
class Spread:
    """How vectors lie in space.

    Attributes:
        shares: of the squared length along the three principal axes, largest first: the squared
            singular values of the (n, 3) matrix of vectors over their sum; zeros if there is
            nothing to spread.
        resultant: length of the mean of the unit vectors; None for vectors about their mean.
    """

    shares: tuple[float, ...]
    resultant: float | None

    @property
    def dimensions(self) -> int:
        """Number of principal axes that hold at least `COUNTING_SHARE`."""
        return sum(share >= COUNTING_SHARE for share in self.shares)

    @property
    def text(self) -> str:
        """The spread in words."""
        if self.dimensions == 0:
            return "all the same" if self.resultant is None else "none"
        if self.resultant is None:
            return ("along a line", "in a plane", "in all three dimensions")[self.dimensions - 1]
        one_sided = (
            "along a line, one way",
            "in a plane, on one side",
            "over one side of the sphere",
        )
        all_round = ("along a line, both ways", "in a plane, all round", "over the whole sphere")
        words = one_sided if self.resultant >= ONE_SIDED else all_round
        return words[self.dimensions - 1]


def directions(vectors: FloatArray) -> Spread:
    """Return how the directions of (n, 3) vectors lie; vectors of length zero have none."""
    length = np.linalg.norm(vectors, axis=1)
    unit = vectors[length > 0.0] / length[length > 0.0, None]
    if len(unit) == 0:
        return Spread((0.0, 0.0, 0.0), 0.0)
    return Spread(_shares(unit), float(np.linalg.norm(unit.mean(axis=0))))


def about_mean(vectors: FloatArray) -> Spread:
    """Return how (n, 3) vectors lie about their mean."""
    centred = vectors - vectors.mean(axis=0)
    if np.linalg.norm(centred) <= NO_SCATTER * np.linalg.norm(vectors):
        return Spread((0.0, 0.0, 0.0), None)
    return Spread(_shares(centred), None)


def _shares(vectors: FloatArray) -> tuple[float, ...]:
    squared = np.linalg.eigvalsh(vectors.T @ vectors)[::-1].clip(min=0.0)  # (3,) singular values^2
    return tuple(float(share) for share in squared / squared.sum())
