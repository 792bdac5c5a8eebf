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
from stiff_protocols.contract.brief_fields import BriefFields
from stiff_protocols.contract.errors import ConfigError, DataError
from stiff_protocols.contract.robot import Robot as Robot
from stiff_protocols.contract.screen import Screen, Shown
from stiff_protocols.kinematics.chain_formulas import JointType as JointType

AXES = ("x", "y", "z")
"""Names of the three components of a deflection, robot base frame."""

KNOWN = {"oracle": "oracle", "noise": "instrument noise", "uncorrected": "no correction"}
"""What a simulation knows -> its name in tables. Oracle: what the robot's own physics predict from
the recorded joint angles and wrenches. Noise: the deflection before the tracker's noise.
Uncorrected: none of a path's error removed."""

PATH_GROUP = "tool path"
"""Group of the samples that a protocol adds for a robot that is asked again: points of tool paths,
which no model learns from."""

Deflection = Callable[[FloatArray, FloatArray], FloatArray]
"""(n, n_joints) joint positions [rad, m] and (n, 6) wrenches [N, N m] -> (n, 3) deflections [m]."""


SHOWN_ROWS = 5
"""Samples that a short view of them has."""


@dataclass(frozen=True, eq=False, repr=False)
class Samples(Shown):
    """Measured or simulated load/deflection samples of one robot.

    Attributes:
        q: (n, n_joints) joint angles, rad (m for prismatic joints).
        wrench: (n, 6) load at the TCP, force [N] then torque [N m], base frame.
        deflection: (n, 3) displacement of the TCP under the load, m, base frame.
        pose_id: (n,) name of the robot pose; a fair split never parts the rows of one pose.
        load_id: (n,) name of the load at that pose.
        group: (n,) name of the part of the measurement plan the pose belongs to.
        instrument_noise: standard deviation of a measured deflection's error, m, of each axis, as
            the data card states it; 0 where none does.
    """

    q: FloatArray
    wrench: FloatArray
    deflection: FloatArray
    pose_id: TextArray
    load_id: TextArray
    group: TextArray
    instrument_noise: float = field(default=0.0, metadata={"hashed_where_stated": True})

    def __post_init__(self) -> None:
        if not 0.0 <= self.instrument_noise < np.inf:
            raise DataError(f"instrument_noise is {self.instrument_noise:g} m, expected at least 0")
        object.__setattr__(self, "instrument_noise", float(self.instrument_noise))
        freeze(self, q=(None, None))
        n = len(self.q)
        freeze(self, wrench=(n, 6), deflection=(n, 3))
        for name in ("pose_id", "load_id", "group"):
            text = np.array(getattr(self, name), dtype=np.str_)
            if text.shape != (n,):
                raise DataError(f"{name} has shape {text.shape}, expected ({n},)")
            text.flags.writeable = False
            object.__setattr__(self, name, text)

    def __len__(self) -> int:
        return len(self.q)

    @property
    def facts(self) -> list[tuple[str, str]]:
        """Counts, and the ranges of loads and deflections, for people."""
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
        return replace(self, **{name: getattr(self, name)[rows] for name in COLUMNS})

    @classmethod
    def together(cls, *parts: Samples) -> Self:
        """Return the samples of all parts, in their order, with the largest of their noises."""
        columns = {name: np.concatenate([getattr(p, name) for p in parts]) for name in COLUMNS}
        return cls(**columns, instrument_noise=max(part.instrument_noise for part in parts))


COLUMNS = tuple(item.name for item in fields(Samples) if item.name != "instrument_noise")
"""What `Samples` have a row of for each sample."""


def _range(vectors: FloatArray) -> str:
    """Return the smallest and the largest length of (n, 3) vectors, one where they are equal."""
    lengths = np.linalg.norm(vectors, axis=1)
    ends = (lengths.min(), lengths.max()) if len(lengths) else ()
    return " to ".join(dict.fromkeys(f"{end:.4g}" for end in ends)) or "-"


