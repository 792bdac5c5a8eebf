"""One's own measured data: the samples of a CSV or Parquet file and their robot.

The columns are those of `stiff_datasets.measured.sample_files`.
"""

from __future__ import annotations

import warnings
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
import pandas as pd

from stiff_datasets.measured.data_card import read_card
from stiff_datasets.measured.file_options import DEFAULTS, FileOptions
from stiff_datasets.measured.sample_checks import (
    CheckedSamples,
    check_sheet,
    linked_rows,
    near_poses_text,
    pose_reach,
    problems_error,
)
from stiff_datasets.measured.sample_files import file_units, read_sheet, sheet_of
from stiff_protocols.contract.errors import StiffBenchWarning
from stiff_protocols.contract.types import BenchmarkData, Robot, Samples


def read_samples(path: Path, robot: Robot, options: FileOptions = DEFAULTS) -> Samples:
    """Read and check a file of measured samples.

    A `StiffBenchWarning` each names the columns that are not used, the number of poses that rows
    without `pose_id` were grouped into, and poses that have two names. The instrument's
    noise is what a data card FILE.md beside the file states.

    Args:
        path: the file; Parquet or Excel if it ends in .parquet or .xlsx, else CSV.
        robot: that was measured; gives the number of joints and their limits.
        options: what is not in the file.

    Raises:
        ConfigError: the file has no such sheet, or several with tables and none is asked for.
        DataError: the file is unreadable, empty or wrongly headed, or a value cannot be; the
            message names file, row (1 is the header of a CSV file), column, value and what is
            valid, and how many problems there are beside the first. Or the card's noise is none.
    """
    checked = check_sheet(read_sheet(path, options.sheet), robot, options)
    samples = _samples(checked, "bench data validate lists them")
    if noise := read_card(path).instrument_noise:  # else the arrays would be copied for nothing
        samples = replace(samples, instrument_noise=noise)
    return samples


@dataclass(kw_only=True, eq=False)
class MeasuredData:
    """A user's own measurement: a file of samples and the robot they were measured on.

    Attributes:
        csv: the samples; Parquet or Excel if the name ends in .parquet or .xlsx.
        robot: the robot.
        options: what is not in the file.
    """

    csv: Path
    robot: Robot
    options: FileOptions = DEFAULTS

    def load(self) -> BenchmarkData:
        """Read the file.

        Raises:
            DataError: see `read_samples`.
        """
        return BenchmarkData(read_samples(self.csv, self.robot, self.options), self.robot)


def samples_of(
    path: Path, table: pd.DataFrame, robot: Robot, hint: str, options: FileOptions = DEFAULTS
) -> Samples:
    """Return the samples of a table with the columns of a file, once it is checked.

    Warnings are those of `read_samples`.

    Raises:
        DataError: see `read_samples`; it names `path`, and `hint` stands behind the first of
            several problems.
    """
    return _samples(check_sheet(sheet_of(path, table), robot, options), hint)


def near_poses(samples: Samples, robot: Robot, tolerance: float = DEFAULTS.pose_tolerance) -> str:
    """Describe poses of different `pose_id` that lie within a tolerance, deg and mm; "" for none.

    Rows are counted from 0.
    """
    near = linked_rows(samples.q * file_units(robot), tolerance)
    reach = pose_reach(robot, tolerance)
    return near_poses_text(samples.pose_id, near, np.arange(len(samples)), reach)


def _samples(checked: CheckedSamples, hint: str) -> Samples:
    """Return the samples with a warning of each oddity, or raise for the first problem."""
    path = checked.sheet.path
    if checked.samples is None or checked.problems or checked.unfilled:
        problems = [checked.unfilled] if checked.unfilled else checked.problems
        raise problems_error(path, problems, hint)
    near = [f"{path}: {checked.near_poses}"] if checked.near_poses else []
    for oddity in (*checked.sheet.oddities, *near):
        warnings.warn(oddity, StiffBenchWarning, stacklevel=3)
    return checked.samples
