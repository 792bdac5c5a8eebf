"""Calibration of the KR10 twin's free constants against the source paper's VJM figures.

The linear VJM is identified on all 151 samples of the twin, as the paper did on its measurements,
and its in-sample errors and stiffnesses are compared with the paper's Tables 2 and 3. No other
model enters. Free are, joint by joint, what robots of this class leave open: the gear size, the
structure in series, the tilting stiffness and the lost motion, each inside its physical range.
Poses, loads, noise and the gear catalogue stay as they are.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np
from scipy.optimize import Bounds, OptimizeResult, differential_evolution

from stiff_datasets.poses import Poses, paper_poses
from stiff_datasets.twin_constants import (
    LARGEST_RATIO,
    SMALLEST_RATIO,
    JointTable,
    TwinConstants,
)
from stiff_datasets.twin_experiment import TwinExperiment
from stiff_protocols.contract import ReportsDiagnostics, StiffnessModel
from stiff_protocols.errors import ModelError
from stiff_protocols.metrics import metric
from stiff_protocols.progress import report
from stiff_protocols.types import BenchmarkData, FloatArray, Prediction

GEAR_SIZES = ((25, 32), (25, 32), (25, 32), (14, 17, 20), (14, 17, 20), (14, 17))
"""What fits the paper's identified stiffnesses and a robot of this class; A1 first."""
STRUCTURE_RANGE = ((3e4, 3e6),) * 3 + (
    (1e3, 1e6),
) * 3  # N m/rad; from softer than the gear to stiff
LOST_MOTION_RANGE = (0.5, 2.0)  # arcmin: "about 1", a factor of two either way
SEARCH_SEEDS = tuple(range(10))
FIGURE_SEEDS = tuple(range(10, 20))
"""Seeds of loads and noise: the search sees ten, the stated figures are means of ten others."""
POPULATION = 3  # candidates a free constant

WEIGHT_ME, WEIGHT_STIFFNESS = 0.05, 0.1
"""Beside 1 for MAE and STDE: a maximum is one sample; of the stiffnesses only the order counts."""
_SIGNIFICANT_DIGITS = 3


@dataclass(frozen=True, eq=False)
class VjmFigures:
    """What the linear VJM shows on all samples it was identified on.

    Attributes:
        mae, stde, me: (3,) by axis, m.
        stiffness: (n_joints,) identified, N m/rad.
    """

    mae: FloatArray
    stde: FloatArray
    me: FloatArray
    stiffness: FloatArray


MakeModel = Callable[[], StiffnessModel]


def vjm_figures(data: BenchmarkData, make_vjm: MakeModel) -> VjmFigures:
    """Identify the linear VJM on all samples of a data set and read it on the same samples.

    Args:
        data: the samples.
        make_vjm: makes an unfitted linear VJM that reports its stiffnesses.

    Raises:
        ModelError: the model reports none.
    """
    samples, model = data.samples, make_vjm()
    model.fit(samples, robot=data.robot)
    fitted = Prediction(
        np.arange(len(samples)), model.predict(samples.q, samples.wrench), samples.deflection
    )
    names = [f"stiffness {joint} [Nm/rad]" for joint in data.robot.joint_names]
    if not isinstance(model, ReportsDiagnostics) or not set(names) <= set(model.diagnostics_):
        raise ModelError(f"{type(model).__name__} reports no joint stiffnesses to calibrate by")
    errors = {
        key: np.array(list(metric(key).values(fitted).values())) for key in ("mae", "stde", "me")
    }
    return VjmFigures(**errors, stiffness=np.array([model.diagnostics_[name] for name in names]))


def mean_figures(each: Sequence[VjmFigures]) -> VjmFigures:
    """Return the means of several figures."""
    return VjmFigures(
        *(
            np.mean([getattr(one, name) for one in each], axis=0)
            for name in ("mae", "stde", "me", "stiffness")
        )
    )


