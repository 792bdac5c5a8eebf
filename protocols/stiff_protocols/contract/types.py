"""The values that pass between the layers: frozen, shape-checked once, SI units.

Angles are in rad, forces in N, torques in N m, lengths and deflections in m. A wrench is
force first, acts at the tool centre point (TCP) and is expressed in the robot base frame.
"""

from __future__ import annotations

import hashlib
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field, fields, replace
from functools import cached_property
from typing import Any, Protocol, Self

import numpy as np

from stiff_protocols.contract.arrays import BoolArray as BoolArray
from stiff_protocols.contract.arrays import FloatArray as FloatArray
from stiff_protocols.contract.arrays import IntArray as IntArray
from stiff_protocols.contract.arrays import TextArray as TextArray
from stiff_protocols.contract.arrays import freeze
from stiff_protocols.contract.arrays import frozen_array as frozen_array
from stiff_protocols.contract.display import BriefFields, Screen, ShownObject
from stiff_protocols.contract.errors import ConfigError, DataError
from stiff_protocols.contract.robot import Robot as Robot
from stiff_protocols.kinematics.chain_formulas import ChainJoint as ChainJoint
from stiff_protocols.kinematics.chain_formulas import JointType as JointType

AXES = ("x", "y", "z")
"""Names of the three components of a deflection, robot base frame."""

BOUND_NAMES = {"oracle": "oracle", "noise": "instrument noise", "uncorrected": "no correction"}
"""Deflections that only a simulation knows -> their names in tables. Oracle: prediction of the
robot's own physics from the recorded joint angles and wrenches. Noise: deflection before the
tracker's noise. Uncorrected: a path's whole error."""

TRUTH = "truth"
"""Key of the deflection of the true robot at the description's TCP, under the wrench that a row
writes, without rig and noise. Metrics `true-norm` and `true-p95` compare with it."""

DRAWN = "drawn"
"""Key of the same deflection in the drawn state of friction, where there is friction. Metric
`drawn-norm` compares with it."""

TRUTHS = (TRUTH, DRAWN)

PATH_GROUP = "tool path"
"""Group of the samples that a protocol adds for a simulated robot: points of tool paths, which are
never used for training."""

Deflection = Callable[[FloatArray, FloatArray], FloatArray]
"""(n, n_joints) joint positions [rad, m] and (n, 6) wrenches [N, N m] -> (n, 3) deflections [m]."""


SHOWN_ROWS = 5
"""Number of samples in a short view."""

_WHERE_STATED = {"hashed_where_stated": True}
_UNIT_LENGTH_TOLERANCE, _SPAN_TOLERANCE = 1e-6, 1e-9
"""Of a direction's length, and of a deflection's part outside its directions, m."""


def _not_stated() -> FloatArray:
    return np.empty(0)


