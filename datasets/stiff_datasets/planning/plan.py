"""Plan a measurement: robot poses with one suggested force each.

A plan is a greedy choice of random candidates (a pose and a force direction). Its rows are in the
order of their information: if time runs out, the first rows are still a good plan.

`reachable.py` describes the checks of a candidate. Other collisions are not checked: move to every
pose slowly first.
"""

from __future__ import annotations

import re
from dataclasses import dataclass, fields, replace
from pathlib import Path

import numpy as np
import pandas as pd

from stiff_datasets.measured.query_file import Loads
from stiff_datasets.measured.sample_columns import (
    DEFLECTION_COLUMNS,
    ID_COLUMNS,
    WRENCH_COLUMNS,
    file_units,
    joint_columns,
)
from stiff_datasets.measured.table_reader import write_table
from stiff_datasets.planning.design import Design
from stiff_datasets.planning.loads import stream
from stiff_datasets.planning.poses import Poses
from stiff_datasets.planning.reachable import CLEARANCE, LIMIT_MARGINS, reachable_poses
from stiff_protocols.contract.errors import ConfigError, unsupported_extension
from stiff_protocols.contract.files import check_new_file
from stiff_protocols.contract.robot import STANDARD_GRAVITY
from stiff_protocols.contract.types import FloatArray, IntArray, Robot, Samples, TextArray

FORCE_SHARE = 0.8
"""Suggested force as a share of the payload's weight, which includes tool and sensor."""

LEAST_SHARE = 0.25
"""Smallest drawn force, of `FORCE_SHARE`."""

MIN_POSE_DISTANCE = np.deg2rad(1.0)
"""rad, or m: a pose counts as measured if all joints are nearer than this to a measured pose."""

_DECIMALS_DEG, _DECIMALS_N = 4, 3


@dataclass(frozen=True, eq=False)
class MeasurementPlan(Poses, Loads):
    """Poses to measure, with one suggested load each: a force, torque zero."""

    def take(self, rows: IntArray | slice) -> MeasurementPlan:
        """Return the samples of the given row numbers, in that order."""
        return MeasurementPlan(*(getattr(self, column.name)[rows] for column in fields(self)))


def candidate_plan(
    robot: Robot,
    candidates: int,
    *,
    seed: int,
    payload_kg: float,
    clearance: float = CLEARANCE,
    weights: bool = False,
) -> MeasurementPlan:
    """Return random poses, each with a force in a random direction, or with a drawn weight.

    Joints keep `LIMIT_MARGINS` from their limits.

    Raises:
        ConfigError: an argument is out of range, or too few random poses keep the clearances.
    """
    wrench = _forces(candidates, payload_kg, seed)
    if weights:
        share = stream("plan weights", seed).uniform(LEAST_SHARE, 1.0, (candidates, 1))
        wrench[:, :3] = FORCE_SHARE * payload_kg * share * robot.gravity
    rng = stream("plan poses", robot.name, seed)
    q = reachable_poses(robot, candidates, rng, clearance, margins=LIMIT_MARGINS)
    width = len(str(candidates))
    names = np.array([f"R{i + 1:0{width}d}" for i in range(candidates)])
    return MeasurementPlan(q, wrench, names, np.full(candidates, "random"))


def chosen_plan(
    pool: MeasurementPlan, n_poses: int, design: Design, *, measured: Samples | None = None
) -> tuple[MeasurementPlan, IntArray]:
    """Choose the candidates that inform a model most.

    Args:
        pool: the candidates, from `candidate_plan` and `unmeasured`.
        n_poses: number of samples, each at a separate pose.
        design: chooses among the candidates.
        measured: existing samples, whose pose numbers are continued; None: no samples.

    Returns:
        The plan, and (n_poses,) row numbers of its candidates.

    Raises:
        ConfigError: `n_poses` is out of range. Without measurements, the three components of each
            sample must excite every joint.
    """
    if not design.fewest <= n_poses <= len(pool.q):
        joints = f" (for {pool.q.shape[1]} joints)" if design.fewest > 1 else ""
        raise ConfigError(
            f"poses is {n_poses}, expected {design.fewest}{joints} to {len(pool.q)} "
            "(the candidates)"
        )
    rows = design.choose(n_poses)
    last = 0 if measured is None else _last_number(measured.pose_id)
    width = max(2, len(str(last + n_poses)))
    names = np.array([f"P{last + i + 1:0{width}d}" for i in range(n_poses)])
    group = np.full(n_poses, design.criterion)
    return replace(pool.take(rows), pose_id=names, group=group), rows


