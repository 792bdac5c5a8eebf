"""One's own measured data: the samples of a CSV or Parquet file and their robot.

The columns are those of `stiff_datasets.measured.sample_files`.
"""

from __future__ import annotations

import warnings
from pathlib import Path

import pandas as pd

from stiff_datasets.measured.sample_checks import CheckedSamples, check_sheet, problems_error
from stiff_datasets.measured.sample_files import read_sheet, sample_table, sheet_of, write_table
from stiff_protocols.contract.errors import StiffBenchWarning
from stiff_protocols.contract.types import BenchmarkData, Robot, Samples


def check_file(path: Path, robot: Robot, *, no_torque: bool = False) -> CheckedSamples:
    """Read a file of measured samples and collect everything that is wrong with it.

    Args:
        path: the file; Parquet or Excel if it ends in .parquet or .xlsx, else CSV.
        robot: the robot that was measured; gives the number of joints and their limits.
        no_torque: torques were not measured; their columns may be missing.

    Raises:
        DataError: the file cannot be read, is empty, or is no table.
    """
    return check_sheet(read_sheet(path), robot, no_torque=no_torque)


def read_samples(path: Path, robot: Robot, *, no_torque: bool = False) -> Samples:
    """Read and check a file of measured samples; arguments as `check_file`.

    Columns that are not ours are kept aside; a `StiffBenchWarning` names them.

    Raises:
        DataError: the file is unreadable, empty or wrongly headed, or a value cannot be; the
            message names file, row (1 is the header of a CSV file), column, value and what is
            valid, and how many problems there are beside the first.
    """
    checked = check_file(path, robot, no_torque=no_torque)
    samples = _samples(checked, "bench data validate lists them")
    if checked.unused:
        message = f"{path}: columns not used: {', '.join(checked.unused)}"
        warnings.warn(message, StiffBenchWarning, stacklevel=2)
    return samples


def write_samples(path: Path, samples: Samples, robot: Robot) -> None:
    """Write samples in the units of files; `read_samples` gives the same numbers and names again.

    The same to the last bit, if every number is that of some number in deg or mm, as all numbers
    are that were read from a file; see `stiff_datasets.measured.sample_files.sample_table`.

    Args:
        path: the file; Parquet if it ends in .parquet, else CSV. Written whole or not at all.
        samples: what to write.
        robot: the robot they belong to.

    Raises:
        DataError: `read_samples` would refuse the file, or Parquet is not installed.
        StoreError: the file cannot be written.
    """
    table = sample_table(samples, robot)
    samples_of(path, table, robot, "nothing was written")
    write_table(path, table)


class MeasuredData:
    """A user's own measurement: a file of samples and the robot they were measured on.

    Attributes:
        csv: the samples; Parquet or Excel if the name ends in .parquet or .xlsx.
        robot: the robot.
        no_torque: torques were not measured; their columns may be missing.
    """

    def __init__(self, *, csv: Path, robot: Robot, no_torque: bool = False) -> None:
        """Store the arguments."""
        self.csv = csv
        self.robot = robot
        self.no_torque = no_torque

    def load(self) -> BenchmarkData:
        """Read the file.

        Raises:
            DataError: see `read_samples`.
        """
        return BenchmarkData(
            read_samples(self.csv, self.robot, no_torque=self.no_torque), self.robot
        )


def samples_of(path: Path, table: pd.DataFrame, robot: Robot, hint: str) -> Samples:
    """Return the samples of a table that is, or is to be, the file `path`, once it is checked.

    Raises:
        DataError: see `read_samples`; `hint` stands behind the first of several problems.
    """
    return _samples(check_sheet(sheet_of(path, table), robot), hint)


def _samples(checked: CheckedSamples, hint: str) -> Samples:
    """Return the samples, or raise for the first problem."""
    if checked.samples is None or checked.problems:
        raise problems_error(checked.path, checked.problems, hint)
    return checked.samples
