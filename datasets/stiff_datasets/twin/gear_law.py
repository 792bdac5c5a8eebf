"""Model the torsion of gears: a curve without memory, and plays that remember the last motion.

theta = e(tau) + sum_i w_i p_i, where p_i is the play operator of threshold r_i: p_i stays while
|tau - p_i| < r_i (L. Prandtl 1928, A. Ishlinskii 1944; M. A. Krasnosel'skii and A. V. Pokrovskii,
Systems with Hysteresis, 1989, chapter 2). After a reversal a gear sticks first. The work over a
closed cycle is sum_i w_i r_i times the path of p_i, so it is never negative.

rad, N m, rad/(N m). The first axis of an array is the segment of the curve, or the play; further
axes are joints and samples, and broadcast.
"""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from typing import Self

import numpy as np

from stiff_protocols.contract.errors import DataError
from stiff_protocols.contract.types import FloatArray

THRESHOLDS = (0.02, 0.05, 0.1, 0.2, 0.4)
"""Thresholds of the plays, as shares of the rated torque; weights are proportional to them."""
LOST_MOTION_SHARE = 0.03
"""Share of the rated torque within which lost motion is taken up."""
NO_PLAYS = np.zeros(0)


@dataclass(frozen=True, eq=False)
class GearLaw:
    """The torsion of one or many gears, with everything in series.

    Attributes:
        compliance: (3, ...) slopes of a monotone load after all plays have slipped, rad/(N m).
        breakpoints: (2, ...) torques between the slopes, N m.
        lost_motion: (...) full width of the lost motion without memory, rad.
        lost_motion_torque: (...) torque that takes up most of it, N m.
        thresholds: (n_plays, ...) r_i, N m.
        weights: (n_plays, ...) w_i, rad/(N m).

    Raises:
        DataError: the plays are softer than the gear, so that no elastic part remains.
    """

    compliance: FloatArray
    breakpoints: FloatArray
    lost_motion: FloatArray | float = 0.0
    lost_motion_torque: FloatArray | float = 1.0
    thresholds: FloatArray = field(default_factory=lambda: NO_PLAYS)
    weights: FloatArray = field(default_factory=lambda: NO_PLAYS)

    def __post_init__(self) -> None:
        """Check that the curve without memory rises everywhere."""
        of_plays = self.weights.sum(axis=0)
        if ((of_plays > 0.0) & (of_plays >= self.compliance.min(axis=0))).any():
            softest = float(np.max(of_plays))
            raise DataError(
                f"plays of {softest:.3g} rad/(N m) are softer than the gear (valid: a smaller "
                "width of the hysteresis)"
            )

    @classmethod
    def of_width(
        cls,
        width: FloatArray | float,
        rated: FloatArray | float,
        compliance: FloatArray,
        breakpoints: FloatArray,
        lost_motion: FloatArray | float = 0.0,
    ) -> Self:
        """Return the law of gears of rated torque [N m] and hysteresis of full width [rad].

        `width` is the loop's, at zero torque after the rated torque in both directions. The arrays
        `width`, `rated` and `lost_motion` (...) are one number per gear.
        """
        shares = np.reshape(THRESHOLDS, (-1, *(1,) * np.ndim(rated)))
        thresholds = shares * np.asarray(rated)
        weights = thresholds * np.asarray(width) / (2.0 * (thresholds**2).sum(axis=0))
        lost_motion_torque = LOST_MOTION_SHARE * np.asarray(rated)
        return cls(compliance, breakpoints, lost_motion, lost_motion_torque, thresholds, weights)

    def angle(self, torque: FloatArray, plays: FloatArray = NO_PLAYS) -> FloatArray:
        """Return (...) theta [rad] under (...) torque [N m], with (n_plays, ...) plays [N m]."""
        size, (first, second) = np.abs(torque), self.breakpoints
        segments = (
            np.minimum(size, first),
            np.clip(size - first, 0.0, second - first),
            np.maximum(size - second, 0.0),
        )
        monotone = sum(slope * part for slope, part in zip(self.compliance, segments, strict=True))
        lost_motion_share = np.tanh(torque / np.asarray(self.lost_motion_torque))
        theta = np.copysign(monotone, torque) + self.lost_motion / 2.0 * lost_motion_share
        if len(self.weights):
            theta = theta - (self.weights * (torque - plays)).sum(axis=0)
        return np.asarray(theta)

    def slipped(self, plays: FloatArray, torque: FloatArray) -> FloatArray:
        """Return (n_plays, ...) the plays [N m] after a monotone change to (...) torque [N m]."""
        return np.clip(plays, torque - self.thresholds, torque + self.thresholds)

    def plays_after_motion(self, torque: FloatArray, direction: FloatArray) -> FloatArray:
        """Return (n_plays, ...) plays after a long motion that ended under (...) torque [N m].

        `direction` (...) is the sign of the motion's end, +-1.
        """
        return np.asarray(torque - direction * self.thresholds)

    def plays_along(self, torques: FloatArray, plays: FloatArray | None = None) -> FloatArray:
        """Return the (n_plays, n) plays of one gear under (n,) torques, one after the other.

        `plays` (n_plays,) hold before the first torque; by default they are zero.
        """
        state = np.zeros_like(self.thresholds) if plays is None else plays
        states = np.empty((len(state), len(torques)))
        for number, torque in enumerate(torques):
            state = np.minimum(
                np.maximum(state, torque - self.thresholds), torque + self.thresholds
            )
            states[:, number] = state
        return states

    def loop(self, torques: FloatArray, plays: FloatArray | None = None) -> FloatArray:
        """Return (n,) theta [rad] of one gear under (n,) torques; `plays` as in `plays_along`."""
        of_gear = replace(self, thresholds=self.thresholds[:, None], weights=self.weights[:, None])
        return of_gear.angle(torques, self.plays_along(torques, plays))
