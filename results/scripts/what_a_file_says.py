"""What are more loads at a pose, and the columns order and approach, worth to bayes-springs?

`python results/scripts/what_a_file_says.py` prints the error against the true robot over the error
with one load a pose and neither column, as a geometric mean over the ten arms of arm-family.
"""

from __future__ import annotations

import warnings
from dataclasses import replace

import numpy as np
import pandas as pd
from tabulate import tabulate
from threadpoolctl import threadpool_limits

from stiff_datasets.twin.effects import World
from stiff_datasets.twin.experiment import TwinExperiment
from stiff_datasets.twin.robot_twin import ARMS, HEAVIEST, POSES, random_poses
from stiff_datasets.twin.twin_file import shipped_constants
from stiff_models.regressors.bayes_springs import BayesSprings
from stiff_protocols.contract.types import FloatArray, Samples

SEED, WORLDS = 0, ("friction", "workshop", "all")
SIZES = (20, 60)
TESTED = 120
"""The poses from this number on are test poses."""
MORE = ("approach", "order", "three loads")


class Arm:
    """An arm in a world, measured at 151 poses with one load and with three."""

    def __init__(self, name: str, world: World) -> None:
        """Simulate both measurements; each row states its order and approach."""
        constants = shipped_constants(name)
        poses = random_poses(constants, POSES, SEED)
        self.measured: dict[int, Samples] = {}
        for n_loads in (1, 3):
            experiment = TwinExperiment(
                constants,
                specimen=0,
                seed=SEED,
                world=world,
                loads_per_pose=n_loads,
                max_load_share=HEAVIEST,
            )
            samples, _, _, direction = experiment.measurement(poses)
            order = np.arange(float(len(samples)))
            self.measured[n_loads] = replace(samples, order=order, approach=direction)
        self.twin = experiment.twin
        self.poses = np.random.default_rng(SEED).permutation(poses.pose_id)

    def error(self, n_poses: int, more: str = "") -> float:
        """Return the mean 3-D error [m] at test poses after a fit to the first `n_poses`."""
        samples = self.measured[3 if more == "three loads" else 1]
        train = samples.take(np.flatnonzero(np.isin(samples.pose_id, self.poses[:n_poses])))
        columns = {name: np.empty(0) for name in ("order", "approach") if name != more}
        model = BayesSprings().fit(replace(train, **columns), robot=self.twin.description)
        q, wrench, truth = self._tests
        return float(np.linalg.norm(model.predict(q, wrench) - truth, axis=1).mean())

    @property
    def _tests(self) -> tuple[FloatArray, FloatArray, FloatArray]:
        samples = self.measured[1]
        test = samples.take(np.flatnonzero(np.isin(samples.pose_id, self.poses[TESTED:])))
        return test.q, test.wrench, self.twin.truth(test.q, test.wrench)


def main() -> None:
    """Print a table of ratios: worlds and numbers of poses by what the file says more."""
    rows = {}
    for world in WORLDS:
        arms = [Arm(name, world) for name in ARMS]
        plain = {n: np.array([arm.error(n) for arm in arms]) for n in SIZES}
        for n in SIZES:
            ratios = {
                more: np.array([arm.error(n, more) for arm in arms]) / plain[n] for more in MORE
            }
            if n == SIZES[0]:
                ratios["60 poses, one load"] = plain[SIZES[1]] / plain[n]
            rows[f"{world}, {n} poses"] = {
                more: float(np.exp(np.log(ratio).mean())) for more, ratio in ratios.items()
            }
    print(tabulate(pd.DataFrame(rows).T, headers="keys", floatfmt=".2f"))


if __name__ == "__main__":
    with threadpool_limits(1), warnings.catch_warnings():
        warnings.simplefilter("ignore")
        main()