@dataclass(frozen=True, repr=False)
class Split(BriefFields):
    """Row numbers of one division of a data set, and under which condition it is tested.

    Attributes:
        index: number of the split in its condition, from 0.
        train: rows a model learns from.
        validation: rows that choose an epoch; empty where the protocol gives none.
        test: rows that no parameter is fitted to.
        condition: what a protocol varies beside the rows' draw ("n = 20", "joint-space ->
            cartesian"); results of different conditions are never averaged. "" where it varies
            nothing.
        wrench_error: (n, 6) N and N m, base frame, what the force sensor adds to the wrenches of
            the reported rows; None for nothing.
        source: word of the data set of another robot or specimen that simulated source domains
            come from; "" for the training rows.
        also_reported: rows of the training side that the metrics are computed on beside the test
            rows; empty unless the protocol declares `reports_training`.
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
        """Hash of all that is reported: rows of different splits never meet in one table."""
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
        """Return the (n, 6) wrenches [N, N m] that a model is told of the reported rows."""
        wrench = samples.wrench[self.reported]
        return wrench if self.wrench_error is None else wrench + self.wrench_error


@dataclass(frozen=True, eq=False, repr=False)
class Interval(BriefFields):
    """Where a model says that each deflection lies with a stated probability, axis by axis.

    Attributes:
        lower, upper: (n, 3) m, base frame; lower <= upper.
        coverage: the probability, of each axis alone.
    """

    lower: FloatArray
    upper: FloatArray
    coverage: float

    def __post_init__(self) -> None:
        freeze(self, lower=(None, 3), upper=(None, 3))
        if self.lower.shape != self.upper.shape or (self.lower > self.upper).any():
            raise DataError("an interval's lower bounds lie above its upper bounds")


def check_coverage(coverage: float) -> None:
    """See that a nominal coverage is a probability that an interval can have.

    Raises:
        ConfigError: it is not between 0 and 1.
    """
    if not 0.0 < coverage < 1.0:
        raise ConfigError(f"{coverage:g}: must lie between 0 and 1", "coverage")


@dataclass(frozen=True, eq=False, repr=False)
class Prediction(BriefFields):
    """What a model said about the reported rows of one split, beside what was measured.

    Attributes:
        rows: (n,) row numbers in the data set.
        predicted: (n, 3) predicted deflection, m, base frame.
        measured: (n, 3) deflection of the data set, m, base frame.
        interval: of the same rows; None where none was asked for.
        reference: (n, 3) m, base frame, what the reference model (the VJM) predicts that learned
            from the same rows; None where it cannot be had.
        known: name of `KNOWN` -> (n, 3) m, base frame, of simulated data.
    """

    rows: IntArray
    predicted: FloatArray
    measured: FloatArray
    interval: Interval | None = None
    reference: FloatArray | None = None
    known: Mapping[str, FloatArray] = field(default_factory=dict)

    def __post_init__(self) -> None:
        n = len(self.rows)
        freeze(self, predicted=(n, 3), measured=(n, 3))
        if self.reference is not None:
            freeze(self, reference=(n, 3))
        if self.interval is not None and len(self.interval.lower) != n:
            raise DataError(f"{len(self.interval.lower)} intervals for {n} predictions")

    @classmethod
    def of_stored(cls, **arrays: Any) -> Self:
        """Return a prediction that was checked before it was stored, with its arrays as they are.

        Checking 35,000 of them again takes longer than a leaderboard does.
        """
        made = object.__new__(cls)
        vars(made).update(arrays)
        return made


@dataclass(frozen=True, eq=False, repr=False)
class BenchmarkData(Shown):
    """What a data set gives the engine: samples, and the robot they belong to.

    Attributes:
        samples: of one robot.
        robot: as the models are told that it is.
        known: (n, 3) deflections [m] that only a simulation knows, a row a sample, beside which a
            model's errors are read: see `KNOWN`. No model sees them, and they are no part of
            the data's hash.
        under_load: true deflection of the robot that was measured at poses and loads that it was
            not measured at, without noise, in the order in which it goes there; None where it
            cannot be asked again. It can be pickled. Only the scorer calls it: no model sees it,
            and it is no part of the hash.
        joint_turn: true turn [rad or m] of joints by (n, n_joints) torques [N m or N], which only
            a simulation knows: for figures. No model sees it, and the hash does not contain it.
        paths: points of tool paths that a protocol has corrected beside its test; None: none are.
            Their deflection is the true one without correction. No part of the hash.
    """

    samples: Samples
    robot: Robot
    known: Mapping[str, FloatArray] = field(default_factory=dict)
    under_load: Deflection | None = None
    joint_turn: Callable[[FloatArray], FloatArray] | None = None
    paths: Samples | None = None

    def __post_init__(self) -> None:
        known = {
            name: frozen_array(array, name, (len(self.samples), 3))
            for name, array in self.known.items()
        }
        object.__setattr__(self, "known", known)
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
        """Return the same samples and robot, without what only a simulation knows."""
        return BenchmarkData(self.samples, self.robot)

    @cached_property
    def sha256(self) -> str:
        """Hash of every number and name that can change a result."""
        digest = hashlib.sha256()
        for owner in (self.samples, self.robot):
            for item in fields(owner):
                value = getattr(owner, item.name)
                unstated = "hashed_where_stated" in item.metadata and not value
                if "shapes_no_result" in item.metadata or unstated:
                    continue
                digest.update(item.name.encode())
                digest.update(_canonical_bytes(value))
        return digest.hexdigest()


def _canonical_bytes(value: Any) -> bytes:
    if isinstance(value, np.ndarray) and value.dtype.kind == "f":
        # -0.0 and 0.0 are one number to every model
        return np.ascontiguousarray(value + 0.0, dtype="<f8").tobytes()
    if isinstance(value, np.ndarray):
        value = value.tolist()
    return repr(value).encode()


class StiffnessDataset(Protocol):
    """Makes or reads one data set; constructor arguments are its options."""

    def load(self) -> BenchmarkData:
        """Return samples and robot; the same options give the same numbers."""
