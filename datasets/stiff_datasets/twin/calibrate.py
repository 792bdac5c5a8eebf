"""Calibration of the KR10 twin's free constants against the source paper's VJM figures.

The linear VJM is identified on all 151 samples of the twin, as the paper did on its measurements,
and its in-sample errors and stiffnesses are compared with the paper's Tables 2 and 3. No other
model enters. Free are, joint by joint, what robots of this class leave open: the gear size, the
structure in series, the tilting stiffness and the lost motion, each inside its physical range.
Poses, loads, noise and the gear catalogue stay as they are.

``python -m stiff_datasets.twin.calibrate`` searches, writes constants and record, and prints
the figures beside the paper's.
"""

from __future__ import annotations

import json
import platform
import time
from collections.abc import Sequence
from datetime import UTC, datetime
from importlib.metadata import version
from importlib.resources import files
from pathlib import Path
from typing import NamedTuple, Self

import click
import numpy as np
import pandas as pd
from scipy.optimize import Bounds, OptimizeResult, differential_evolution, nnls
from tabulate import tabulate

from stiff_datasets.measured.identifiability import regressor
from stiff_datasets.planning.poses import Poses, paper_poses
from stiff_datasets.robots.robot import ChainModel
from stiff_datasets.twin.constants import (
    LARGEST_RATIO,
    LAST_SPECIMEN,
    SMALLEST_RATIO,
    JointTable,
    TwinConstants,
    shipped_constants,
)
from stiff_datasets.twin.kr10_twin import CONSTANTS
from stiff_datasets.twin.twin import TwinExperiment
from stiff_protocols.contract.errors import StiffBenchError
from stiff_protocols.contract.extras import require
from stiff_protocols.contract.files import make_folder, written_whole
from stiff_protocols.contract.progress import Progress, listening, report
from stiff_protocols.contract.types import AXES, FloatArray, Samples

GEAR_SIZES = ((25, 32), (25, 32), (25, 32), (14, 17, 20), (14, 17, 20), (14, 17))
"""What fits the paper's identified stiffnesses and a robot of this class; A1 first."""
STRUCTURE_RANGE = (*((3e4, 3e6),) * 3, *((1e3, 1e6),) * 3)  # N m/rad; softer than the gear to stiff
LOST_MOTION_RANGE = (0.5, 2.0)  # arcmin: "about 1", a factor of two either way
SEARCH_SEEDS = tuple(range(10))
FIGURE_SEEDS = tuple(range(10, 20))
"""Seeds of loads and noise: the search sees ten, the stated figures are means of ten others."""
POPULATION = 3  # candidates a free constant

WEIGHTS = (1.0, 1.0, 0.05, 0.1)
"""Of MAE, STDE, ME (one sample) and the stiffnesses, of which only the order counts."""
_SIGNIFICANT_DIGITS = 3

COMMAND = "python -m stiff_datasets.twin.calibrate"
MM = 1000.0
"""Millimetres a metre."""
ERRORS = ("mae", "stde", "me")


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


def vjm_figures(chain: ChainModel, samples: Samples) -> VjmFigures:
    """Identify the linear VJM by least squares on samples and read it on the same samples."""
    rows = regressor(chain, samples.q, samples.wrench)  # (n, 3, n_joints)
    matrix, target = rows.reshape(-1, rows.shape[2]), samples.deflection.reshape(-1)
    size = np.linalg.norm(matrix, axis=0)  # differs by orders of magnitude from base to tip
    compliance = nnls(matrix / size, target)[0] / size
    with np.errstate(divide="ignore"):  # a joint found rigid
        return VjmFigures.of(rows @ compliance - samples.deflection, 1.0 / compliance)


