"""Find valid but suspicious rows in measured data: copies, ranges, repeats, further axes.

Every check yields findings; `lines` is the (n,) row number of every sample in its file.
"""

from __future__ import annotations

import re
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from typing import Literal

import numpy as np

from stiff_datasets.measured.file_options import POSE_TOLERANCE
from stiff_datasets.measured.row_checks import linked_rows, shortest_moves
from stiff_datasets.measured.sample_columns import (
    DECIMALS,
    DEFLECTION_COLUMNS,
    MM_PER_M,
    WRENCH_COLUMNS,
    file_units,
)
from stiff_datasets.measured.table_reader import Sheet
from stiff_protocols.contract.types import BoolArray, FloatArray, IntArray, Robot, Samples

MAX_FORCE_N = 5000.0
"""Tools of common industrial robots carry less; a larger number may be in another unit."""
MIN_FORCE_N = 1.0
"""A smaller force does not deflect a robot measurably; the column may be in kN or kg."""
FEWEST_SAMPLES = 30
"""With fewer, leave-one-out results of two methods can hardly be told apart."""
NOISE_MM = 0.05
"""Several times a tracker's repeatability; a smaller value is never reported as odd."""
OUTLIER_DEVIATIONS = 6.0
"""Robust standard deviations from the median at which a value is odd: one in 1e9 normal values.
Residuals have longer tails, hence `MODEL_ERROR` in addition."""
LOAD_TOLERANCE = 0.02
"""Loads of a pose are repeats if they differ by less than this share, or by `SENSOR_NOISE`."""
SENSOR_NOISE = np.repeat([0.5, 0.05], 3)
"""(6,) N, N m: smaller differences do not distinguish two loads."""
MIN_SATURATED, SATURATION_RATIO = 5, 4.0
"""Least number of rows with the same extreme value, and its ratio to any other value's count."""
AXIS_NAME = re.compile(
    r"((q|a|j|joint|axis|achse|gelenk|theta|e|ex|ext|eax)[\s_]*\d+|"
    r"(ext|extern|external|linear|zusatz)?[\s_]*(axis|achse|rail|track|gantry|slide|lift|carriage|"
    r"turntable|positioner|schiene|drehtisch|fahrachse)[\s_]*\d*)"
    r"([\s_]*pos(ition)?)?([\s_]*[\[(/]?\s*(deg|degrees|grad|°|rad|mm|m)\s*[\])]?)?"
)
"""Names, in lower case, of columns that may be a further axis: E1, A7 [deg], rail_mm."""
AXIS_TOLERANCE = 0.05
"""deg or mm; an axis that moves less is at rest."""
MIN_REPEATS = 5


@dataclass(frozen=True)
class Finding:
    """A fact, a warning or an error about a file.

    Attributes:
        level: "error": the file cannot be used; "warning": to be checked; "note": a warning that
            needs no check; "fact": as expected.
        message: one line; for a fact "name: value".
        rows: row numbers in the file (see `stiff_datasets.measured.table_reader.Sheet`).
    """

    level: Literal["error", "warning", "note", "fact"]
    message: str
    rows: tuple[int, ...] = ()


def warning(message: str, rows: IntArray | tuple[()] = ()) -> Finding:
    """Return a finding to be checked."""
    return Finding("warning", message, tuple(int(row) for row in rows))


def fact(name: str, value: str) -> Finding:
    """Return a finding that is as expected."""
    return Finding("fact", f"{name}: {value}")


def duplicate_findings(
    samples: Samples, robot: Robot, pose_doubts: Sequence[str], lines: IntArray
) -> Iterator[Finding]:
    """Find poses with two names, repeated samples and copied deflections.

    `pose_doubts` are texts on the names of poses (see `sample_file.CheckedSamples`).
    """
    for doubt in pose_doubts:
        yield warning(doubt)
    q_file = shortest_moves((samples.q * file_units(robot)).round(DECIMALS), robot.turns)
    repeated = _repeats_of_earlier_rows(np.column_stack([q_file, samples.wrench]))
    repeated = repeated[samples.wrench[repeated].any(axis=1)]
    if len(repeated):
        yield warning(
            "the same joint angles and the same wrench as in an earlier row, under other ids; a "
            "repeated measurement, or a copy?",
            lines[repeated],
        )
    copied = _repeats_of_earlier_rows(samples.deflection)
    copied = copied[samples.deflection[copied].any(axis=1)]
    if len(copied) and _coincidences(samples.deflection) < 0.05:
        yield warning(
            "the same three deflections as in an earlier row, to the last digit; was it copied?",
            lines[copied],
        )


def range_findings(samples: Samples, lines: IntArray) -> Iterator[Finding]:
    """Find implausible loads and deflections."""
    force = np.linalg.norm(samples.wrench[:, :3], axis=1)
    size_mm = np.linalg.norm(samples.deflection, axis=1) * MM_PER_M
    loaded = samples.wrench.any(axis=1)
    if (force > MAX_FORCE_N).any():
        yield warning(
            f"force above {MAX_FORCE_N:g} N (largest {force.max():.4g}); is it in N?",
            lines[force > MAX_FORCE_N],
        )
    if force.max() < MIN_FORCE_N:
        yield warning(
            f"every force is below {MIN_FORCE_N:g} N (largest {force.max():.4g}); is it in N?"
        )
    if (loaded & (size_mm == 0.0)).any():
        yield warning("no deflection at all under a load", lines[loaded & (size_mm == 0.0)])
    for column, values in zip(DEFLECTION_COLUMNS, samples.deflection.T, strict=True):
        if not values.any() and samples.deflection.any() and not samples.directions.size:
            yield warning(f"every {column} is zero; was it not measured?")
    numbers = np.hstack([samples.wrench, samples.deflection * MM_PER_M])
    for column, values in zip((*WRENCH_COLUMNS, *DEFLECTION_COLUMNS), numbers.T, strict=True):
        for limit, rows in _saturated(values):
            yield warning(
                f"{column} is exactly {limit:.6g} in {len(rows)} rows and never beyond, while its "
                "other values hardly repeat; did the sensor reach its limit?",
                lines[rows],
            )
    odd = ~loaded & (size_mm > NOISE_MM)
    if odd.any():
        yield warning(f"deflection without a load, up to {size_mm[odd].max():.3g} mm", lines[odd])


