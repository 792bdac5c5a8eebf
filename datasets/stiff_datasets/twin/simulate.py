"""Write twin data sets of any size block by block, with constant memory."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path

import numpy as np

from stiff_datasets.measured.sample_columns import SIMULATED_GROUP
from stiff_datasets.measured.sheet_files import PARQUET, sample_table, write_table
from stiff_datasets.planning.loads import stream
from stiff_datasets.planning.poses import Poses
from stiff_datasets.planning.reachable import reachable_poses
from stiff_datasets.twin.twin import TwinExperiment
from stiff_protocols.contract.errors import unsupported_extension
from stiff_protocols.contract.files import check_new_file
from stiff_protocols.contract.progress import report
from stiff_protocols.contract.types import Samples

BLOCK = 16_384
"""Largest number of samples per block; another size gives other data for a seed."""

ENDINGS = (".csv", PARQUET)
RECORDED_DECIMALS = 6
"""Decimals of deg, N, N m and mm; records have fewer."""


def simulate(path: Path, experiment: TwinExperiment, n_samples: int) -> None:
    """Write a twin's samples at random reachable poses, with the columns of `sample_columns.py`.

    Their group marks them as simulated, so that the file cannot be mistaken for a measurement.

    The same experiment gives the same file. The last pose may have fewer loads.

    Args:
        path: FILE.csv or FILE.parquet.
        experiment: its seed draws the poses, too.
        n_samples: number of samples.

    Raises:
        ConfigError: the file has another extension, or it is Parquet and pyarrow is not installed.
        DataError: a load is too large for the twin.
        StoreError: the file exists, or cannot be written.
    """
    if path.suffix not in ENDINGS:
        raise unsupported_extension(path, ENDINGS)
    check_new_file(path)
    robot = experiment.constants.robot()
    parts = _blocks(experiment, n_samples)
    write_table(path, (sample_table(part, robot).round(RECORDED_DECIMALS) for part in parts))


def _blocks(experiment: TwinExperiment, n_samples: int) -> Iterator[Samples]:
    """Yield blocks of samples, each with other poses, loads and noise."""
    constants, robot, n_done = experiment.constants, experiment.constants.robot(), 0
    n_poses = max(1, BLOCK // experiment.loads_per_pose)
    for block in range(-(-n_samples // (n_poses * experiment.loads_per_pose))):
        rng = stream("simulated poses", constants.name, experiment.seed, block)
        poses = Poses(
            q=reachable_poses(robot, n_poses, rng, constants.clearance_m),
            pose_id=np.array([f"P{block * n_poses + i + 1}" for i in range(n_poses)]),
            group=np.full(n_poses, SIMULATED_GROUP),
        )
        samples = experiment.samples(poses, block=block)
        samples = samples.take(np.arange(min(len(samples), n_samples - n_done)))
        yield samples
        n_done += len(samples)
        report("simulate", n_done, n_samples)
