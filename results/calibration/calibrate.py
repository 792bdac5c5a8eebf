"""Calibration of the KR10 twin's free constants against the source paper's VJM figures.

The linear VJM is identified on all 151 samples of the twin, as the paper did on its measurements,
and its in-sample errors and stiffnesses are compared with the paper's Tables 2 and 3. No other
model enters. Free are, joint by joint, what robots of this class leave open: the gear size, the
structure in series and the tilting stiffness, each inside its physical range.
Loads and the gear catalogue stay as they are. Calibration 1 has normal noise and a level wrist;
calibration 2 has a tracker of heavy tails, a bent wrist and wider ranges. Both searches start from
the constants of version 0.2 and end with least squares.

``python results/calibration/calibrate.py`` searches, writes constants and record, and prints
the figures beside the paper's; with ``--figures`` it prints those of the shipped calibrations.
"""

from __future__ import annotations

import json
import platform
import sys
import time
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from datetime import UTC, datetime
from importlib.metadata import version
from importlib.resources import files
from pathlib import Path
from typing import Literal, NamedTuple, Self

import cyclopts
import numpy as np
import pandas as pd
from scipy.optimize import Bounds, OptimizeResult, differential_evolution, least_squares
from tabulate import tabulate

from stiff_datasets.measured.identifiability import regressor
from stiff_datasets.planning.poses import Poses
from stiff_datasets.twin.experiment import TwinExperiment, recorded_deflection, recorded_wrench
from stiff_datasets.twin.kr10_twin import CALIBRATIONS
from stiff_datasets.twin.twin_file import (
    LAST_SPECIMEN,
    MAX_RATIO,
    MIN_RATIO,
    JointTable,
    Noise,
    TwinConstants,
)
from stiff_protocols.contract.errors import StiffBenchError
from stiff_protocols.contract.extras import require
from stiff_protocols.contract.files import make_folder, written_whole
from stiff_protocols.contract.progress import Progress, listening, report
from stiff_protocols.contract.types import AXES, FloatArray, Robot, Samples
from stiff_protocols.springs.identification import least_compliance

SIZES = ((25, 32), (25, 32), (25, 32), (14, 17, 20), (14, 17, 20), (14, 17))
GEARS = tuple(tuple(f"SHG-{size}" for size in sizes) for sizes in SIZES)
"""What fits the paper's identified stiffnesses and a robot of this class; A1 first."""
SOFTEST_STRUCTURE = (*(3e4,) * 3, *(1e3,) * 3)  # N m/rad; softer than the gears
POPULATION = 3  # candidates a free constant
POLISH_STEPS = 20
POLISH_DIFFERENCE = 0.01  # relative, for the slopes of the least squares

WEIGHTS = (1.0, 1.0, 0.05, 1.0)
"""Of MAE, STDE, ME (one sample) and the stiffnesses. With 0.1 for the stiffnesses A2 became a
quarter of the paper's, with a gear too small for the arm's weight."""
START = (
    *(("SHG-32", 2.92e6, 1.33), ("SHG-32", 3e6, 7.99), ("SHG-32", 6.92e5, 5.99)),
    *(("SHG-20", 4.37e3, 8.0), ("SHG-20", 3.82e4, 1.0), ("SHG-14", 2.35e3, 1.0)),
)
"""Gear, structure and tilting ratio of A1 to A6, found in 150 generations for gears with lost
motion (stiffbench 0.2); the first candidate."""
_SIGNIFICANT_DIGITS, _ALL_DIGITS = 3, 15

COMMAND = "python results/calibration/calibrate.py"
MM = 1000.0
"""Millimetres a metre."""
ERRORS = ("mae", "stde", "me")


@dataclass(frozen=True)
class CalibrationSearch:
    """How a calibration is searched, and in which ranges.

    Attributes:
        stiffest_structure: upper bound by joint, N m/rad.
        noise: of the instruments; not free.
        seeds: of loads and noise that the search sees, and that the stated figures are means of.
    """

    stiffest_structure: tuple[float, ...]
    noise: Noise
    seeds: tuple[range, range]


SEARCHES = {
    1: CalibrationSearch(
        stiffest_structure=(*(3e6,) * 3, *(1e6,) * 3),
        noise=Noise(),
        seeds=(range(10), range(10, 20)),
    ),
    2: CalibrationSearch(
        stiffest_structure=(1e7,) * 6,
        noise=Noise(tracker_m=1.5e-5, tail=2.0),
        seeds=(range(20), range(20, 60)),  # outliers make the figures of a few seeds accidental
    ),
}