def _saturated(values: FloatArray) -> Iterator[tuple[float, IntArray]]:
    """Yield each saturated end of the range of (n,) values, and its rows.

    Many rows have exactly that value, and no value between the ends is nearly as frequent.
    """
    numbers, counts = np.unique(values, return_counts=True)
    usual = counts[1:-1].max(initial=1)
    if counts[1:-1].sum() < len(values) // 4:
        return  # the loads were a few chosen values
    for limit, count in {(numbers[0], counts[0]), (numbers[-1], counts[-1])}:
        if limit and count >= max(MIN_SATURATED, SATURATION_RATIO * usual):
            yield float(limit), np.flatnonzero(values == limit)


def external_axis_findings(
    sheet: Sheet, unused: Sequence[str], robot: Robot, lines: IntArray
) -> Iterator[Finding]:
    """Find columns of a moving axis that the robot does not have.

    `unused` are names of the sheet's columns, and `lines` (n,) the row numbers of the samples.
    """
    rows, names = np.isin(sheet.lines, lines), [*sheet.cells.columns]
    for column in unused:
        if names.count(column) > 1 or not AXIS_NAME.fullmatch(column.strip().lower()):
            continue
        values = sheet.numbers((column,))[rows, 0]
        if np.ptp(values) > AXIS_TOLERANCE:  # False if there is no number
            yield warning(
                f"column {column} looks like an axis that moved ({values.min():.6g} to "
                f"{values.max():.6g}); {robot.name} has no such joint: add it to the robot "
                "description, or use rows with the axis at one position"
            )


def repeat_findings(samples: Samples, robot: Robot, lines: IntArray) -> Iterator[Finding]:
    """Report the spread of repeated readings of one load at one pose."""
    groups = repeated_rows(samples, robot)
    if not groups:
        return
    readings = [samples.deflection[rows] * MM_PER_M for rows in groups]
    spread_mm = np.array(
        [
            np.linalg.norm(deflection_mm - deflection_mm.mean(axis=0), axis=1).max()
            for deflection_mm in readings
        ]
    )
    yield fact(
        "repeats",
        f"{len(groups)} loads measured again, deflection within {np.median(spread_mm):.3f} mm of "
        f"their mean (median), {spread_mm.max():.3f} mm (largest)",
    )
    middle, deviation = median_and_deviation(spread_mm)
    far = np.flatnonzero(spread_mm > max(middle + OUTLIER_DEVIATIONS * deviation, NOISE_MM))
    if len(groups) >= MIN_REPEATS and len(far):
        yield warning(
            f"repeats of a load differ far more than elsewhere, by up to {spread_mm[far].max():.3g}"
            " mm from their mean",
            lines[np.concatenate([groups[i] for i in far])],
        )


def median_and_deviation(values: FloatArray) -> tuple[float, float]:
    """Return the median and a robust standard deviation."""
    middle = float(np.median(values))
    return middle, 1.4826 * float(np.median(np.abs(values - middle)))  # ratio for normal values


def repeated_rows(samples: Samples, robot: Robot) -> list[IntArray]:
    """Return the rows of each load that was measured repeatedly at one pose."""
    poses = linked_rows(samples.q * file_units(robot), POSE_TOLERANCE, robot.turns)
    groups = []
    for pose in np.flatnonzero(np.bincount(poses) > 1):
        remaining_rows = np.flatnonzero(poses == pose)
        while len(remaining_rows):
            is_same_load = _same_load(
                samples.wrench[remaining_rows], samples.wrench[remaining_rows[0]]
            )
            if is_same_load.sum() > 1:
                groups.append(remaining_rows[is_same_load])
            remaining_rows = remaining_rows[~is_same_load]
    return groups


def _same_load(wrenches: FloatArray, wrench: FloatArray) -> BoolArray:
    """Return (n,) true if `wrenches` (n, 6) nearly equal `wrench` in force and torque."""
    size = np.linalg.norm(wrench.reshape(2, 3), axis=1).repeat(3)
    return np.asarray(
        (np.abs(wrenches - wrench) <= np.maximum(LOAD_TOLERANCE * size, SENSOR_NOISE)).all(axis=1)
    )


def _repeats_of_earlier_rows(table: FloatArray) -> IntArray:
    """Return the rows of (n, k) that are equal to an earlier row."""
    _, first = np.unique(table, axis=0, return_index=True)
    return np.setdiff1d(np.arange(len(table)), first)


def _coincidences(table: FloatArray) -> float:
    """Return the expected number of equal pairs of rows by chance, for readings of few digits."""
    distinct = np.unique(table, axis=0)  # copies must not raise the chance
    share = 1.0
    for column in distinct.T:
        counts = np.unique(column, return_counts=True)[1]
        share *= (counts * (counts - 1)).sum() / max(len(column) * (len(column) - 1), 1)
    return float(share * len(table) * (len(table) - 1) / 2)
