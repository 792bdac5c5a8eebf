"""Do the 90 % intervals of bayes-springs hold the true robot's deflections?

`python results/scripts/coverage_of_the_truth.py` prints, for four arms, the share of true
deflections at left-out poses inside the intervals of the robot, by world and training poses.
"""

from __future__ import annotations

import warnings

import numpy as np
import pandas as pd
from scipy.special import ndtri
from tabulate import tabulate
from threadpoolctl import threadpool_limits

import stiffbench as sb
from stiff_models.regressors.bayes_springs import BayesSprings
from stiff_protocols.contract.types import TRUTH

ROBOTS, WORLDS = (0, 3, 5, 8), ("clean", "friction", "structure", "workshop", "all")
POSES, COVERAGE, SEED = (20, 60, 120), 0.9, 7


def share_inside(robot: int, world: str, n_poses: int) -> float:
    """Return the share [%] of true deflections inside the intervals, mean over the axes."""
    data = sb.load_dataset(f"arm-family@robot={robot}@world={world}").data
    rows = np.random.default_rng(SEED).permutation(len(data.samples))
    train, test = data.samples.take(rows[:n_poses]), data.samples.take(rows[n_poses:])
    model = BayesSprings().fit(train, robot=data.robot)
    error = np.abs(
        model.predict(test.q, test.wrench) - data.bound_deflections[TRUTH][rows[n_poses:]]
    )
    half_width = ndtri(0.5 + COVERAGE / 2.0) * model.deviation(test.q, test.wrench, reading=False)
    return float(100.0 * (error <= half_width).mean())


def main() -> None:
    """Print the mean share over the robots."""
    shares = {
        f"{n_poses} poses": [
            np.mean([share_inside(robot, world, n_poses) for robot in ROBOTS]) for world in WORLDS
        ]
        for n_poses in POSES
    }
    print(tabulate(pd.DataFrame(shares, index=WORLDS), headers="keys", floatfmt=".0f"))


if __name__ == "__main__":
    with threadpool_limits(1), warnings.catch_warnings():
        warnings.simplefilter("ignore")
        main()