class VjmFigures(NamedTuple):
    """What the linear VJM shows on all samples it was identified on.

    Attributes:
        mae, stde, me: (3,) by axis, m.
        stiffness: (n_joints,) identified, N m/rad.
    """

    mae: FloatArray
    stde: FloatArray
    me: FloatArray
    stiffness: FloatArray

    @classmethod
    def of(cls, error: FloatArray, stiffness: FloatArray) -> Self:
        """Return the figures of (n, 3) errors, m, and (n_joints,) stiffnesses, N m/rad."""
        size = np.abs(error)
        return cls(size.mean(axis=0), size.std(axis=0), size.max(axis=0), stiffness)


def vjm_figures(robot: Robot, samples: Samples) -> VjmFigures:
    """Identify the linear VJM by least squares on samples and read it on the same samples."""
    rows = regressor(robot, samples.q, samples.wrench)  # (n, 3, n_joints)
    compliance = least_compliance(rows.reshape(-1, rows.shape[2]), samples.deflection.reshape(-1))
    with np.errstate(divide="ignore"):  # a joint found rigid
        return VjmFigures.of(rows @ compliance - samples.deflection, 1.0 / compliance)


def line_figures(
    constants: TwinConstants,
    *,
    seeds: Sequence[int],
    poses: Poses,
    specimen: int = 0,
) -> VjmFigures:
    """Return the mean over seeds of the figures of `kr10-twin` with these constants and poses."""
    robot = constants.robot()
    experiments = [
        TwinExperiment(constants, loads="line", specimen=specimen, seed=seed) for seed in seeds
    ]
    q = experiments[0].logged_q(poses)
    wrenches = [experiment.wrenches(q) for experiment in experiments]
    # all seeds at once: the twin is fastest on many samples
    together = experiments[0].twin.truth(np.tile(q, (len(wrenches), 1)), np.concatenate(wrenches))
    seed_figures = []
    for experiment, wrench, moved in zip(
        experiments, wrenches, np.split(together, len(wrenches)), strict=True
    ):
        rng = experiment.stream("noise")
        recorded = recorded_wrench(wrench, constants.noise, rng)
        deflection = recorded_deflection(moved, constants.noise, rng)
        seed_figures.append(vjm_figures(robot, experiment.rows(poses, recorded, deflection)))
    return VjmFigures(*(np.mean(kind, axis=0) for kind in zip(*seed_figures, strict=True)))


def specimen_figures(number: int, constants: TwinConstants | None = None) -> list[VjmFigures]:
    """Return the figures of every specimen of a calibration, with its constants or with others."""
    constants, poses = constants or CALIBRATIONS[number].constants(), CALIBRATIONS[number].poses()
    return [
        line_figures(constants, seeds=SEARCHES[number].seeds[1], poses=poses, specimen=specimen)
        for specimen in range(LAST_SPECIMEN + 1)
    ]


def misfit(twin_figures: VjmFigures, target: VjmFigures) -> float:
    """Return the weighted sum of squared logarithms of figures over target; 0 is agreement."""
    squares = [(logarithm**2).sum() for logarithm in _logarithms(twin_figures, target)]
    return float(np.dot(WEIGHTS, squares))


def _logarithms(twin_figures: VjmFigures, target: VjmFigures) -> list[FloatArray]:
    return [np.log(a / b) for a, b in zip(twin_figures, target, strict=True)]


