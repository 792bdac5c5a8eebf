"""Twin data sets of any size, written block by block: memory does not grow with their number."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from stiff_datasets.measured.sample_files import (
    ID_COLUMNS,
    PARQUET,
    SIMULATED_GROUP,
    all_columns,
    file_units,
)
from stiff_datasets.planning.loads import stream
from stiff_datasets.planning.poses import Poses
from stiff_datasets.planning.reachable import reachable_poses
from stiff_datasets.twin.twin import DECIMALS_DEG, DECIMALS_MM, TwinExperiment
from stiff_protocols.contract.errors import ConfigError
from stiff_protocols.contract.extras import require
from stiff_protocols.contract.files import check_new_file, written_whole
from stiff_protocols.contract.progress import report
from stiff_protocols.contract.types import Robot, Samples

if TYPE_CHECKING:
    import pyarrow as pa

BLOCK = 16_384
"""Samples a block at most. Part of what a seed means: another size gives other data."""

ENDINGS = (".csv", PARQUET)


def simulate(path: Path, experiment: TwinExperiment, n_samples: int) -> None:
    """Write a twin's samples at random reachable poses, in the schema of `sample_files.py`.

    Their group says that they are simulated, so that a file can never pass for a measurement.

    The same experiment gives the same file. The last pose may have fewer loads.

    Args:
        path: FILE.csv or FILE.parquet.
        experiment: its seed draws the poses, too.
        n_samples: how many.

    Raises:
        ConfigError: the file's ending is another one, or pyarrow is not installed.
        DataError: a load is beyond the twin.
        StoreError: the file exists, or cannot be written.
    """
    if path.suffix not in ENDINGS:
        raise ConfigError(f"{path}: {path.suffix!r} (valid endings: {', '.join(ENDINGS)})")
    require("a file of simulated samples", "pyarrow")
    check_new_file(path)
    constants, loads_per_pose = experiment.constants, experiment.loads_per_pose
    robot, done, poses_done = constants.robot(), 0, 0
    poses_a_block = max(1, BLOCK // loads_per_pose)
    with written_whole(path) as temporary, _writer(temporary, robot) as write:
        for block in range(-(-n_samples // (poses_a_block * loads_per_pose))):
            numbers = stream("simulated poses", constants.name, experiment.seed, block)
            poses = Poses(
                q=reachable_poses(robot, poses_a_block, numbers, constants.clearance_m),
                pose_id=np.array([f"P{poses_done + i + 1}" for i in range(poses_a_block)]),
                group=np.full(poses_a_block, SIMULATED_GROUP),
            )
            samples = experiment.samples(poses, block=block)
            samples = samples.take(np.arange(min(len(samples), n_samples - done)))
            write(_batch(samples, robot))
            done, poses_done = done + len(samples), poses_done + poses_a_block
            report("simulate", done, n_samples)


def _schema(robot: Robot) -> pa.Schema:
    import pyarrow as pa

    return pa.schema(
        [(name, pa.string() if name in ID_COLUMNS else pa.float64()) for name in all_columns(robot)]
    )


def _batch(samples: Samples, robot: Robot) -> pa.RecordBatch:
    """Return the samples in the file's units, rounded as they were recorded."""
    import pyarrow as pa

    names = [getattr(samples, name).tolist() for name in ID_COLUMNS]
    numbers = np.hstack(
        [
            (samples.q * file_units(robot)).round(DECIMALS_DEG),
            samples.wrench,
            (samples.deflection * 1000.0).round(DECIMALS_MM),
        ]
    )
    return pa.RecordBatch.from_arrays(
        [*map(pa.array, names), *map(pa.array, numbers.T.copy())], schema=_schema(robot)
    )


@contextmanager
def _writer(path: Path, robot: Robot) -> Iterator[Callable[[pa.RecordBatch], None]]:
    """Give what writes a batch at the end of the file."""
    from pyarrow import csv, parquet

    schema = _schema(robot)
    if path.suffix == PARQUET:
        with parquet.ParquetWriter(path, schema, compression="zstd") as writer:
            yield writer.write_batch
        return
    options = csv.WriteOptions(include_header=False, quoting_style="none")
    with path.open("wb") as file:
        file.write((",".join(all_columns(robot)) + "\n").encode())
        with csv.CSVWriter(file, schema, write_options=options) as lines:
            yield lines.write_batch
