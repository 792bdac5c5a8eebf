"""Plan readings of a dial gauge: a pose, one force of a workshop and one axis of the gauge each.

A workshop has weights, which pull down, and a rope over a pulley, which pulls in one direction. The
sizes of the forces are drawn, because springs are not linear. Checked are the joint limits and the
arm's centre line; room for the weight, the rope and the gauge's stand is not.
"""

from __future__ import annotations

import re
from dataclasses import dataclass, fields
from pathlib import Path

import numpy as np
import pandas as pd

from stiff_datasets.measured.sample_columns import DIRECTION_COLUMNS, ID_COLUMNS
from stiff_datasets.measured.table_reader import write_table
from stiff_datasets.planning.design import SpringDesign
from stiff_datasets.planning.loads import hook_wrenches, stream
from stiff_datasets.planning.plan import (
    FORCE_SHARE,
    LEAST_SHARE,
    MeasurementPlan,
    check_plan_file,
    joint_cells,
)
from stiff_datasets.planning.reachable import LIMIT_MARGINS, reachable_poses
from stiff_protocols.contract.errors import ConfigError
from stiff_protocols.contract.types import AXES, FloatArray, IntArray, Robot

WEIGHT = "weight"
_NUMBER = r"[+-]?(?:\d+\.?\d*|\.\d+)"
_FORCE = re.compile(rf"{WEIGHT}|pull:{_NUMBER},{_NUMBER},{_NUMBER}")
_DECIMALS_KG, _DECIMALS_N = 2, 1


@dataclass(frozen=True, eq=False)
class ReadingPlan(MeasurementPlan):
    """Readings to take.

    Attributes:
        force: (n, 3) force at the hook, N, base frame.
        direction: (n, 3) unit vector in which the gauge counts up, base frame.
    """

    force: FloatArray
    direction: FloatArray

    def take(self, rows: IntArray | slice) -> ReadingPlan:
        """Return the readings of the given row numbers, in that order."""
        return ReadingPlan(*(getattr(self, column.name)[rows] for column in fields(self)))


def force_directions(words: str, robot: Robot) -> FloatArray:
    """Return the (k, 3) unit vectors of forces such as "weight,pull:0,1,0", base frame.

    Raises:
        ConfigError: a word is not a weight or a pull with a direction.
    """
    if not re.fullmatch(rf"(?:{_FORCE.pattern})(?:,(?:{_FORCE.pattern}))*", words):
        raise ConfigError(f"{words!r} (valid: {WEIGHT}, pull:X,Y,Z, or several)", "forces")
    pulls = [word.partition(":")[2].split(",") for word in _FORCE.findall(words)]
    vectors = [np.array(pull, dtype=float) if any(pull) else robot.gravity for pull in pulls]
    lengths = np.linalg.norm(vectors, axis=1, keepdims=True)
    if not lengths.all():
        raise ConfigError(f"{words!r}: a pull along 0,0,0 has no direction", "forces")
    return np.asarray(vectors / lengths)


def axis_directions(words: str) -> FloatArray:
    """Return the (k, 3) unit vectors of axes such as "z,y"; ConfigError for another word."""
    names = words.split(",")
    if not set(names) <= set(AXES) or len(set(names)) < len(names):
        raise ConfigError(f"{words!r} (valid: x, y, z, or several of them)", "axes")
    return np.eye(3)[[AXES.index(name) for name in names]]


def candidate_readings(
    robot: Robot,
    poses: int,
    forces: FloatArray,
    axes: FloatArray,
    *,
    seed: int,
    payload_kg: float,
    clearance: float,
    hook: FloatArray,
) -> ReadingPlan:
    """Return each of some random poses with every force, in drawn sizes, and every axis.

    Args:
        robot: the robot.
        poses: number of random poses.
        forces: (f, 3) unit vectors of forces, base frame.
        axes: (a, 3) unit vectors of the gauge, base frame.
        seed: draws poses and sizes.
        payload_kg: rated payload.
        clearance: see `reachable_poses`.
        hook: (3,) where the forces act, frame of the last link, m.

    Raises:
        ConfigError: an argument is out of range, or too few random poses keep the clearances.
    """
    rng = stream("reading poses", robot.name, seed)
    q = reachable_poses(robot, poses, rng, clearance, margins=LIMIT_MARGINS)
    largest = FORCE_SHARE * payload_kg * float(np.linalg.norm(robot.gravity))
    pose, force, axis = (part.ravel() for part in np.indices((poses, len(forces), len(axes))))
    size = rng.uniform(LEAST_SHARE, 1.0, (poses, len(forces)))[pose, force] * largest
    vector = size[:, None] * forces[force]
    names = np.array([f"R{number:06d}" for number in pose])
    group = np.full(len(pose), "random")
    wrench = hook_wrenches(vector, robot.lever(q, hook)[pose])
    return ReadingPlan(q[pose], wrench, names, group, vector, axes[axis])


def chosen_readings(pool: ReadingPlan, n: int, design: SpringDesign) -> ReadingPlan:
    """Return the n readings that a design chooses, the rows of a pose together.

    Raises:
        ConfigError: there are fewer candidates.
    """
    if not design.fewest <= n <= len(pool.q):
        raise ConfigError(f"{n}: expected {design.fewest} to {len(pool.q)}", "readings")
    rows = design.choose(n)
    _, first, pose = np.unique(pool.pose_id[rows], return_index=True, return_inverse=True)
    number = np.argsort(np.argsort(first))[pose]
    order = np.argsort(number, kind="stable")
    width = max(2, len(str(len(first))))
    plan = pool.take(rows[order])
    names = np.array([f"P{k + 1:0{width}d}" for k in number[order]])
    group = np.full(n, design.criterion)
    return ReadingPlan(plan.q, plan.wrench, names, group, plan.force, plan.direction)


def reading_table(plan: ReadingPlan, robot: Robot) -> pd.DataFrame:
    """Return the plan as a file to fill in: masses and pulls, and empty readings of the gauge."""
    down = robot.gravity / np.linalg.norm(robot.gravity)
    size = np.linalg.norm(plan.force, axis=1)
    hangs = plan.force @ down > size * (1.0 - 1e-9)
    mass = (size / np.linalg.norm(robot.gravity)).round(_DECIMALS_KG)
    pull = plan.force / size[:, None]
    load = pd.Series(plan.pose_id).groupby(plan.pose_id).cumcount() + 1
    table = pd.DataFrame(
        dict(zip(ID_COLUMNS, (plan.pose_id, load.astype(str), plan.group), strict=True))
        | joint_cells(plan.q, robot)
    )
    columns: dict[str, FloatArray] = {}
    if hangs.any():
        columns["mass_kg"] = np.where(hangs, mass, np.nan)
    if not hangs.all():
        columns["pull_N"] = np.where(hangs, np.nan, size.round(_DECIMALS_N))
        for axis, part in zip(AXES, pull.T, strict=True):
            columns[f"pull_{axis}"] = np.where(hangs, np.nan, part.round(6) + 0.0)
    columns |= dict(zip(DIRECTION_COLUMNS, plan.direction.T, strict=True))
    return table.assign(**columns, reading0_mm=np.nan, reading1_mm=np.nan)


def write_readings(path: Path, plan: ReadingPlan, robot: Robot) -> None:
    """Write `reading_table` as CSV, completely or not at all; errors as `check_plan_file`."""
    check_plan_file(path)
    write_table(path, [reading_table(plan, robot)])