def calibrate(
    number: int, target: VjmFigures, *, generations: int, seed: int
) -> tuple[TwinConstants, list[float]]:
    """Search the free constants by differential evolution.

    Args:
        number: of the calibration.
        target: the paper's figures.
        generations: of the search.
        seed: of the search.

    Returns:
        The constants, rounded to three digits, and the best misfit after each generation and after
        the least squares.
    """
    search, start = SEARCHES[number], _start(number)
    poses, misfits = CALIBRATIONS[number].poses(), list[float]()
    (lower, upper), is_gear_size = _bounds(search), np.tile([True, False, False], 6)

    def figures(point: FloatArray, digits: int = _SIGNIFICANT_DIGITS) -> VjmFigures:
        return line_figures(_at(start, point, digits), seeds=search.seeds[0], poses=poses)

    def objective(point: FloatArray) -> float:
        return misfit(figures(point), target)

    def after_generation(intermediate_result: OptimizeResult) -> None:
        misfits.append(float(intermediate_result.fun))
        report("calibrate", len(misfits), generations, misfits[-1])

    point = differential_evolution(
        objective,
        Bounds(lower, upper),
        x0=_point(lower, upper),
        integrality=is_gear_size,
        maxiter=generations,
        popsize=POPULATION,
        mutation=(0.3, 0.9),
        recombination=0.9,
        tol=0.0,
        polish=False,
        rng=seed,
        callback=after_generation,
    ).x

    def weighted(free: FloatArray) -> FloatArray:
        point[~is_gear_size] = free
        # rounded constants have no slope
        logarithms = _logarithms(figures(point, digits=_ALL_DIGITS), target)
        pairs = zip(WEIGHTS, logarithms, strict=True)
        return np.concatenate([np.sqrt(weight) * logarithm for weight, logarithm in pairs])

    point[~is_gear_size] = least_squares(
        weighted,
        point[~is_gear_size],
        bounds=(lower[~is_gear_size], upper[~is_gear_size]),
        x_scale=(upper - lower)[~is_gear_size],
        diff_step=np.full((~is_gear_size).sum(), POLISH_DIFFERENCE),
        max_nfev=POLISH_STEPS,
    ).x
    misfits.append(objective(point))
    return _at(start, point), misfits


def _start(number: int) -> TwinConstants:
    """Return the constants that supply what is not free."""
    name = CALIBRATIONS[number].name
    changed = {"name": name, "noise": SEARCHES[number].noise}
    return CALIBRATIONS[1].constants().model_copy(update=changed)


def _bounds(search: CalibrationSearch) -> tuple[FloatArray, FloatArray]:
    """Return the lower and upper bounds of the free constants.

    Joint by joint: number of the gear size, log10 of the structure, tilting ratio.
    """
    sizes = [len(gear_sizes) - 1 for gear_sizes in GEARS]
    softest, stiffest = np.log10(SOFTEST_STRUCTURE), np.log10(search.stiffest_structure)
    lower = np.broadcast_arrays(0.0, softest, MIN_RATIO)
    upper = np.broadcast_arrays(sizes, stiffest, MAX_RATIO)
    return np.stack(lower, axis=1).reshape(-1), np.stack(upper, axis=1).reshape(-1)


def _point(lower: FloatArray, upper: FloatArray) -> FloatArray:
    """Return the point of the search at which `START` stands."""
    rows = [
        (gears.index(gear), np.log10(structure), tilting)
        for gears, (gear, structure, tilting) in zip(GEARS, START, strict=True)
    ]
    return np.clip(np.array(rows, dtype=np.float64).reshape(-1), lower, upper)


def _at(
    start: TwinConstants, point: FloatArray, digits: int = _SIGNIFICANT_DIGITS
) -> TwinConstants:
    """Return `start` with the free constants of a point of the search."""
    joints = tuple(
        JointTable(
            gear=gears[round(size)],
            structure_Nm_per_rad=_rounded(10.0**structure, digits),
            tilting_ratio=_rounded(tilting, digits),
        )
        for gears, (size, structure, tilting) in zip(
            GEARS, point.reshape(-1, 3).tolist(), strict=True
        )
    )
    return start.model_copy(update={"joint": joints})


def _rounded(value: float, digits: int) -> float:
    return float(f"{value:.{digits}g}")


def paper_figures() -> VjmFigures:
    """Return the source paper's Tables 2 and 3, SI units."""
    errors = _published("table_2").pivot(index="error", columns="axis", values="VJM")[list(AXES)]
    mae, stde, me = (errors.loc[name].to_numpy() / MM for name in ERRORS)
    return VjmFigures(mae, stde, me, _published("table_3")["stiffness_Nm_per_rad"].to_numpy())


def _published(table: str) -> pd.DataFrame:
    with (files("stiff_published") / f"{table}.csv").open(encoding="utf-8") as file:
        return pd.read_csv(file)