def line_figures(
    constants: TwinConstants,
    *,
    seeds: Sequence[int] = FIGURE_SEEDS,
    specimen: int = 0,
    poses: Poses | None = None,
) -> VjmFigures:
    """Return the mean over seeds of the figures of `kr10-twin` with these constants."""
    chain = constants.chain()
    poses = poses or paper_poses(chain)
    experiments = [
        TwinExperiment(constants, loads="line", specimen=specimen, seed=seed) for seed in seeds
    ]
    q = experiments[0].logged_q(poses)
    wrenches = [experiment.wrenches(q) for experiment in experiments]
    # all seeds at once: the twin is fastest on many samples
    together = experiments[0].twin.readings(
        np.tile(q, (len(wrenches), 1)), np.concatenate(wrenches)
    )
    each = [
        vjm_figures(chain, experiment.recorded(poses, wrench, readings))
        for experiment, wrench, readings in zip(
            experiments, wrenches, np.split(together, len(wrenches)), strict=True
        )
    ]
    return VjmFigures(*(np.mean(kind, axis=0) for kind in zip(*each, strict=True)))


def misfit(found: VjmFigures, target: VjmFigures) -> float:
    """Return the weighted sum of squared logarithms of found over target; 0 is agreement."""
    squares = [(np.log(a / b) ** 2).sum() for a, b in zip(found, target, strict=True)]
    return float(np.dot(WEIGHTS, squares))


def calibrate(
    start: TwinConstants, target: VjmFigures, *, generations: int, seed: int
) -> tuple[TwinConstants, list[float]]:
    """Search the free constants by differential evolution.

    Args:
        start: supplies all that is not free.
        target: the paper's figures.
        generations: of the search.
        seed: of the search.

    Returns:
        The constants, rounded to three digits, and the best misfit after each generation.
    """
    poses, misfits = paper_poses(start.chain()), list[float]()

    def objective(point: FloatArray) -> float:
        constants = _at(start, point)
        return misfit(line_figures(constants, seeds=SEARCH_SEEDS, poses=poses), target)

    def after_generation(intermediate_result: OptimizeResult) -> None:
        misfits.append(float(intermediate_result.fun))
        report("calibrate", len(misfits), generations, misfits[-1])

    lower, upper, whole = zip(*_bounds(), strict=True)
    best = differential_evolution(
        objective,
        Bounds(lower, upper),
        integrality=np.array(whole),
        maxiter=generations,
        popsize=POPULATION,
        mutation=(0.3, 0.9),
        recombination=0.9,
        tol=0.0,
        polish=False,
        rng=seed,
        callback=after_generation,
    )
    return _at(start, best.x), misfits


def _bounds() -> list[tuple[float, float, bool]]:
    """Return lower and upper bound of every free constant, and whether it is a whole number.

    Joint by joint: number of the gear size, log10 of the structure, tilting ratio, lost motion.
    """
    return [
        bound
        for sizes, structure in zip(GEAR_SIZES, STRUCTURE_RANGE, strict=True)
        for bound in (
            (0, len(sizes) - 1, True),
            (np.log10(structure[0]), np.log10(structure[1]), False),
            (SMALLEST_RATIO, LARGEST_RATIO, False),
            (*LOST_MOTION_RANGE, False),
        )
    ]


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


def paper_figures() -> VjmFigures:
    """Return the source paper's Tables 2 and 3, SI units."""
    errors = _published("table_2").pivot(index="error", columns="axis", values="VJM")[list(AXES)]
    mae, stde, me = (errors.loc[name].to_numpy() / MM for name in ERRORS)
    return VjmFigures(mae, stde, me, _published("table_3")["stiffness_Nm_per_rad"].to_numpy())


def _published(table: str) -> pd.DataFrame:
    with (files("stiff_published") / f"{table}.csv").open(encoding="utf-8") as file:
        return pd.read_csv(file)


def figures_text(specimens: Sequence[VjmFigures], target: VjmFigures) -> str:
    """Return the paper's Tables 2 and 3 beside the twin's, in Markdown.

    Args:
        specimens: figures of each specimen; the first has the constants as they stand.
        target: the paper's.
    """
    rows = []
    for error in ERRORS:
        for i, axis in enumerate(AXES):
            values = np.array([getattr(figures, error)[i] for figures in specimens]) * MM
            paper = getattr(target, error)[i] * MM
            rows.append(_row(f"{axis.upper()} {error.upper()} [mm]", values, paper, 3))
    for i, joint in enumerate(_published("table_3")["joint"]):
        values = np.array([figures.stiffness[i] for figures in specimens])
        rows.append(_row(f"{joint} [Nm/rad]", values, target.stiffness[i], 0))
    headers = ["VJM on all samples", "paper", "twin", "off", f"{len(specimens)} specimens"]
    align = ["left", *["right"] * 4]
    return tabulate(rows, headers=headers, tablefmt="github", colalign=align, disable_numparse=True)