@dataclass(frozen=True, eq=False, repr=False)
class Samples(ShownObject):
    """Measured or simulated load/deflection samples of one robot.

    Attributes:
        q: (n, n_joints) joint angles, rad (m for prismatic joints).
        wrench: (n, 6) load at the TCP, force [N] then torque [N m], base frame.
        deflection: (n, 3) displacement of the TCP under the load, m, base frame.
        pose_id: (n,) name of the robot pose; a fair split never divides the rows of a pose.
        load_id: (n,) name of the load at that pose.
        group: (n,) name of the part of the measurement plan the pose belongs to.
        instrument_noise: standard deviation of a measured deflection's error, m, per axis, as
            stated by the data card; 0 if not stated.
        order: (n,) number or time of each reading, in the order of the measurement; empty: not
            stated, like the arrays below.
        approach: (n, n_joints) direction from which each joint reached the pose, 1 or -1; 0: it
            did not move.
        after: (n, 3) displacement of the TCP that stays after the load is removed, m, base frame.
        directions: (n, m, 3) unit vectors, base frame, along which one to three numbers were read,
            and zero vectors in rows with fewer than m; `deflection` is then the smallest vector
            with these `values`. Empty: x, y and z.
        levers: (n, 3) from the TCP to the point whose displacement was read along `directions`, m,
            base frame; empty: the TCP's was. The wrench is at the TCP all the same.
    """

    q: FloatArray
    wrench: FloatArray
    deflection: FloatArray
    pose_id: TextArray
    load_id: TextArray
    group: TextArray
    instrument_noise: float = field(default=0.0, metadata=_WHERE_STATED)
    order: FloatArray = field(default_factory=_not_stated, metadata=_WHERE_STATED)
    approach: FloatArray = field(default_factory=_not_stated, metadata=_WHERE_STATED)
    after: FloatArray = field(default_factory=_not_stated, metadata=_WHERE_STATED)
    directions: FloatArray = field(default_factory=_not_stated, metadata=_WHERE_STATED)
    levers: FloatArray = field(default_factory=_not_stated, metadata=_WHERE_STATED)

    def __post_init__(self) -> None:
        if not 0.0 <= self.instrument_noise < np.inf:
            raise DataError(f"instrument_noise is {self.instrument_noise:g} m, expected at least 0")
        object.__setattr__(self, "instrument_noise", float(self.instrument_noise))
        freeze(self, q=(None, None))
        n = len(self.q)
        freeze(self, wrench=(n, 6), deflection=(n, 3))
        self._freeze_optional(n)
        for name in ("pose_id", "load_id", "group"):
            text = np.array(getattr(self, name), dtype=np.str_)
            if text.shape != (n,):
                raise DataError(f"{name} has shape {text.shape}, expected ({n},)")
            text.flags.writeable = False
            object.__setattr__(self, name, text)

    def _freeze_optional(self, n: int) -> None:
        """Check the arrays that a file may state, and make them read-only."""
        shapes: dict[str, tuple[int | None, ...]] = {
            "order": (n,),
            "approach": (n, self.q.shape[1]),
            "after": (n, 3),
            "directions": (n, None, 3),
            "levers": (n, 3),
        }
        for name, shape in shapes.items():
            freeze(self, **{name: shape if np.size(getattr(self, name)) else (0,)})
        if not np.isin(self.approach, (-1.0, 0.0, 1.0)).all():
            raise DataError("approach holds other numbers than 1, -1 and 0")
        if not self.directions.size:
            if self.levers.size:
                raise DataError("levers without directions: nothing was read at their points")
            return
        lengths, is_read = np.linalg.norm(self.directions, axis=2), self.is_read
        if (is_read & (np.abs(lengths - 1.0) > _UNIT_LENGTH_TOLERANCE)).any():
            raise DataError("directions holds vectors whose length is not 1")
        if not is_read.any(axis=1).all():
            raise DataError("directions holds a sample without a number")
        if (np.linalg.matrix_rank(self.directions) < is_read.sum(axis=1)).any():
            raise DataError("directions holds several numbers along one direction")
        smallest = smallest_vectors(self.directions, self.values)
        if np.abs(smallest - self.deflection).max() > _SPAN_TOLERANCE:
            raise DataError("deflection has a part outside its directions")

    @property
    def values(self) -> FloatArray:
        """(n, m) numbers that were read along `directions`, m; 0 where `is_read` is false."""
        return self.read(self.deflection)

    @property
    def is_read(self) -> BoolArray:
        """(n, m) true for numbers that were read."""
        if not self.directions.size:
            return np.ones(self.deflection.shape, dtype=bool)
        return np.asarray(self.directions.any(axis=2))

    @property
    def pose_of_number(self) -> IntArray:
        """(k,) numbers of the poses, from 0, of the k numbers where `is_read` is true."""
        pose = np.unique(self.pose_id, return_inverse=True)[1]
        return np.repeat(pose, self.is_read.sum(axis=1))

    def read(self, displacement: FloatArray) -> FloatArray:
        """Return the (n, m, ...) numbers that would be read of (n, 3, ...) displacements, m."""
        return read_along(self.directions, displacement)

    def seen(self, displacement: FloatArray) -> FloatArray:
        """Return the part of (n, 3) displacements [m] that the readings show."""
        if not self.directions.size:
            return displacement
        return smallest_vectors(self.directions, self.read(displacement))

    def __len__(self) -> int:
        return len(self.q)

    @property
    def facts(self) -> list[tuple[str, str]]:
        """Counts, and the ranges of loads and deflections, as readable text."""
        n_poses = len(np.unique(self.pose_id))
        force, torque = self.wrench[:, :3], self.wrench[:, 3:]
        return [
            ("samples", f"{len(self)} at {n_poses} pose{'s' * (n_poses != 1)}"),
            ("loads", f"force {_range(force)} N, torque {_range(torque)} N m"),
            ("deflections", f"{_range(1000.0 * self.deflection)} mm"),
        ]

    def view(self) -> Screen:
        """Return counts and ranges, and the first rows in N, N m and mm."""
        names = ["pose_id", "load_id", *(f"f{axis}_N" for axis in AXES)]
        names += [*(f"t{axis}_Nm" for axis in AXES), *(f"d{axis}_mm" for axis in AXES)]
        head = self.take(np.arange(min(len(self), SHOWN_ROWS)))
        loads, moved = np.char.mod("%.2f", head.wrench), np.char.mod("%.3f", 1e3 * head.deflection)
        rows = np.column_stack([head.pose_id, head.load_id, loads, moved]).tolist()
        return Screen(f"Samples, {self.q.shape[1]} joints", self.facts, names, rows)

    def take(self, rows: IntArray) -> Self:
        """Return the samples of the given row numbers, in that order."""
        return replace(self, **{name: getattr(self, name)[rows] for name in self.columns})

    @property
    def columns(self) -> tuple[str, ...]:
        """Names of the fields with a row per sample, without those that are not stated."""
        return (*_COLUMNS, *(name for name in _OPTIONAL if getattr(self, name).size))

    @classmethod
    def together(cls, *parts: Samples) -> Self:
        """Return the samples of all parts, in their order, with their largest noise.

        What one of them does not state is left out; directions are padded to one shape, and parts
        without levers were read at the TCP.
        """
        parts = tuple(part for part in parts if len(part)) or parts[:1]
        most = max(part.is_read.shape[1] for part in parts)
        if any(part.directions.size for part in parts):
            parts = tuple(replace(part, directions=_padded(part, most)) for part in parts)
        if any(part.levers.size for part in parts):
            parts = tuple(
                part if part.levers.size else replace(part, levers=np.zeros((len(part), 3)))
                for part in parts
            )
        names = [n for n in parts[0].columns if all(n in part.columns for part in parts)]
        columns = {name: np.concatenate([getattr(p, name) for p in parts]) for name in names}
        return cls(**columns, instrument_noise=max(part.instrument_noise for part in parts))