def figures_text(figures_by_number: Mapping[int, Sequence[VjmFigures]], target: VjmFigures) -> str:
    """Return the paper's Tables 2 and 3 beside those of calibrations, in Markdown.

    Args:
        figures_by_number: number of a calibration -> figures of each specimen; the first has the
            constants as they stand.
        target: the paper's.
    """
    names = [f"{axis.upper()} {error.upper()} [mm]" for error in ERRORS for axis in AXES]
    names += [f"{joint} [Nm/rad]" for joint in _published("table_3")["joint"]]
    paper = _numbers(target)
    value_tables = [
        np.array([_numbers(figures) for figures in specimens])
        for specimens in figures_by_number.values()
    ]
    rows = []
    for i, name in enumerate(names):
        decimals = 3 if name.endswith("[mm]") else 0
        rows.append([name, f"{paper[i]:.{decimals}f}"])
        for values in (numbers[:, i] for numbers in value_tables):
            spread = f"{values.mean():.{decimals}f} ± {values.std(ddof=1):.{decimals}f}"
            off = f"{values[0] / paper[i] - 1.0:+.0%}"
            rows[-1] += [f"{values[0]:.{decimals}f}", off, spread]
    headers = ["VJM on all samples", "paper"]
    for number, specimens in figures_by_number.items():
        headers += [f"calibration {number}", "off", f"{len(specimens)} specimens"]
    align = ["left", *["right"] * (len(headers) - 1)]
    return tabulate(rows, headers=headers, tablefmt="github", colalign=align, disable_numparse=True)


def _numbers(figures: VjmFigures) -> FloatArray:
    """Return the errors, mm, and after them the stiffnesses, N m/rad."""
    errors = [getattr(figures, name) * MM for name in ERRORS]
    return np.concatenate([*errors, figures.stiffness])


def _plain(figures: VjmFigures) -> dict[str, list[float]]:
    """Return the figures for the record: mm and N m/rad, rounded to what is repeatable."""
    errors = {f"{name}_mm": (getattr(figures, name) * MM).round(4).tolist() for name in ERRORS}
    return errors | {"stiffness_Nm_per_rad": figures.stiffness.round(1).tolist()}


def write_calibration(number: int, *, generations: int, seed: int, output: Path) -> str:
    """Search the constants, write them and the record, and return the figures as text.

    Raises:
        ConfigError: tomli-w is not installed.
        StoreError: a file cannot be written.
    """
    require("the calibration", "tomli_w")
    import tomli_w

    make_folder(output)  # before the work, not after it
    start, target = time.perf_counter(), paper_figures()
    found_constants, misfits = calibrate(number, target, generations=generations, seed=seed)
    specimens = specimen_figures(number, found_constants)
    constants = found_constants.model_dump(mode="json", exclude_none=True)
    chosen = "" if number == 1 else f" --calibration {number}"
    record = {
        "command": f"{COMMAND}{chosen} --generations {generations} --seed {seed}",
        "made": datetime.now(UTC).isoformat(timespec="seconds"),
        "seconds": round(time.perf_counter() - start),
        "environment": {
            "python": platform.python_version(),
            "platform": platform.platform(),
            **{name: version(name) for name in ("stiffbench", "numpy", "scipy", "pin")},
        },
        "search_seeds": [*SEARCHES[number].seeds[0]],
        "figure_seeds": [*SEARCHES[number].seeds[1]],
        "misfit": misfit(specimens[0], target),
        "steps": [
            {"generation": i + 1, "misfit": step_misfit} for i, step_misfit in enumerate(misfits)
        ],
        "paper": _plain(target),
        "specimens": [_plain(figures) for figures in specimens],
        "constants": constants,
    }
    toml, text = output / f"{found_constants.name}.toml", output / f"{found_constants.name}.json"
    with written_whole(toml) as temporary:
        temporary.write_text(tomli_w.dumps(constants), encoding="utf-8")
    with written_whole(text) as temporary:
        temporary.write_text(json.dumps(record, indent=1) + "\n", encoding="utf-8")
    return f"{figures_text({number: specimens}, target)}\n\nconstants: {toml}\nrecord: {text}"


def main(
    *,
    calibration: Literal["1", "2"] = "1",
    figures: bool = False,
    generations: int = 12,
    seed: int = 0,
    output: Path = Path(__file__).parent,
) -> None:
    """Fit the KR10 twin to the source paper's VJM figures.

    Args:
        calibration: which one to search.
        figures: search nothing; print the figures of the shipped calibrations.
        generations: of the search; the default takes some minutes.
        seed: of the search.
        output: folder where constants and record go.
    """

    def tell(now: Progress) -> None:
        print(f"{now.phase} {now.step}/{now.total}: misfit {now.loss:.4g}", file=sys.stderr)

    try:
        if figures:
            figures_by_number = {number: specimen_figures(number) for number in CALIBRATIONS}
            print(figures_text(figures_by_number, paper_figures()))
            return
        with listening(tell):
            print(
                write_calibration(
                    int(calibration), generations=generations, seed=seed, output=output
                )
            )
    except StiffBenchError as error:
        sys.exit(f"Error: {error}")


if __name__ == "__main__":
    cyclopts.run(main)
