"""Where a model has learned: predictions far beyond it are a guess, and are marked."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from stiff_protocols.contract.arrays import FloatArray, freeze, frozen_array
from stiff_protocols.contract.errors import DataError
from stiff_protocols.contract.types import BoolArray, Interval, Samples

MARGIN = 0.1
"""Part of a quantity's training range that still counts as inside beyond its ends: a robot at work
never repeats them to the digit."""
LEAST_MARGIN, LEAST_FORCE, LEAST_TORQUE = 0.01, 0.1, 0.01
"""The least margin, rad or m, N, N m: for a joint that hardly moved and a load that was none."""


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

    def __post_init__(self) -> None:
        freeze(self, lower=(None,), upper=(None,))
        loads = frozen_array([self.force, self.torque], "largest force and torque", (2,))
        if self.lower.shape != self.upper.shape or (self.lower > self.upper).any():
            raise DataError("a training range's lower ends lie above its upper ends")
        if (loads < 0.0).any():
            raise DataError(f"a training range's largest loads are {loads}, expected >= 0")

    @classmethod
    def of(cls, samples: Samples) -> TrainingRange:
        """Return the range of some samples, at least one."""
        force, torque = _lengths(samples.wrench).max(axis=0)
        return cls(samples.q.min(axis=0), samples.q.max(axis=0), float(force), float(torque))

    @property
    def ends(self) -> tuple[FloatArray, FloatArray]:
        """Lower and upper ends of `quantities`, (n_joints + 2,) each; loads begin at zero."""
        return np.r_[self.lower, 0.0, 0.0], np.r_[self.upper, self.force, self.torque]

    @staticmethod
    def quantities(q: FloatArray, wrench: FloatArray) -> FloatArray:
        """Return (n, n_joints + 2): joint positions, then lengths of force and torque.

        Args:
            q: (n, n_joints) rad or m.
            wrench: (n, 6) N and N m at the TCP, base frame.
        """
        return np.hstack([q, _lengths(wrench)])

    def beyond(self, q: FloatArray, wrench: FloatArray) -> BoolArray:
        """Return (n, n_joints + 2) which `quantities` lie beyond, by the rule of `extrapolates`.

        DataError: `q` has another number of joints.
        """
        if q.shape[1] != len(self.lower):
            raise DataError(f"a training range of {len(self.lower)} joints, q has {q.shape[1]}")
        return self.are_beyond(self.quantities(q, wrench))

    def are_beyond(self, values: FloatArray) -> BoolArray:
        """Return (n, n_joints + 2) which `quantities` lie beyond."""
        lower, upper = self.ends
        least = np.r_[np.full(len(self.lower), LEAST_MARGIN), LEAST_FORCE, LEAST_TORQUE]
        room = np.maximum(MARGIN * (upper - lower), least)
        return np.asarray((values < lower - room) | (values > upper + room))

    def widened(
        self,
        within: Callable[[FloatArray, FloatArray], Interval],
        q: FloatArray,
        wrench: FloatArray,
    ) -> Interval:
        """Return intervals around predictions, wider where these extrapolate.

        Under r times the training load the prediction at the same pose under a load r times as
        small is known. Deflections grow as loads do, so r times that interval holds as often as
        it does itself; the interval returned reaches as far. Beyond the training positions
        it is wider by its own width a radian or metre of the joint that is farthest out.

        Args:
            within: the interval of (n, n_joints) q and (n, 6) wrench, its middle the prediction.
            q: (n, n_joints) rad or m.
            wrench: (n, 6) N and N m at the TCP, base frame.
        """
        found = within(q, wrench)
        # the size of a load: its torque counts as a force at a lever of 1 m
        load = np.maximum(_lengths(wrench).sum(axis=1) / max(self.force + self.torque, 1e-9), 1.0)
        outside = np.maximum(self.lower - q, q - self.upper).max(axis=1, initial=0.0)
        far = (load > 1.0) | (outside > 0.0)
        if not far.any():
            return found
        lower, upper = found.lower.copy(), found.upper.copy()
        middle, half = _middle_and_half(found)
        load, outside = load[far, None], outside[far, None]
        below, reach = _middle_and_half(within(q[far], wrench[far] / load))
        reach = (load * reach + np.abs(middle[far] - load * below)) * (1.0 + outside)
        reach = np.maximum(reach, half[far])
        lower[far], upper[far] = middle[far] - reach, middle[far] + reach
        return Interval(lower, upper, found.coverage)

    def extrapolates(self, q: FloatArray, wrench: FloatArray) -> list[str]:
        """Say for each row what lies beyond: "joints", "load", "joints load"; "" where nothing.

        A joint does where it is beyond its smallest or largest training position by more than a
        tenth of the span between them (at least 0.01 rad or m). A load does where the length of
        its force or torque is more than a tenth above the largest in training (at least 0.1 N or
        0.01 N m). Angles count as they stand (350 deg is not -10 deg: not every model is
        periodic); directions of loads and gaps between the training poses are not looked at.
        Arguments as of `quantities`.
        """
        far = self.beyond(q, wrench)
        return [
            " ".join(["joints"] * bool(row[:-2].any()) + ["load"] * bool(row[-2:].any()))
            for row in far
        ]


def _middle_and_half(interval: Interval) -> tuple[FloatArray, FloatArray]:
    return (interval.lower + interval.upper) / 2.0, (interval.upper - interval.lower) / 2.0


def _lengths(wrench: FloatArray) -> FloatArray:
    """Return (n, 2) lengths of forces and torques."""
    return np.asarray(np.linalg.norm(wrench.reshape(-1, 2, 3), axis=2))