_COLUMNS = ("q", "wrench", "deflection", "pose_id", "load_id", "group")
"""Fields of `Samples` with a row per sample that are always stated."""
_OPTIONAL = ("order", "approach", "after", "directions", "levers")
"""Those that a file may state."""


def read_along(directions: FloatArray, displacement: FloatArray) -> FloatArray:
    """Return the (n, m, ...) numbers along directions of (n, 3, ...) displacements, m.

    `directions` are (n, m, 3) as `Samples.directions`; empty: the displacements.
    """
    if not directions.size:
        return displacement
    return np.asarray(np.einsum("nmk,nk...->nm...", directions, displacement))


def smallest_vectors(directions: FloatArray, values: FloatArray) -> FloatArray:
    """Return the smallest (n, 3) vectors with (n, m) values along (n, m, 3) directions."""
    return np.asarray((np.linalg.pinv(directions) @ values[..., None])[..., 0])


def _padded(samples: Samples, most: int) -> FloatArray:
    """Return the (n, most, 3) directions of samples, with zero vectors where there are fewer."""
    axes = np.broadcast_to(np.eye(3), (len(samples), 3, 3))
    directions = samples.directions if samples.directions.size else axes
    return np.pad(directions, ((0, 0), (0, most - directions.shape[1]), (0, 0)))


def _range(vectors: FloatArray) -> str:
    """Return the smallest and the largest length of (n, 3) vectors as text."""
    lengths = np.linalg.norm(vectors, axis=1)
    ends = (lengths.min(), lengths.max()) if len(lengths) else ()
    return " to ".join(dict.fromkeys(f"{end:.4g}" for end in ends)) or "-"