def _last_number(pose_id: TextArray) -> int:
    """Return the largest number of a plan's pose name, such as P07; 0: no such name."""
    matches = (re.fullmatch(r"P(\d{1,9})", name) for name in pose_id.tolist())
    return max((int(match[1]) for match in matches if match), default=0)


def unmeasured(pool: MeasurementPlan, measured: Samples, robot: Robot) -> MeasurementPlan:
    """Return the candidates that do not repeat a measured pose.

    Args:
        pool: the candidates.
        measured: samples of the same robot.
        robot: the robot; a full turn of a revolute joint gives the same pose.
    """
    is_new = np.ones(len(pool.q), dtype=bool)
    for q in np.unique(measured.q, axis=0):
        distance = pool.q - q
        distance = np.where(robot.turns, (distance + np.pi) % (2.0 * np.pi) - np.pi, distance)
        is_new &= np.abs(distance).max(axis=1) >= MIN_POSE_DISTANCE
    return pool.take(np.flatnonzero(is_new))


def plan_table(plan: MeasurementPlan, robot: Robot) -> pd.DataFrame:
    """Return a plan in the schema of measured data, its deflection columns empty.

    Joint angles have 4 decimals of a degree (of a millimetre for prismatic joints) and are never
    rounded out of the limits; forces have 3 decimals.
    """
    table = pd.DataFrame(
        dict(zip(ID_COLUMNS, (plan.pose_id, "1", plan.group), strict=True))
        | joint_cells(plan.q, robot)
        | dict(zip(WRENCH_COLUMNS, plan.wrench.round(_DECIMALS_N).T + 0.0, strict=True))
    )
    return table.assign(**dict.fromkeys(DEFLECTION_COLUMNS, np.nan))


def joint_cells(q: FloatArray, robot: Robot) -> dict[str, FloatArray]:
    """Return the columns of (n, n_joints) planned joint positions, rad or m, in file units."""
    units, steps = file_units(robot), 10**_DECIMALS_DEG
    lower = np.ceil(robot.lower * units * steps) / steps
    upper = np.floor(robot.upper * units * steps) / steps
    q_file = np.clip((q * units).round(_DECIMALS_DEG), lower, upper) + 0.0  # no -0.0
    return dict(zip(joint_columns(robot), q_file.T, strict=True))


def check_plan_file(path: Path) -> None:
    """Check before the calculation that a plan can be written.

    Raises:
        ConfigError: the file does not end in .csv.
        StoreError: its folder does not exist, or the file exists and may hold measured deflections.
    """
    if path.suffix != ".csv":
        raise unsupported_extension(path, [".csv"])
    check_new_file(path)


def write_plan(path: Path, plan: MeasurementPlan, robot: Robot) -> None:
    """Write `plan_table` as CSV, completely or not at all.

    Raises:
        ConfigError: see `check_plan_file`.
        StoreError: the file cannot be written; see also `check_plan_file`.
    """
    check_plan_file(path)
    write_table(path, [plan_table(plan, robot)])


def _forces(n: int, payload_kg: float, seed: int) -> FloatArray:
    """Return (n, 6) wrenches: forces in random directions, torque zero."""
    if not (np.isfinite(payload_kg) and payload_kg > 0):
        raise ConfigError(f"payload_kg is {payload_kg:g}, expected a number above 0")
    direction = stream("plan forces", seed).normal(size=(n, 3))
    direction /= np.linalg.norm(direction, axis=1, keepdims=True)
    return np.hstack([FORCE_SHARE * payload_kg * STANDARD_GRAVITY * direction, np.zeros((n, 3))])