def _row(name: str, values: FloatArray, paper: float, decimals: int) -> list[str]:
    spread = f"{values.mean():.{decimals}f} ± {values.std(ddof=1):.{decimals}f}"
    off = f"{values[0] / paper - 1.0:+.0%}"
    return [name, f"{paper:.{decimals}f}", f"{values[0]:.{decimals}f}", off, spread]


def _plain(figures: VjmFigures) -> dict[str, list[float]]:
    """Return the figures for the record: mm and N m/rad, rounded to what is repeatable."""
    errors = {f"{name}_mm": (getattr(figures, name) * MM).round(4).tolist() for name in ERRORS}
    return errors | {"stiffness_Nm_per_rad": figures.stiffness.round(1).tolist()}


def write_calibration(*, generations: int, seed: int, output: Path) -> str:
    """Search the constants, write them and the record, and return the figures as text.

    Raises:
        ConfigError: tomli-w is not installed.
        StoreError: a file cannot be written.
    """
    require("the calibration", "tomli_w")
    import tomli_w

    make_folder(output)  # before the work, not after it
    start, target = time.perf_counter(), paper_figures()
    found, misfits = calibrate(
        shipped_constants(CONSTANTS), target, generations=generations, seed=seed
    )
    specimens = [line_figures(found, specimen=number) for number in range(LAST_SPECIMEN + 1)]
    constants = found.model_dump(mode="json", exclude_none=True)
    record = {
        "command": f"{COMMAND} --generations {generations} --seed {seed}",
        "made": datetime.now(UTC).isoformat(timespec="seconds"),
        "seconds": round(time.perf_counter() - start),
        "environment": {
            "python": platform.python_version(),
            "platform": platform.platform(),
            **{name: version(name) for name in ("stiffbench", "numpy", "scipy", "pin")},
        },
        "search_seeds": SEARCH_SEEDS,
        "figure_seeds": FIGURE_SEEDS,
        "misfit": misfit(specimens[0], target),
        "steps": [{"generation": i + 1, "misfit": one} for i, one in enumerate(misfits)],
        "paper": _plain(target),
        "specimens": [_plain(figures) for figures in specimens],
        "constants": constants,
    }
    toml, text = output / f"{CONSTANTS}.toml", output / f"{CONSTANTS}.json"
    with written_whole(toml) as temporary:
        temporary.write_text(tomli_w.dumps(constants), encoding="utf-8")
    with written_whole(text) as temporary:
        temporary.write_text(json.dumps(record, indent=1) + "\n", encoding="utf-8")
    return f"{figures_text(specimens, target)}\n\nconstants: {toml}\nrecord: {text}"


@click.command()
@click.option(
    "--generations",
    type=click.IntRange(1, 10_000),
    default=150,
    show_default=True,
    help="Of the search; the default takes about ten minutes.",
)
@click.option(
    "--seed", type=click.IntRange(0, 2**32), default=0, show_default=True, help="Of the search."
)
@click.option(
    "--output",
    type=click.Path(path_type=Path),
    default=Path("results/calibration"),
    show_default=True,
    metavar="DIR",
    help="Where constants and record go.",
)
def main(generations: int, seed: int, output: Path) -> None:
    """Fit the KR10 twin to the source paper's VJM figures."""

    def tell(now: Progress) -> None:
        click.echo(f"{now.phase} {now.step}/{now.total}: misfit {now.loss:.4g}", err=True)

    try:
        with listening(tell):
            click.echo(write_calibration(generations=generations, seed=seed, output=output))
    except StiffBenchError as error:
        raise click.ClickException(str(error)) from error


if __name__ == "__main__":
    main(prog_name=COMMAND)
