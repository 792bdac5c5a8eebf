"""Next poses of `bench data plan --after` on twins: how much more do they tell than random ones?

`python results/scripts/planned_poses.py` prints the table of docs/faults.md (minutes).
"""

from __future__ import annotations

import warnings
from dataclasses import dataclass

import numpy as np
from tabulate import tabulate

from stiff_bench.analysis.pose_plans import Measured, PlanOptions, next_plan
from stiff_bench.plan.options import Choice
from stiff_bench.run.final_fit import final_fit
from stiff_datasets.planning.plan import MeasurementPlan, candidate_plan
from stiff_datasets.twin.experiment import TwinExperiment, recorded_deflection, recorded_wrench
from stiff_datasets.twin.twin_file import TwinConstants, shipped_constants
from stiff_models.model_catalog import model_info
from stiff_protocols.contract.types import Samples

TWINS = {"kr10-twin": "kr10_r1100_2", "ur5-twin": "ur5", "arm-family (gp12)": "gp12"}
CASES = (("vjm", 5, 5), ("vjm", 40, 20), ("vjm-gp", 40, 20), ("gp", 40, 20))
"""Model, poses measured, poses planned after them."""
TESTED, CANDIDATES, SEEDS = 500, 2000, 5


@dataclass(frozen=True)
class Outcome:
    """What poses gain after others."""

    ratio: float  # by how much more than random poses the plan lowers the mean variance
    lowered: float  # share by which the plan lowers it
    errors: tuple[float, float, float]  # mean 3-D, mm: before, with random poses, with the plan


def measured(constants: TwinConstants, plan: MeasurementPlan, seed: int) -> Samples:
    """Return a twin's samples at the poses of a plan, under its loads."""
    experiment = TwinExperiment(constants, specimen=0, seed=seed)
    rng, noise = experiment.stream("noise"), constants.noise
    deflection = experiment.twin.truth(experiment.logged_q(plan), plan.wrench)
    wrench = recorded_wrench(plan.wrench, noise, rng)
    return experiment.rows(plan, wrench, recorded_deflection(deflection, noise, rng))


def outcome(twin: str, model: str, n_measured: int, n_new: int, seed: int) -> Outcome:
    constants, choice = shipped_constants(TWINS[twin]), Choice.of(model_info(model))
    robot = constants.robot()

    def random(n: int, seed: int) -> MeasurementPlan:
        return candidate_plan(robot, n, seed=seed, payload_kg=constants.payload_kg)

    samples = measured(constants, random(n_measured, 1000 + seed), seed)
    tested = measured(constants, random(TESTED, 2000 + seed), 2000 + seed)
    how = PlanOptions(n_new, None, CANDIDATES, constants.payload_kg, 0.2, seed)
    pose_plan = next_plan(Measured("my.csv", samples, robot, choice), how)

    def error(*new: MeasurementPlan) -> float:
        parts = (measured(constants, plan, 3000 + seed) for plan in new)
        fitted, _ = final_fit(choice, Samples.together(samples, *parts), robot)
        predicted = fitted.predict(tested.q, tested.wrench)
        return float(np.linalg.norm(predicted - tested.deflection, axis=1).mean() * 1000.0)

    errors = (error(), error(random(n_new, 4000 + seed)), error(pose_plan.plan))
    return Outcome(pose_plan.gain.ratio, 1.0 - pose_plan.gain.plan / pose_plan.gain.before, errors)


def row(twin: str, model: str, n_measured: int, n_new: int) -> list[str]:
    outcomes = [outcome(twin, model, n_measured, n_new, seed) for seed in range(SEEDS)]
    ratios = [seed_outcome.ratio for seed_outcome in outcomes]
    lowered = np.mean([seed_outcome.lowered for seed_outcome in outcomes])
    errors = np.mean([seed_outcome.errors for seed_outcome in outcomes], axis=0)
    times = f"{np.mean(ratios):.2f} ({min(ratios):.2f} to {max(ratios):.2f})"
    about = [f"`{twin}`", f"`{model}`", f"{n_measured} + {n_new}", f"{lowered:.0%}", times]
    return [*about, *(f"{error:.3f}" for error in errors)]


if __name__ == "__main__":
    warnings.simplefilter("ignore")
    header = "twin,model,poses,variance lowered,times random,error before [mm],+ random,+ planned"
    rows = [row(twin, *case) for twin in TWINS for case in CASES]
    print(tabulate(rows, header.split(","), tablefmt="github", disable_numparse=True))