@dataclass(frozen=True, repr=False)
class Split(BriefFields):
    """Row numbers of a division of a data set, and its condition.

    Attributes:
        index: number of the split in its condition, from 0.
        train: training rows.
        validation: rows that choose an epoch; empty if the protocol has none.
        test: rows that no parameter is fitted to.
        condition: the protocol's condition, other than the rows' draw ("n = 20", "joint-space ->
            cartesian"). Results of different conditions are never averaged. "" for a single
            condition.
        wrench_error: (n, 6) N and N m, base frame, error of the force sensor at the reported rows;
            None for no error.
        source: name of another robot's or specimen's data set for simulated source domains; "" for
            the training rows.
        also_reported: rows of the training side that the metrics also cover; empty unless the
            protocol declares `reports_training`.
    """

    index: int
    train: IntArray
    validation: IntArray
    test: IntArray
    condition: str = ""
    wrench_error: FloatArray | None = None
    source: str = ""
    also_reported: IntArray = field(default_factory=lambda: np.empty(0, dtype=np.int64))

    @cached_property
    def reported(self) -> IntArray:
        """Rows that the metrics are computed on: the test rows, and `also_reported`."""
        if not len(self.also_reported):
            return self.test
        return np.sort(np.concatenate([self.test, self.also_reported]))

    @cached_property
    def sha256(self) -> str:
        """Hash of all reported rows, so that a table never mixes different splits."""
        if self.wrench_error is None and not len(self.also_reported):
            return self.rows_sha256
        digest = hashlib.sha256(self.rows_sha256.encode())
        if self.wrench_error is not None:
            digest.update(_canonical_bytes(self.wrench_error))
        digest.update(np.ascontiguousarray(self.also_reported, dtype="<i8").tobytes())
        return digest.hexdigest()

    @cached_property
    def rows_sha256(self) -> str:
        """Hash of training, validation and test rows: splits that share it share the fit."""
        digest = hashlib.sha256()
        for rows in (self.train, self.validation, self.test):
            digest.update(len(rows).to_bytes(8, "little"))
            digest.update(np.ascontiguousarray(rows, dtype="<i8").tobytes())
        return digest.hexdigest()

    def told_wrench(self, samples: Samples) -> FloatArray:
        """Return the (n, 6) wrenches [N, N m] of the reported rows, as given to a model."""
        wrench = samples.wrench[self.reported]
        return wrench if self.wrench_error is None else wrench + self.wrench_error


@dataclass(frozen=True, eq=False, repr=False)
class Interval(BriefFields):
    """Prediction interval of each deflection with a stated probability, axis by axis.

    Attributes:
        lower, upper: (n, 3) m, base frame; lower <= upper.
        coverage: probability per axis.
    """

    lower: FloatArray
    upper: FloatArray
    coverage: float

    def __post_init__(self) -> None:
        freeze(self, lower=(None, 3), upper=(None, 3))
        if self.lower.shape != self.upper.shape or (self.lower > self.upper).any():
            raise DataError("an interval's lower bounds lie above its upper bounds")

    @property
    def half_width(self) -> FloatArray:
        """(n,) lengths of the half widths on the three axes, m."""
        return np.asarray(0.5 * np.linalg.norm(self.upper - self.lower, axis=1))

    def moved(self, shift: FloatArray) -> Interval:
        """Return the interval moved by (n, 3) `shift`, m; its width stays."""
        return Interval(self.lower + shift, self.upper + shift, self.coverage)


def check_coverage(coverage: float) -> None:
    """Raise ConfigError unless a nominal coverage is between 0 and 1."""
    if not 0.0 < coverage < 1.0:
        raise ConfigError(f"{coverage:g}: must lie between 0 and 1", "coverage")


@dataclass(frozen=True, eq=False, repr=False)
class Prediction(BriefFields):
    """Predicted and measured deflections of a split's reported rows.

    Attributes:
        rows: (n,) row numbers in the data set.
        predicted: (n, 3) predicted deflection, m, base frame.
        measured: (n, 3) deflection of the data set, m, base frame.
        interval: intervals of the same rows; None if not requested.
        reference: (n, 3) m, base frame, prediction of the reference model (the VJM) with the same
            training rows; None if not available.
        bound_deflections: name of `BOUND_NAMES`, `TRUTH` or `DRAWN` -> (n, 3) m, base frame, for
            simulated data.
        directions: (n, m, 3) as `Samples.directions`; empty: x, y and z were measured.
    """

    rows: IntArray
    predicted: FloatArray
    measured: FloatArray
    interval: Interval | None = None
    reference: FloatArray | None = None
    bound_deflections: Mapping[str, FloatArray] = field(default_factory=dict)
    directions: FloatArray = field(default_factory=_not_stated)

    def __post_init__(self) -> None:
        n = len(self.rows)
        freeze(self, predicted=(n, 3), measured=(n, 3))
        freeze(self, directions=(n, None, 3) if np.size(self.directions) else (0,))
        if self.reference is not None:
            freeze(self, reference=(n, 3))
        if self.interval is not None and len(self.interval.lower) != n:
            raise DataError(f"{len(self.interval.lower)} intervals for {n} predictions")

    @classmethod
    def of_stored(cls, **arrays: Any) -> Self:
        """Return a stored prediction without checking its arrays again.

        Checking 35,000 predictions takes longer than a leaderboard.
        """
        made = object.__new__(cls)
        vars(made).update({"directions": _not_stated(), **arrays})
        return made

    def errors(self, predicted: FloatArray) -> FloatArray:
        """Return the (n, 3) errors [m] of (n, 3) predictions, as far as readings show them."""
        errors = predicted - self.measured
        if not self.directions.size:
            return errors
        return smallest_vectors(self.directions, read_along(self.directions, errors))


