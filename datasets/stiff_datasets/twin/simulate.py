"""Write twin data sets of any size block by block, with constant memory."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path

import numpy as np
from pandas import DataFrame

from stiff_datasets.measured.sample_columns import SIMULATED_GROUP
from stiff_datasets.measured.table_reader import PARQUET, sample_table, write_table
from stiff_datasets.planning.loads import stream
from stiff_datasets.planning.poses import Poses
from stiff_datasets.planning.reachable import reachable_poses
from stiff_datasets.twin.experiment import TwinExperiment
from stiff_protocols.contract.errors import unsupported_extension
from stiff_protocols.contract.files import check_new_file
from stiff_protocols.contract.progress import report

BLOCK = 16_384
"""Largest number of samples per block; another size gives other data for a seed."""

ENDINGS = (".csv", PARQUET)
RECORDED_DECIMALS = 6
"""Decimals of deg, N, N m and mm; records have fewer."""


def simulate(
    path: Path, experiment: TwinExperiment, n_samples: int, *, all_columns: bool = False
) -> None:
    """Write a twin's samples at random reachable poses, with the columns of `sample_columns.py`.

    Their group marks them as simulated, so that the file cannot be mistaken for a measurement.

    The same experiment gives the same file. The last pose may have fewer loads.

    Args:
        path: FILE.csv or FILE.parquet.
        experiment: its seed draws the poses, too.
        n_samples: number of samples.
        all_columns: also write the order of the rows, the direction from which each joint reached
            the pose, and the reading of the unloaded robot after the load.

    Raises:
        ConfigError: the file has another extension, or it is Parquet and pyarrow is not installed.
        DataError: a load is too large for the twin.
        StoreError: the file exists, or cannot be written.
    """
    if path.suffix not in ENDINGS:
        raise unsupported_extension(path, ENDINGS)
    check_new_file(path)
    parts = _blocks(experiment, n_samples, all_columns=all_columns)
    write_table(path, (part.round(RECORDED_DECIMALS) for part in parts))


def _blocks(
    experiment: TwinExperiment, n_samples: int, *, all_columns: bool
) -> Iterator[DataFrame]:
    """Yield tables of blocks of samples, each with other poses, loads and noise."""
    constants, robot, n_done = experiment.constants, experiment.constants.robot(), 0
    n_poses = max(1, BLOCK // experiment.loads_per_pose)
    for block in range(-(-n_samples // (n_poses * experiment.loads_per_pose))):
        rng = stream("simulated poses", constants.name, experiment.seed, block)
        poses = Poses(
            q=reachable_poses(robot, n_poses, rng, constants.clearance_m),
            pose_id=np.array([f"P{block * n_poses + i + 1}" for i in range(n_poses)]),
            group=np.full(n_poses, SIMULATED_GROUP),
        )
        samples, _, after, direction = experiment.measurement(poses, block)
        if all_columns:
            order = n_done + np.arange(1.0, len(samples) + 1.0)
            samples = replace(samples, order=order, approach=direction, after=after)
        n_rows = min(len(samples), n_samples - n_done)
        yield sample_table(samples, robot).iloc[:n_rows]
        n_done += n_rows
        report("simulate", n_done, n_samples)
