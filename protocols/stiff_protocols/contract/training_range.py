"""The range of a model's training samples: predictions far from it are a guess, and are marked."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import cached_property
from typing import TYPE_CHECKING

import numpy as np

from stiff_protocols.contract.arrays import FloatArray, freeze, frozen_array
from stiff_protocols.contract.brief_fields import BriefFields
from stiff_protocols.contract.errors import DataError
from stiff_protocols.contract.types import BoolArray, Interval, Samples

if TYPE_CHECKING:
    from scipy.spatial import cKDTree

MARGIN = 0.1
"""Part of a quantity's training range that still counts as inside beyond its ends: a robot at work
never repeats them to the digit."""
LEAST_MARGIN, LEAST_FORCE, LEAST_TORQUE = 0.01, 0.1, 0.01
"""The least margin, rad or m, N, N m: for a joint that hardly moved and a load that was none."""

USUAL_SHARE = 0.9
"""Share of the training poses (or loads) that have another one within the usual distance."""
FAR = 2.0
"""A pose or load is far from training beyond this many usual distances."""
LEAST_FAR_POSE, LEAST_FAR_LOAD = 0.2, 0.25
"""The least distance that counts as far: rad or m of a pose; share of the largest load."""
POSE_RATE, LOAD_RATE = 2.0, 0.5
"""What an interval grows by, in units of its width: for each rad or m of `pose_distance`, and for
each unit of `load_distance`. With them intervals of four models held between the poses of the KR10
twin's plan, and needed none on arms measured all over (docs/models.md)."""
MOST_NEIGHBOURS = 2000
"""Training poses and loads that are kept, evenly chosen: a file of 100,000 samples stays small."""


@dataclass(frozen=True, eq=False, repr=False)
class TrainingRange(BriefFields):
    """Joint positions and loads of the samples that a model learned from.

    Attributes:
        lower: (n_joints,) smallest joint positions, rad or m.
        upper: (n_joints,) largest ones.
        force: the largest one, N.
        torque: the largest one about the TCP, N m.
        poses: (n_poses, n_joints) joint positions, rad or m; at most `MOST_NEIGHBOURS`.
        directions: (n_loads, 6) unit vectors of the loads that are not zero, a torque of 1 N m
            counting as a force of 1 N; at most `MOST_NEIGHBOURS`.
    """

    lower: FloatArray
    upper: FloatArray
    force: float
    torque: float
    poses: FloatArray
    directions: FloatArray

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

    @classmethod
    def of(cls, samples: Samples) -> TrainingRange:
        """Return the range of some samples, at least one."""
        force, torque = _lengths(samples.wrench).max(axis=0)
        poses = samples.q[np.unique(samples.pose_id, return_index=True)[1]]
        loaded = samples.wrench[samples.wrench.any(axis=1)]
        return cls(
            samples.q.min(axis=0),
            samples.q.max(axis=0),
            float(force),
            float(torque),
            _evenly(poses),
            _evenly(_directions(loaded)),
        )

    @cached_property
    def _near_poses(self) -> _Neighbours:
        return _Neighbours(self.poses)

    @cached_property
    def _near_directions(self) -> _Neighbours:
        return _Neighbours(self.directions)

    def pose_distance(self, q: FloatArray) -> FloatArray:
        """Return (n,) the distances of (n, n_joints) `q` from the nearest training pose, rad or m.

        Euclidean, over all joints.
        """
        return self._near_poses.distance(q)

    def load_distance(self, wrench: FloatArray) -> FloatArray:
        """Return (n,) how far the (n, 6) loads are from the nearest training load.

        The size |F| + |T| / 1 m of a load as a share of the largest in training (at most 1), times
        the distance of its direction from the nearest direction in training, of two unit vectors.
        Along a training load it is 0, whatever the size.
        """
        loaded, share = wrench.any(axis=1), np.minimum(self._load_share(wrench), 1.0)
        distance = np.zeros(len(wrench))
        distance[loaded] = self._near_directions.distance(_directions(wrench[loaded]))
        return np.asarray(distance * share)

    def stretch(self, q: FloatArray, wrench: FloatArray) -> FloatArray:
        """Return (n,) how many times as wide an interval is there as near the training samples.

        It grows by `POSE_RATE` for each rad or m by which the pose lies beyond the range or, if
        that is more, by which its nearest training pose is farther than is usual among these; and
        by `LOAD_RATE` for each unit by which the nearest training load is. Arguments as of
        `quantities`.
        """
        outside = np.maximum(self.lower - q, q - self.upper).max(axis=1, initial=0.0)
        apart = np.maximum(self.pose_distance(q) - self._near_poses.usual, 0.0)
        load = np.maximum(self.load_distance(wrench) - self._near_directions.usual, 0.0)
        return np.asarray((1.0 + POSE_RATE * np.maximum(outside, apart)) * (1.0 + LOAD_RATE * load))

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

    def are_beyond(self, values: FloatArray) -> BoolArray:
        """Return (n, n_joints + 2) which `quantities` lie beyond, by the rule of `extrapolates`."""
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

        Under r times the training load the prediction at the same pose under a load r times as
        small is known. Deflections grow as loads do, so r times that interval holds as often as
        it does itself; the interval returned reaches as far. It is `stretch` times as wide.

        Args:
            within: the interval of (n, n_joints) q and (n, 6) wrench, its middle the prediction.
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
        """Return (n,) the sizes of loads as shares of the largest; 1 N m counts as 1 N."""
        largest = max(self.force + self.torque, 1e-9)
        return np.asarray(_lengths(wrench).sum(axis=1) / largest)

    @property
    def usual_distances(self) -> tuple[float, float]:
        """Largest distance of nine in ten training poses (rad or m) and loads from another one."""
        return self._near_poses.usual, self._near_directions.usual

    def extrapolates(self, q: FloatArray, wrench: FloatArray) -> list[str]:
        """Say for each row what is unlike the training samples; "" where nothing is.

        "joints": a joint is beyond its training positions by more than `MARGIN` of their span.
        "pose-gap": none is, but the nearest training pose is more than `FAR` times as far away as
        `usual_distances` says. "load" and "load-gap": the same of the lengths of force and torque,
        and of `load_distance`. Each has a least margin or distance.

        A row can have a word of each pair. Angles count as they stand: 350 deg is not -10 deg,
        since not every model is periodic. Arguments as of `quantities`; DataError: `q` has another
        number of joints.
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
    """Nearest rows of a set of them, and how far these usually are from each other.

    Attributes:
        usual: distance within which `USUAL_SHARE` of the rows have another one; 0 of less than two.
    """

    def __init__(self, rows: FloatArray) -> None:
        from scipy.spatial import cKDTree  # not every use needs it

        self._tree: cKDTree | None = cKDTree(rows) if len(rows) else None
        self.usual = 0.0
        if self._tree is not None and len(rows) > 1:
            distances = self._tree.query(rows, k=[2])[0]  # of the second nearest: itself is first
            self.usual = float(np.quantile(distances, USUAL_SHARE))

    def distance(self, rows: FloatArray) -> FloatArray:
        """Return (n,) the distances of rows from the nearest one; 2, where there is none."""
        if self._tree is None:
            return np.full(len(rows), 2.0)  # two unit vectors are never farther apart
        return np.asarray(self._tree.query(rows)[0])


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
