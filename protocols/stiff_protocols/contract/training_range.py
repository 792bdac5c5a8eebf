"""Where a model has learned: predictions far outside of it are a guess, and are marked."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from stiff_protocols.contract.arrays import FloatArray
from stiff_protocols.contract.types import Samples

MARGIN, LEAST_MARGIN = 0.1, 0.01
"""Part of a joint's training range, or of the largest training load, that is still inside; and rad
or m, for a joint that hardly moved."""


@dataclass(frozen=True, eq=False)
class TrainingRange:
    """Joint positions and loads of the samples that a model learned from.

    Attributes:
        lower: (n_joints,) smallest joint positions, rad or m.
        upper: (n_joints,) largest ones.
        force: the largest one, N.
        torque: the largest one about the TCP, N m.
    """

    lower: FloatArray
    upper: FloatArray
    force: float
    torque: float

    @classmethod
    def of(cls, samples: Samples) -> TrainingRange:
        """Return the range of some samples, at least one."""
        force, torque = _lengths(samples.wrench).max(axis=0)
        return cls(samples.q.min(axis=0), samples.q.max(axis=0), float(force), float(torque))

    def outside(self, q: FloatArray, wrench: FloatArray) -> list[str]:
        """Say for each row what lies far outside, such as "q3 force"; "" where nothing does.

        A joint does where it is more than a tenth of its training range beyond that (at least
        0.01 rad or m); force and torque do where they are more than a tenth larger than the
        largest in training.

        Args:
            q: (n, n_joints) rad or m.
            wrench: (n, 6) N and N m at the TCP, base frame.
        """
        room = np.maximum(MARGIN * (self.upper - self.lower), LEAST_MARGIN)
        far = (q < self.lower - room) | (q > self.upper + room)
        largest = np.array([self.force, self.torque])
        heavy = _lengths(wrench) > (1.0 + MARGIN) * largest
        names = [*(f"q{joint + 1}" for joint in range(q.shape[1])), "force", "torque"]
        return [
            " ".join(name for name, is_far in zip(names, row, strict=True) if is_far)
            for row in np.hstack([far, heavy])
        ]


def _lengths(wrench: FloatArray) -> FloatArray:
    """Return (n, 2) lengths of forces and torques."""
    return np.asarray(np.linalg.norm(wrench.reshape(-1, 2, 3), axis=2))
