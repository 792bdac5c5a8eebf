"""What to measure: robot poses with one suggested force each.

A chosen plan is a greedy choice among random candidates (a pose and a force direction), so its
rows stand in the order of their worth: where time runs out, the first rows are the plan.

`reachable.py` says what is checked of a candidate and what is not: move to every pose slowly first.
"""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Literal

import numpy as np
import pandas as pd

from stiff_datasets.measured.identifiability import choose_by_condition, choose_d_optimal, regressor
from stiff_datasets.measured.sample_files import (
    DEFLECTION_COLUMNS,
    ID_COLUMNS,
    WRENCH_COLUMNS,
    file_units,
    joint_columns,
)
from stiff_datasets.planning.loads import G, stream
from stiff_datasets.planning.poses import Poses, paper_poses
from stiff_datasets.planning.reachable import CLEARANCE, LOWEST_HEIGHT, keeps_clear, reachable_poses
from stiff_datasets.robots.robot import ChainModel, robot_of
from stiff_protocols.contract.errors import ConfigError, StoreError
from stiff_protocols.contract.files import refuse_existing, written_whole
from stiff_protocols.contract.types import FloatArray, Robot

Criterion = Literal["d-optimal", "condition"]

PAPER_ROBOT = "kr10_r1100_2"
"""The robot whose 151 poses the source paper gives."""

FORCE_SHARE = 0.8
"""Size of a suggested force as a share of the payload's weight; the rest is for tool and sensor."""

_DECIMALS_DEG, _DECIMALS_N = 4, 3


@dataclass(frozen=True, eq=False)
class MeasurementPlan(Poses):
    """Poses and one load at each to measure.

    Attributes:
        wrench: (n, 6) suggested load at the TCP, base frame: a force [N], torque zero [N m].
    """

    wrench: FloatArray


def paper_plan(
    chain: ChainModel, payload_kg: float, seed: int, clearance: float = CLEARANCE
) -> MeasurementPlan:
    """Return the paper's 151 poses, each with one force in a random direction.

    Raises:
        ConfigError: the robot is another one, an argument is out of range, or a pose does not
            keep the clearances (with a tool much longer than the default one).
        DataError: the TCP cannot reach the paper's grid.
    """
    if chain.name != PAPER_ROBOT:
        raise ConfigError(f"the paper's plan is for {PAPER_ROBOT}, not for {chain.name}")
    poses = paper_poses(chain)
    free = keeps_clear(robot_of(chain), poses.q, clearance)
    if not free.all():
        names = ", ".join(poses.pose_id[~free][:5].tolist())
        raise ConfigError(
            f"{(~free).sum()} of the paper's poses ({names}, ...) do not keep a clearance of "
            f"{clearance:g} m to the base and {LOWEST_HEIGHT:g} m to the mounting plane with the "
            "TCP given; choose poses with --poses, or ask for a smaller clearance"
        )
    wrench = _forces(len(poses.q), payload_kg, seed)
    return MeasurementPlan(poses.q, poses.pose_id, poses.group, wrench)


def candidate_plan(
    chain: ChainModel,
    candidates: int,
    *,
    seed: int,
    payload_kg: float,
    clearance: float = CLEARANCE,
) -> MeasurementPlan:
    """Return random poses, each with a force in a random direction; arguments as `chosen_plan`.

    Raises:
        ConfigError: an argument is out of range, or too few random poses keep the clearances.
        DataError: a joint has more than one degree of freedom.
    """
    wrench = _forces(candidates, payload_kg, seed)
    q = reachable_poses(chain, candidates, stream("plan poses", chain.name, seed), clearance)
    width = len(str(candidates))
    names = np.array([f"R{i + 1:0{width}d}" for i in range(candidates)])
    return MeasurementPlan(q, names, np.full(candidates, "random"), wrench)