def line_figures(
    constants: TwinConstants,
    make_vjm: MakeModel,
    *,
    seeds: Sequence[int] = FIGURE_SEEDS,
    specimen: int = 0,
    poses: Poses | None = None,
) -> list[VjmFigures]:
    """Return the figures of `kr10-twin` with these constants, one a seed."""
    poses, robot = poses or paper_poses(constants.chain()), constants.robot()
    experiments = [
        TwinExperiment(constants, loads="line", specimen=specimen, seed=seed) for seed in seeds
    ]
    q = experiments[0].logged_q(poses)
    wrenches = [experiment.wrenches(q) for experiment in experiments]
    # all seeds at once: the twin is fastest on many samples
    together = experiments[0].twin.readings(
        np.tile(q, (len(wrenches), 1)), np.concatenate(wrenches)
    )
    return [
        vjm_figures(BenchmarkData(experiment.recorded(poses, wrench, readings), robot), make_vjm)
        for experiment, wrench, readings in zip(
            experiments, wrenches, np.split(together, len(wrenches)), strict=True
        )
    ]


def misfit(found: VjmFigures, target: VjmFigures) -> float:
    """Return the weighted sum of squared logarithms of found over target; 0 is agreement."""
    weights = {"mae": 1.0, "stde": 1.0, "me": WEIGHT_ME, "stiffness": WEIGHT_STIFFNESS}
    return float(
        sum(
            weight * (np.log(getattr(found, name) / getattr(target, name)) ** 2).sum()
            for name, weight in weights.items()
        )
    )


@dataclass(frozen=True)
class Step:
    """The best candidate after a generation of the search."""

    generation: int
    misfit: float


@dataclass(frozen=True, eq=False)
class Calibration:
    """What a calibration found.

    Attributes:
        constants: the twin's, rounded to three digits.
        steps: how the search went.
    """

    constants: TwinConstants
    steps: tuple[Step, ...]


def calibrate(
    start: TwinConstants,
    make_vjm: MakeModel,
    target: VjmFigures,
    *,
    generations: int,
    seed: int,
) -> Calibration:
    """Search the free constants by differential evolution.

    Args:
        start: supplies all that is not free.
        make_vjm: makes an unfitted linear VJM.
        target: the paper's figures.
        generations: of the search.
        seed: of the search.
    """
    poses, steps = paper_poses(start.chain()), list[Step]()

    def objective(point: FloatArray) -> float:
        constants = _at(start, point)
        found = line_figures(constants, make_vjm, seeds=SEARCH_SEEDS, poses=poses)
        return misfit(mean_figures(found), target)

    def after_generation(intermediate_result: OptimizeResult) -> None:
        steps.append(Step(len(steps) + 1, float(intermediate_result.fun)))
        report("calibrate", len(steps), generations, steps[-1].misfit)

    space = _bounds()
    best = differential_evolution(
        objective,
        Bounds([low for low, _, _ in space], [high for _, high, _ in space]),
        integrality=np.array([integral for *_, integral in space]),
        maxiter=generations,
        popsize=POPULATION,
        mutation=(0.3, 0.9),
        recombination=0.9,
        tol=0.0,
        polish=False,
        rng=seed,
        callback=after_generation,
    )
    return Calibration(_at(start, best.x), tuple(steps))


def _bounds() -> list[tuple[float, float, bool]]:
    """Return lower and upper bound of every free constant, and whether it is a whole number.

    Joint by joint: number of the gear size, log10 of the structure, tilting ratio, lost motion.
    """
    bounds = list[tuple[float, float, bool]]()
    for sizes, structure in zip(GEAR_SIZES, STRUCTURE_RANGE, strict=True):
        low, high = np.log10(structure).tolist()
        bounds += [
            (0, len(sizes) - 1, True),
            (low, high, False),
            (SMALLEST_RATIO, LARGEST_RATIO, False),
            (*LOST_MOTION_RANGE, False),
        ]
    return bounds


def _at(start: TwinConstants, point: FloatArray) -> TwinConstants:
    """Return `start` with the free constants of a point of the search."""
    joints = tuple(
        JointTable(
            gear=sizes[round(size)],
            structure_Nm_per_rad=_rounded(10.0**structure),
            tilting_ratio=_rounded(tilting),
            lost_motion_arcmin=_rounded(lost_motion),
        )
        for sizes, (size, structure, tilting, lost_motion) in zip(
            GEAR_SIZES, point.reshape(-1, 4).tolist(), strict=True
        )
    )
    return start.model_copy(update={"joint": joints})


def _rounded(value: float) -> float:
    return float(f"{value:.{_SIGNIFICANT_DIGITS}g}")
