"""One's own measured data: the samples of a CSV or Parquet file and their robot.

The columns are those of `stiff_datasets.measured.sample_files`.
"""

from __future__ import annotations

import warnings
from dataclasses import dataclass, replace
from pathlib import Path

import pandas as pd

from stiff_datasets.measured.data_card import read_card
from stiff_datasets.measured.sample_checks import CheckedSamples, check_sheet, problems_error
from stiff_datasets.measured.sample_files import read_sheet, sheet_of
from stiff_protocols.contract.errors import StiffBenchWarning
from stiff_protocols.contract.types import BenchmarkData, Robot, Samples


def read_samples(path: Path, robot: Robot, *, no_torque: bool = False) -> Samples:
    """Read and check a file of measured samples.

    Columns that are not ours are kept aside; a `StiffBenchWarning` names them. The instrument's
    noise is what a data card FILE.md beside the file states.

    Args:
        path: the file; Parquet or Excel if it ends in .parquet or .xlsx, else CSV.
        robot: that was measured; gives the number of joints and their limits.
        no_torque: torques were not measured; their columns may be missing.

    Raises:
        DataError: the file is unreadable, empty or wrongly headed, or a value cannot be; the
            message names file, row (1 is the header of a CSV file), column, value and what is
            valid, and how many problems there are beside the first. Or the card's noise is none.
    """
    checked = check_sheet(read_sheet(path), robot, no_torque=no_torque)
    samples = _samples(checked, "bench data validate lists them")
    if noise := read_card(path).instrument_noise:  # else the arrays would be copied for nothing
        samples = replace(samples, instrument_noise=noise)
    for oddity in checked.sheet.oddities:
        warnings.warn(oddity, StiffBenchWarning, stacklevel=2)
    return samples


@dataclass(kw_only=True, eq=False)
class MeasuredData:
    """A user's own measurement: a file of samples and the robot they were measured on.

    Attributes:
        csv: the samples; Parquet or Excel if the name ends in .parquet or .xlsx.
        robot: the robot.
        no_torque: torques were not measured; their columns may be missing.
    """

    csv: Path
    robot: Robot
    no_torque: bool = False

    def load(self) -> BenchmarkData:
        """Read the file.

        Raises:
            DataError: see `read_samples`.
        """
        samples = read_samples(self.csv, self.robot, no_torque=self.no_torque)
        return BenchmarkData(samples, self.robot)


def samples_of(path: Path, table: pd.DataFrame, robot: Robot, hint: str) -> Samples:
    """Return the samples of a table with the columns of a file, once it is checked.

    Raises:
        DataError: see `read_samples`; it names `path`, and `hint` stands behind the first of
            several problems.
    """
    return _samples(check_sheet(sheet_of(path, table), robot), hint)


def _samples(checked: CheckedSamples, hint: str) -> Samples:
    """Return the samples, or raise for the first problem."""
    if checked.samples is None or checked.problems or checked.unfilled:
        problems = [checked.unfilled] if checked.unfilled else checked.problems
        raise problems_error(checked.sheet.path, problems, hint)
    return checked.samples