def chosen_plan(
    chain: ChainModel, pool: MeasurementPlan, n_poses: int, *, criterion: Criterion = "d-optimal"
) -> MeasurementPlan:
    """Choose from candidates those that identify the joint compliances best.

    Args:
        chain: the robot, at least three joints.
        pool: what `candidate_plan` gives.
        n_poses: number of samples, each at a pose of its own.
        criterion: "d-optimal" (largest determinant of the information matrix) or "condition"
            (smallest condition number of the column-scaled regressor).

    Raises:
        ConfigError: `n_poses` is out of range: it takes three components of a deflection a
            sample to see every joint.
    """
    fewest = -(-chain.model.nv // 3)
    if not fewest <= n_poses <= len(pool.q):
        raise ConfigError(
            f"poses is {n_poses}, expected {fewest} (for {chain.model.nv} joints) to "
            f"{len(pool.q)} (the candidates)"
        )
    choose = choose_d_optimal if criterion == "d-optimal" else choose_by_condition
    rows = choose(regressor(chain, pool.q, pool.wrench), n_poses)
    width = max(2, len(str(n_poses)))
    names = np.array([f"P{i + 1:0{width}d}" for i in range(n_poses)])
    return MeasurementPlan(pool.q[rows], names, np.full(n_poses, criterion), pool.wrench[rows])


def plan_table(plan: MeasurementPlan, robot: Robot) -> pd.DataFrame:
    """Return a plan in the schema of measured data, its deflection columns empty.

    Joint angles have 4 decimals of a degree (of a millimetre for prismatic joints) and are never
    rounded out of the limits; forces have 3 decimals.
    """
    units = file_units(robot)
    q_file = _rounded_inside(plan.q * units, robot.lower * units, robot.upper * units)
    table = pd.DataFrame(
        dict(zip(ID_COLUMNS, (plan.pose_id, "1", plan.group), strict=True))
        | dict(zip(joint_columns(robot), q_file.T, strict=True))
        | dict(zip(WRENCH_COLUMNS, plan.wrench.round(_DECIMALS_N).T + 0.0, strict=True))
    )
    return table.assign(**dict.fromkeys(DEFLECTION_COLUMNS, np.nan))


def check_plan_file(path: Path) -> None:
    """See that a plan can be written, before the work is done.

    Raises:
        ConfigError: the file does not end in .csv.
        StoreError: its folder is not there, or it exists: it may hold measured deflections.
    """
    if path.suffix != ".csv":
        raise ConfigError(f"{path}: {path.suffix!r} (valid ending of a plan: .csv)")
    refuse_existing(path)
    if not path.parent.is_dir():
        raise StoreError(f"{path}: cannot be written: no folder {path.parent}")


def write_plan(path: Path, plan: MeasurementPlan, robot: Robot) -> None:
    """Write `plan_table` as CSV, whole or not at all.

    Raises:
        ConfigError: see `check_plan_file`.
        StoreError: the file cannot be written; see also `check_plan_file`.
    """
    check_plan_file(path)
    table = plan_table(plan, robot)
    with written_whole(path) as temporary:
        table.to_csv(temporary, index=False, lineterminator="\n")


def _forces(n: int, payload_kg: float, seed: int) -> FloatArray:
    """Return (n, 6) wrenches: forces in random directions, torque zero."""
    if not (np.isfinite(payload_kg) and payload_kg > 0):
        raise ConfigError(f"payload_kg is {payload_kg:g}, expected a number above 0")
    direction = stream("plan forces", seed).normal(size=(n, 3))
    direction /= np.linalg.norm(direction, axis=1, keepdims=True)
    return np.hstack([FORCE_SHARE * payload_kg * G * direction, np.zeros((n, 3))])


def _rounded_inside(values: FloatArray, lower: FloatArray, upper: FloatArray) -> FloatArray:
    """Round to `_DECIMALS_DEG`, away from a limit that rounding would cross."""
    step = 10.0**-_DECIMALS_DEG
    rounded = values.round(_DECIMALS_DEG)
    rounded = np.where(rounded > upper, (rounded - step).round(_DECIMALS_DEG), rounded)
    rounded = np.where(rounded < lower, (rounded + step).round(_DECIMALS_DEG), rounded)
    return np.asarray(rounded + 0.0)  # no -0.0
