"""Compare 40 readings of a dial gauge with 20 poses of a tracker, on simulated robots.

`python results/scripts/dial_gauge.py` prints, for 12 fresh arms in the worlds clean and friction,
the mean 3-D error [mm] of `bayes-springs` against the true deflection under forces in all
directions, over three draws of plan, approach and noise: after 20 poses of a tracker
(`bench data plan --poses 20`), after 40 readings by weight
and rope (`bench data plan --readings 40`), after the same with a second pull and axis, and after 40
readings by weights only. A reading has 10 micrometres of noise, a tracker's deflection 14.
"""

from __future__ import annotations

import sys
import warnings

import numpy as np

from stiff_bench.analysis.pose_plans import PlanOptions, first_plan, reading_plan
from stiff_datasets.planning.loads import omni_forces, stream
from stiff_datasets.planning.plan import FORCE_SHARE
from stiff_datasets.planning.reachable import reachable_poses
from stiff_datasets.twin.fresh_arms import fresh_arm
from stiff_datasets.twin.twin import DigitalTwin
from stiff_models.model_catalog import model_info
from stiff_protocols.contract.types import Samples

ROBOTS, WORLDS, DRAWS, N_TESTED = 12, ("clean", "friction"), 3, 100
GAUGE_NOISE = 1e-5
"""m, of a reading; a tracker's deflection is the difference of two readings."""
WAYS = {
    "weight and rope": ("weight,pull:0,1,0", "z,y"),
    "two ropes": ("weight,pull:0,1,0,pull:1,0,0", "z,y,x"),
    "weights": ("weight", "z,y"),
}


def errors(seed, world, ways):
    """Return the mean error over the draws, mm, by way of measuring."""
    drawn = [errors_of_draw(seed, world, ways, draw) for draw in range(DRAWS)]
    return {way: float(np.mean([error[way] for error in drawn])) for way in drawn[0]}


def errors_of_draw(seed, world, ways, draw):
    """Return the error, mm, by way of measuring."""
    constants = fresh_arm(seed)
    twin = DigitalTwin.in_world(constants, 0, world)
    robot, rng = twin.description, stream("dial gauge", seed, world, draw)
    how = PlanOptions(20, None, None, constants.payload_kg, constants.clearance_m, draw)
    q = reachable_poses(robot, N_TESTED, rng, constants.clearance_m)
    force = omni_forces(N_TESTED, constants.payload_kg, rng, FORCE_SHARE)
    wrench = np.hstack([force, np.zeros_like(force)])
    truth = twin.truth(q, wrench)

    def error(plan, directions, noise):
        n = len(plan.q)
        approach = rng.choice([-1.0, 1.0], plan.q.shape)
        moved = twin.readings(plan.q, plan.wrench[:, None], approach, cycled=False).tcp[:, 0]
        moved = moved + rng.normal(scale=noise, size=moved.shape)
        if directions.size:
            moved = (moved * directions[:, 0]).sum(axis=1, keepdims=True) * directions[:, 0]
        numbers = np.arange(n).astype(str)
        samples = Samples(
            plan.q,
            plan.wrench,
            moved,
            plan.pose_id,
            numbers,
            plan.group,
            GAUGE_NOISE,
            directions=directions,
        )
        model = model_info("bayes-springs").load()().fit(samples, robot=robot)
        return 1e3 * np.linalg.norm(model.predict(q, wrench) - truth, axis=1).mean()

    tracker = constants.noise.tracker_m * np.sqrt(2.0)
    found_errors = {"tracker": error(first_plan(robot, how).plan, np.empty(0), tracker)}
    for way in ways:
        plan = reading_plan(robot, how, 40, *WAYS[way], None).plan
        found_errors[way] = error(plan, plan.direction[:, None], GAUGE_NOISE)
    return found_errors


def main():
    """Print a row a robot."""
    warnings.simplefilter("ignore")
    ways = [way for way in WAYS if way in sys.argv] or [*WAYS]
    worlds = [world for world in WORLDS if world in sys.argv] or WORLDS
    for world in worlds:
        ratios = []
        for seed in range(ROBOTS):
            found_errors = errors(seed, world, ways)
            ratios.append([found_errors[way] / found_errors["tracker"] for way in ways])
            numbers = ", ".join(f"{way} {error:.4f}" for way, error in found_errors.items())
            print(f"{world} fresh-arm-{seed}: {numbers} mm", flush=True)
        for way, column in zip(ways, np.array(ratios).T, strict=True):
            within = int((column <= 1.3).sum())
            print(
                f"{world}, {way}: median ratio {np.median(column):.2f}, {within} of {ROBOTS} <= 1.3"
            )


if __name__ == "__main__":
    main()