@dataclass(frozen=True, eq=False, repr=False)
class BenchmarkData(ShownObject):
    """Data of a data set: samples, and their robot.

    Attributes:
        samples: samples of a robot.
        robot: robot as given to the models.
        bound_deflections: (n, 3) deflections [m] that only a simulation knows, a row per sample,
            for comparison with a model's errors: see `BOUND_NAMES`, `TRUTH`, `DRAWN`. Models never
            get them, and the hash excludes them.
        under_load: true deflection of the measured robot at new poses and loads, without noise, in
            the order of the motion; None if the robot cannot be measured again. It can be pickled.
            Only the scorer calls it; models never get it, and the hash excludes it.
        joint_turn: true turn [rad or m] of joints by (n, n_joints) torques [N m or N], which only
            a simulation knows, for figures. Models never get it, and the hash excludes it.
        paths: points of tool paths that a protocol corrects in addition to its test: (n, n_joints)
            commands [rad or m] and (n, 6) wrenches [N, N m]; None: no paths. The hash excludes
            them.
    """

    samples: Samples
    robot: Robot
    bound_deflections: Mapping[str, FloatArray] = field(default_factory=dict)
    under_load: Deflection | None = None
    joint_turn: Callable[[FloatArray], FloatArray] | None = None
    paths: tuple[FloatArray, FloatArray] | None = None

    def __post_init__(self) -> None:
        bounds = {
            name: frozen_array(array, name, (len(self.samples), 3))
            for name, array in self.bound_deflections.items()
        }
        object.__setattr__(self, "bound_deflections", bounds)
        if bounds and self.samples.levers.size:
            raise DataError("the truth of a simulation is of the TCP, not of points of levers")
        if self.paths is not None:
            q, wrench = self.paths
            q = frozen_array(q, "paths", (None, self.robot.n_joints))
            wrench = frozen_array(wrench, "paths", (len(q), 6))
            object.__setattr__(self, "paths", (q, wrench))
        if self.samples.q.shape[1] != self.robot.n_joints:
            raise DataError(
                f"samples have {self.samples.q.shape[1]} joint angles, "
                f"robot {self.robot.name!r} has {self.robot.n_joints} joints"
            )

    @property
    def facts(self) -> list[tuple[str, str]]:
        """Robot and TCP, and the facts of the samples."""
        return [
            ("robot", self.robot.summary),
            ("TCP", self.robot.tcp_text),
            *self.samples.facts,
        ]

    def view(self) -> Screen:
        """Return robot, counts and ranges."""
        return Screen("Samples and their robot", self.facts)

    def without_truth(self) -> BenchmarkData:
        """Return the same samples and robot, without data that only a simulation knows."""
        return BenchmarkData(self.samples, self.robot)

    @cached_property
    def sha256(self) -> str:
        """Hash of every number and name that can change a result."""
        digest = hashlib.sha256()
        for owner in (self.samples, self.robot):
            for item in fields(owner):
                value = getattr(owner, item.name)
                stated = value.size if isinstance(value, np.ndarray) else value
                unstated = "hashed_where_stated" in item.metadata and not stated
                if "shapes_no_result" in item.metadata or unstated:
                    continue
                digest.update(item.name.encode())
                digest.update(_canonical_bytes(value))
        return digest.hexdigest()


def _canonical_bytes(value: Any) -> bytes:
    if isinstance(value, np.ndarray) and value.dtype.kind == "f":
        # -0.0 and 0.0 are the same number for every model
        return np.ascontiguousarray(value + 0.0, dtype="<f8").tobytes()
    if isinstance(value, np.ndarray):
        value = value.tolist()
    return repr(value).encode()


class StiffnessDataset(Protocol):
    """Makes or reads one data set; constructor arguments are its options."""

    def load(self) -> BenchmarkData:
        """Return samples and robot; the same options give the same numbers."""
