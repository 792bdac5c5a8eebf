"""Do 90 % intervals hold between the measured poses, and under other loads?

`python results/scripts/coverage_between_poses.py` prints the table of docs/models.md (a minute);
with the word `planned`, the table of twins measured by `bench data plan`.
"""

from __future__ import annotations

import sys
import warnings
from dataclasses import dataclass
from typing import Literal

import numpy as np
from tabulate import tabulate

import stiffbench as sb
from planned_poses import measured
from stiff_bench.analysis.pose_plans import PlanOptions, first_plan
from stiff_bench.plan.options import held_data
from stiff_datasets.twin.twin import DigitalTwin
from stiff_datasets.twin.twin_file import shipped_constants
from stiff_protocols.contract.training_range import TrainingRange
from stiff_protocols.contract.types import BenchmarkData, FloatArray, Samples

DATASETS = ("kr10-twin", "arm-family@robot=0", "arm-family@robot=4")
MODELS = ("vjm", "gp", "vjm-gp", "bayes-springs")
Loads = Literal["measured", "any direction"]
LOADS: tuple[Loads, ...] = ("measured", "any direction")
TWINS, PLANNED = ("kr10_r1100_2", "gp12", "ur5"), (30, 60, 120)
PLANNED_MODELS = ("vjm", "vjm-full", "gp", "vjm-gp", "bayes-springs")
CANDIDATES, CLEARANCE = 2000, 0.2
N_POSES, COVERAGE, NOISE_MM = 500, 0.9, 0.014
"""Random poses; nominal coverage of an axis; noise of a tracker's deflection."""


@dataclass(frozen=True)
class Held:
    """Shares of random poses inside their intervals, of each axis (3,).

    Attributes:
        marked: share of the poses that `extrapolates` marks.
        plain: at the poses without a mark, with intervals that do not grow with the distance.
        near: at the poses without a mark.
        far: at the marked poses; NaN where there are none.
    """

    marked: float
    plain: FloatArray
    near: FloatArray
    far: FloatArray


def drawn(
    samples: Samples, training_range: TrainingRange, loads: Loads
) -> tuple[FloatArray, FloatArray]:
    """Return random (N_POSES, n_joints) poses inside the joint box, and (N_POSES, 6) loads.

    Measured loads are drawn from the samples. Loads in any direction are uniform in the balls whose
    radii are the largest measured force and torque.
    """
    rng = np.random.default_rng(1)
    q = rng.uniform(
        training_range.lower, training_range.upper, (N_POSES, len(training_range.lower))
    )
    if loads == "measured":
        return q, samples.wrench[rng.integers(len(samples), size=N_POSES)]
    direction = rng.normal(size=(N_POSES, 2, 3))
    direction /= np.linalg.norm(direction, axis=2, keepdims=True)
    radius = np.array([training_range.force, training_range.torque]) * rng.uniform(
        size=(N_POSES, 2)
    ) ** (1.0 / 3.0)
    return q, (direction * radius[:, :, None]).reshape(N_POSES, 6)


def held(dataset: sb.Dataset, model: sb.Model, loads: Loads) -> Held:
    """Compare a fitted model's intervals with the deflections of its data's twin."""
    training_range, truth = model.training_range, dataset.data.under_load
    assert truth is not None
    q, wrench = drawn(dataset.samples, training_range, loads)
    noise = np.random.default_rng(2).normal(scale=NOISE_MM / 1000.0, size=(N_POSES, 3))
    deflection = truth(q, wrench) + noise
    interval = model.predict_interval(q, wrench, COVERAGE)
    middle, half = (interval.lower + interval.upper) / 2, (interval.upper - interval.lower) / 2
    error = np.abs(deflection - middle)
    inside, plain = error <= half, error <= half / training_range.stretch(q, wrench)[:, None]
    marked = np.array([bool(words) for words in training_range.extrapolates(q, wrench)])
    far = inside[marked].mean(axis=0) if marked.any() else np.full(3, np.nan)
    return Held(marked.mean(), plain[~marked].mean(axis=0), inside[~marked].mean(axis=0), far)


def rows(name: str, key: str) -> list[list[str]]:
    dataset = sb.load_dataset(name)
    model = sb.make_model(key).fit(dataset)
    table_rows = []
    for loads in LOADS:
        shares_held = held(dataset, model, loads)
        shares = (shares_held.plain, shares_held.near, shares_held.far)
        texts = [f"{100 * np.mean(share):.0f} ({axes(share)})" for share in shares]
        if np.isnan(shares_held.far).any():
            texts[2] = "-"
        table_rows.append([f"`{name}`", f"`{key}`", loads, f"{shares_held.marked:.0%}", *texts])
    return table_rows


def planned(twin: str, n_poses: int) -> sb.Dataset:
    """Return a twin's data set at the poses that `bench data plan` chooses for its robot."""
    constants = shipped_constants(twin)
    robot = constants.robot()
    how = PlanOptions(n_poses, None, CANDIDATES, constants.payload_kg, CLEARANCE, 0)
    samples = measured(constants, first_plan(robot, how).plan, 0)
    under_load = DigitalTwin.in_world(constants, 0, "clean").truth
    data = BenchmarkData(samples, robot, under_load=under_load)
    return sb.Dataset(held_data(data, f"{twin}, {n_poses} poses"))


def planned_rows(twin: str, n_poses: int) -> list[str]:
    dataset, texts = planned(twin, n_poses), []
    for key in PLANNED_MODELS:
        shares = held(dataset, sb.make_model(key).fit(dataset), "measured")
        texts.append(f"{100 * np.mean(shares.near):.0f} ({axes(shares.near)})")
    return [f"`{twin}`", str(n_poses), *texts]


def axes(share: FloatArray) -> str:
    return ", ".join(f"{100 * part:.0f}" for part in share)


if __name__ == "__main__":
    warnings.simplefilter("ignore")
    if sys.argv[1:] == ["planned"]:
        header = ["twin", "poses", *(f"`{key}`" for key in PLANNED_MODELS)]
        table = [planned_rows(twin, n_poses) for twin in TWINS for n_poses in PLANNED]
    else:
        header = ["data", "model", "loads", "marked"]
        header += ["inside, not widened [%]", "inside [%]", "inside where marked [%]"]
        table = [row for name in DATASETS for key in MODELS for row in rows(name, key)]
    print(tabulate(table, header, tablefmt="github", disable_numparse=True))
