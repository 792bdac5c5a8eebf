"""The range of a model's training samples; predictions far from it are marked as guesses."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import cached_property
from typing import TYPE_CHECKING

import numpy as np

from stiff_protocols.contract.arrays import FloatArray, freeze, frozen_array
from stiff_protocols.contract.display import BriefFields
from stiff_protocols.contract.errors import DataError
from stiff_protocols.contract.types import BoolArray, Interval, Robot, Samples

if TYPE_CHECKING:
    from scipy.spatial import cKDTree

MARGIN = 0.1
"""Share of a quantity's training range by which its ends are extended: a robot at work never
repeats them exactly."""
LEAST_MARGIN, LEAST_FORCE, LEAST_TORQUE = 0.01, 0.1, 0.01
"""Least margin, rad or m, N, N m: for a joint that hardly moved, and for zero load."""

USUAL_SHARE = 0.9
"""Share of the training poses (or loads) with another pose (or load) in the usual distance."""
FAR = 2.0
"""A pose or load is far from training beyond this many usual distances."""
LEAST_FAR_POSE, LEAST_FAR_LOAD = 0.2, 0.25
"""The least distance that counts as far: rad or m of a pose; share of the largest load."""
POSE_RATE, LOAD_RATE = 2.0, 0.5
"""Growth of an interval, in units of its width, per rad or m of `pose_distance` and per unit of
`load_distance`. With it, intervals of four models were valid between the poses of the KR10 twin's
plan. Arms with measurements everywhere did not need it (docs/models.md)."""
MOST_NEIGHBOURS = 2000
"""Most training poses and loads that are stored, evenly chosen, so that large files stay small."""
FULL_TURN = 2.0 * np.pi


@dataclass(frozen=True, eq=False, repr=False)
class TrainingRange(BriefFields):
    """Joint positions and loads of a model's training samples.

    Attributes:
        lower: (n_joints,) smallest joint positions, rad or m. Of an endless joint, `lower` and
            `upper` are the ends of the smallest arc that holds all angles.
        upper: (n_joints,) largest joint positions.
        force: largest force, N.
        torque: largest torque about the TCP, N m.
        poses: (n_poses, n_joints) joint positions, rad or m; at most `MOST_NEIGHBOURS`.
        directions: (n_loads, 6) unit vectors of the nonzero loads, where a torque of 1 N m counts
            as a force of 1 N; at most `MOST_NEIGHBOURS`.
        endless: numbers of the joints without limits, whose angles are the same by whole turns.
    """

    lower: FloatArray
    upper: FloatArray
    force: float
    torque: float
    poses: FloatArray
    directions: FloatArray
    endless: tuple[int, ...] = ()

    def __post_init__(self) -> None:
        freeze(self, lower=(None,), upper=(None,))
        loads = frozen_array([self.force, self.torque], "largest force and torque", (2,))
        if self.lower.shape != self.upper.shape or (self.lower > self.upper).any():
            raise DataError("a training range's lower ends lie above its upper ends")
        if (loads < 0.0).any():
            raise DataError(f"a training range's largest loads are {loads}, expected >= 0")
        freeze(self, poses=(None, len(self.lower)), directions=(None, 6))
        if not len(self.poses):
            raise DataError("a training range has no poses, expected at least one")
        if not {*self.endless} <= {*range(len(self.lower))}:
            raise DataError(
                f"a training range's endless joints are {self.endless}, expected numbers below "
                f"{len(self.lower)}"
            )

    @classmethod
    def of(cls, samples: Samples, robot: Robot) -> TrainingRange:
        """Return the range of some samples of a robot, at least one sample."""
        force, torque = _lengths(samples.wrench).max(axis=0)
        q = in_smallest_arcs(samples.q, robot)
        poses = q[np.unique(samples.pose_id, return_index=True)[1]]
        loaded = samples.wrench[samples.wrench.any(axis=1)]
        return cls(
            q.min(axis=0),
            q.max(axis=0),
            float(force),
            float(torque),
            _evenly(poses),
            _evenly(_directions(loaded)),
            tuple(np.flatnonzero(robot.endless).tolist()),
        )

    @property
    def middle(self) -> FloatArray:
        """Return the (n_joints,) middle between the smallest and largest positions, rad or m."""
        return 0.5 * (self.lower + self.upper)

    @cached_property
    def _near_poses(self) -> _Neighbours:
        if not self.endless:
            return _Neighbours(self.poses)
        period = np.zeros(len(self.lower))  # 0: another number is another position
        period[[*self.endless]] = FULL_TURN
        return _Neighbours(self.poses, period)

    @cached_property
    def _near_directions(self) -> _Neighbours:
        return _Neighbours(self.directions)

    def pose_distance(self, q: FloatArray) -> FloatArray:
        """Return the (n,) distances of `q` (n, n_joints) from the nearest training pose, rad or m.

        They are Euclidean, over all joints, without whole turns of endless joints.
        """
        return self._near_poses.distance(q)

    def load_distance(self, wrench: FloatArray) -> FloatArray:
        """Return the (n,) distances of the (n, 6) loads from the nearest training load.

        A distance is the product of two factors. The first is the size |F| + |T| / 1 m of a load as
        a share of the largest training load (at most 1). The second is the distance of its unit
        vector from the nearest training direction. Along a training load the distance is 0.
        """
        loaded, share = wrench.any(axis=1), np.minimum(self._load_share(wrench), 1.0)
        distance = np.zeros(len(wrench))
        distance[loaded] = self._near_directions.distance(_directions(wrench[loaded]))
        return np.asarray(distance * share)

    def stretch(self, q: FloatArray, wrench: FloatArray) -> FloatArray:
        """Return the (n,) factors on an interval's width near the training samples.

        The factor grows by `POSE_RATE` per rad or m beyond the range, or beyond the usual distance
        from the nearest training pose, whichever is more. It grows by `LOAD_RATE` per unit beyond
        the usual distance from the nearest training load. Arguments are the same as for
        `quantities`.
        """
        q = self._next_to_range(q)
        outside = np.maximum(self.lower - q, q - self.upper).max(axis=1, initial=0.0)
        apart = np.maximum(self.pose_distance(q) - self._near_poses.usual, 0.0)
        load = np.maximum(self.load_distance(wrench) - self._near_directions.usual, 0.0)
        return np.asarray((1.0 + POSE_RATE * np.maximum(outside, apart)) * (1.0 + LOAD_RATE * load))

    @property
    def ends(self) -> tuple[FloatArray, FloatArray]:
        """Lower and upper ends of `quantities`, (n_joints + 2,) each; loads begin at zero."""
        return np.r_[self.lower, 0.0, 0.0], np.r_[self.upper, self.force, self.torque]

    def quantities(self, q: FloatArray, wrench: FloatArray) -> FloatArray:
        """Return (n, n_joints + 2): joint positions, then lengths of force and torque.

        Angles of endless joints are moved by whole turns next to the range.

        Args:
            q: (n, n_joints) rad or m.
            wrench: (n, 6) N and N m at the TCP, base frame.
        """
        return np.hstack([self._next_to_range(q), _lengths(wrench)])

    def _next_to_range(self, q: FloatArray) -> FloatArray:
        """Return (n, n_joints) `q`, angles of endless joints at most half a turn from `middle`."""
        if not self.endless:
            return q
        q, joints = q.copy(), [*self.endless]
        q[:, joints] -= FULL_TURN * np.rint((q[:, joints] - self.middle[joints]) / FULL_TURN)
        return q

    def are_beyond(self, values: FloatArray) -> BoolArray:
        """Return (n, n_joints + 2) true for `quantities` beyond the range; see `extrapolates`."""
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
        """Return intervals around predictions, wider away from the training samples.

        For r times the training load, the interval at the same pose under the load divided by r is
        known. Deflections are proportional to loads, so r times that interval has the same
        coverage. The returned interval reaches as far, and is then `stretch` times as wide.

        Args:
            within: interval of (n, n_joints) q and (n, 6) wrench, centred at the prediction.
            q: (n, n_joints) rad or m.
            wrench: (n, 6) N and N m at the TCP, base frame.
        """
        interval = within(q, wrench)
        middle, half = _middle_and_half(interval)
        load = np.maximum(self._load_share(wrench), 1.0)
        far = load > 1.0
        if far.any():
            more = load[far, None]
            below, reach = _middle_and_half(within(q[far], wrench[far] / more))
            reach = more * reach + np.abs(middle[far] - more * below)
            half[far] = np.maximum(reach, half[far])
        half *= self.stretch(q, wrench)[:, None]
        return Interval(middle - half, middle + half, interval.coverage)

    def _load_share(self, wrench: FloatArray) -> FloatArray:
        """Return the (n,) sizes of loads as shares of the largest; 1 N m counts as 1 N."""
        largest = max(self.force + self.torque, 1e-9)
        return np.asarray(_lengths(wrench).sum(axis=1) / largest)

    @property
    def usual_distances(self) -> tuple[float, float]:
        """Distance from the nearest other pose (rad or m) and load for nine in ten in training."""
        return self._near_poses.usual, self._near_directions.usual

    def extrapolates(self, q: FloatArray, wrench: FloatArray) -> list[str]:
        """Return for each row how it differs from the training samples; "" if it does not.

        "joints": a joint is beyond its training positions by more than `MARGIN` of their span.
        "pose-gap": no joint is, but the nearest training pose is farther than `FAR` times the
        distance in `usual_distances`. "load" and "load-gap": the same for the lengths of force and
        torque, and for `load_distance`. Each has a least margin or distance.

        A row can have a word of each pair. Angles of a joint with limits are not periodic: 350 deg
        is not -10 deg, since not every model is periodic. Arguments are the same as for
        `quantities`. DataError: `q` has another number of joints.
        """
        if q.shape[1] != len(self.lower):
            raise DataError(f"a training range of {len(self.lower)} joints, q has {q.shape[1]}")
        beyond = self.are_beyond(self.quantities(q, wrench))
        usual_pose, usual_load = self.usual_distances
        far_pose = self.pose_distance(q) > max(FAR * usual_pose, LEAST_FAR_POSE)
        far_load = self.load_distance(wrench) > max(FAR * usual_load, LEAST_FAR_LOAD)
        joints, load = beyond[:, :-2].any(axis=1), beyond[:, -2:].any(axis=1)
        marks = (
            ("joints", joints),
            ("pose-gap", far_pose & ~joints),
            ("load", load),
            ("load-gap", far_load & ~load),
        )
        words = [np.where(marked, word, "").tolist() for word, marked in marks]
        return [" ".join(filter(None, row)) for row in zip(*words, strict=True)]


class _Neighbours:
    """Nearest rows of a set of rows, and their usual distance.

    Attributes:
        usual: distance within which `USUAL_SHARE` of the rows have another row; 0 for less than two
            rows.
    """

    def __init__(self, rows: FloatArray, period: FloatArray | None = None) -> None:
        from scipy.spatial import cKDTree  # not every use needs it

        if period is not None:  # the tree wraps only the rows of a query
            turned = rows % FULL_TURN % FULL_TURN  # -1e-20 % 1 is 1
            rows = np.where(period > 0.0, turned, rows)
        self._tree: cKDTree | None = cKDTree(rows, boxsize=period) if len(rows) else None
        self.usual = 0.0
        if self._tree is not None and len(rows) > 1:
            distances = self._tree.query(rows, k=[2])[0]  # of the second nearest: itself is first
            self.usual = float(np.quantile(distances, USUAL_SHARE))

    def distance(self, rows: FloatArray) -> FloatArray:
        """Return the (n,) distances of rows from the nearest row; 2 if there is none."""
        if self._tree is None:
            return np.full(len(rows), 2.0)  # two unit vectors are never farther apart
        return np.asarray(self._tree.query(rows)[0])


def in_smallest_arcs(q: FloatArray, robot: Robot) -> FloatArray:
    """Return `q` (n, n_joints), endless joints by whole turns inside their smallest arc, rad or m.

    The smallest arc of a joint holds all its angles, next to the middle of its smallest and largest
    angle.
    """
    if not robot.endless.any():
        return q
    q = q.copy()
    for joint in np.flatnonzero(robot.endless):
        around = np.sort(q[:, joint] % FULL_TURN)
        gaps = np.diff(around, append=around[0] + FULL_TURN)
        last = int(gaps.argmax())
        middle = around[(last + 1) % len(around)] + 0.5 * (FULL_TURN - gaps[last])
        raw_middle = 0.5 * (q[:, joint].min() + q[:, joint].max())
        middle += FULL_TURN * np.rint((raw_middle - middle) / FULL_TURN)
        q[:, joint] -= FULL_TURN * np.rint((q[:, joint] - middle) / FULL_TURN)
    return q


def _evenly(rows: FloatArray) -> FloatArray:
    """Return at most `MOST_NEIGHBOURS` of the rows, evenly spaced."""
    places = np.linspace(0, len(rows) - 1, min(len(rows), MOST_NEIGHBOURS))
    return rows[places.round().astype(np.int64)]


def _directions(wrench: FloatArray) -> FloatArray:
    """Return unit vectors of (n, 6) loads that are not zero."""
    return np.asarray(wrench / np.linalg.norm(wrench, axis=1, keepdims=True))


def _middle_and_half(interval: Interval) -> tuple[FloatArray, FloatArray]:
    return (interval.lower + interval.upper) / 2.0, (interval.upper - interval.lower) / 2.0


def _lengths(wrench: FloatArray) -> FloatArray:
    """Return (n, 2) lengths of forces and torques."""
    return np.asarray(np.linalg.norm(wrench.reshape(-1, 2, 3), axis=2))
