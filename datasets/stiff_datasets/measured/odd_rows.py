"""Find what is legal in measured data and yet odd: copies, ranges, repeats, further axes.

Every check yields findings; `lines` is the (n,) row number of every sample in its file.
"""

from __future__ import annotations

import re
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from typing import Literal

import numpy as np

from stiff_datasets.measured.file_options import POSE_TOLERANCE
from stiff_datasets.measured.row_checks import linked_rows
from stiff_datasets.measured.sample_columns import (
    DEFLECTION_COLUMNS,
    MM_PER_M,
    WRENCH_COLUMNS,
    file_units,
)
from stiff_datasets.measured.sheet_files import Sheet
from stiff_protocols.contract.types import BoolArray, FloatArray, IntArray, Robot, Samples

LARGEST_FORCE_N = 5000.0
"""More than a tool of a common industrial robot carries; the column may be in another unit."""
SMALLEST_FORCE_N = 1.0
"""A robot does not deflect measurably under less; the column may be in kN or kg."""
FEWEST_SAMPLES = 30
"""Below, leave-one-out results of two methods can hardly be told apart."""
NOISE_MM = 0.05
"""Several times what a tracker repeats; less is never reported as odd."""
FAR_OFF = 6.0
"""Robust standard deviations from the median at which a value is odd: of normal values one in
1e9. Residuals have longer tails, hence `MODEL_ERROR` beside it."""
SAME_LOAD = 0.02
"""Loads of a pose that differ by less than this share, or by what sensors do, are repeats."""
SENSOR_NOISE = np.repeat([0.5, 0.05], 3)
"""(6,) N, N m: differences that are no difference between loads."""
FEWEST_SATURATED, SATURATED = 5, 4.0
"""Rows with exactly the same extreme value, and how many times as often as any other value."""
AXIS_NAME = re.compile(
    r"((q|a|j|joint|axis|achse|gelenk|theta|e|ex|ext|eax)[\s_]*\d+|"
    r"(ext|extern|external|linear|zusatz)?[\s_]*(axis|achse|rail|track|gantry|slide|lift|carriage|"
    r"turntable|positioner|schiene|drehtisch|fahrachse)[\s_]*\d*)"
    r"([\s_]*pos(ition)?)?([\s_]*[\[(/]?\s*(deg|degrees|grad|°|rad|mm|m)\s*[\])]?)?"
)
"""Names, in lower case, of columns that may be one more axis: E1, A7 [deg], rail_mm."""
SAME_AXIS = 0.05
"""deg or mm; an axis that moves less stands still, as poses do."""
FEWEST_REPEATS = 5


@dataclass(frozen=True)
class Finding:
    """One thing to know about a file.

    Attributes:
        level: "error": the file cannot be used; "warning": look at it; "fact": as it should be.
        message: one line, of a fact "name: value".
        rows: row numbers in the file (see `stiff_datasets.measured.sheet_files.Sheet`).
    """

    level: Literal["error", "warning", "fact"]
    message: str
    rows: tuple[int, ...] = ()


def warning(message: str, rows: IntArray | tuple[()] = ()) -> Finding:
    """Return what to look at."""
    return Finding("warning", message, tuple(int(row) for row in rows))


def fact(name: str, value: str) -> Finding:
    """Return what is as it should be."""
    return Finding("fact", f"{name}: {value}")


def duplicate_findings(samples: Samples, near_poses: str, lines: IntArray) -> Iterator[Finding]:
    """Find poses that have two names, samples that stand twice and deflections that were copied.

    `near_poses` describes the poses of two names (see `sample_file.CheckedSamples`).
    """
    if near_poses:
        yield warning(near_poses)
    again = _repeats_of_earlier_rows(np.column_stack([samples.q, samples.wrench]))
    again = again[samples.wrench[again].any(axis=1)]
    if len(again):
        yield warning(
            "the same joint angles and the same wrench as in an earlier row, under other ids; a "
            "repeated measurement, or a copy?",
            lines[again],
        )
    copied = _repeats_of_earlier_rows(samples.deflection)
    copied = copied[samples.deflection[copied].any(axis=1)]
    if len(copied) and _coincidences(samples.deflection) < 0.05:
        yield warning(
            "the same three deflections as in an earlier row, to the last digit; was it copied?",
            lines[copied],
        )


def range_findings(samples: Samples, lines: IntArray) -> Iterator[Finding]:
    """Find loads and deflections that may be, but hardly are."""
    force = np.linalg.norm(samples.wrench[:, :3], axis=1)
    size_mm = np.linalg.norm(samples.deflection, axis=1) * MM_PER_M
    loaded = samples.wrench.any(axis=1)
    if (force > LARGEST_FORCE_N).any():
        yield warning(
            f"force above {LARGEST_FORCE_N:g} N (largest {force.max():.4g}); is it in N?",
            lines[force > LARGEST_FORCE_N],
        )
    if force.max() < SMALLEST_FORCE_N:
        yield warning(
            f"every force is below {SMALLEST_FORCE_N:g} N (largest {force.max():.4g}); is it in N?"
        )
    if (loaded & (size_mm == 0.0)).any():
        yield warning("no deflection at all under a load", lines[loaded & (size_mm == 0.0)])
    for column, values in zip(DEFLECTION_COLUMNS, samples.deflection.T, strict=True):
        if not values.any() and samples.deflection.any():
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
    """Yield each end of the range of (n,) values at which they look cut off, and its rows.

    Many rows have exactly that value, and no value between the ends is nearly as frequent.
    """
    numbers, counts = np.unique(values, return_counts=True)
    usual = counts[1:-1].max(initial=1)
    if counts[1:-1].sum() < len(values) // 4:
        return  # a few loads that were chosen
    for limit, count in {(numbers[0], counts[0]), (numbers[-1], counts[-1])}:
        if limit and count >= max(FEWEST_SATURATED, SATURATED * usual):
            yield float(limit), np.flatnonzero(values == limit)


def external_axis_findings(
    sheet: Sheet, unused: Sequence[str], robot: Robot, lines: IntArray
) -> Iterator[Finding]:
    """Find columns that look like an axis that moved and that the robot does not have.

    `unused` are names of the sheet's columns, and `lines` (n,) the row numbers of the samples.
    """
    rows, names = np.isin(sheet.lines, lines), [*sheet.cells.columns]
    for column in unused:
        if names.count(column) > 1 or not AXIS_NAME.fullmatch(column.strip().lower()):
            continue
        values = sheet.numbers((column,))[rows, 0]
        if np.ptp(values) > SAME_AXIS:  # False of what is no number
            yield warning(
                f"column {column} looks like an axis that moved ({values.min():.6g} to "
                f"{values.max():.6g}); {robot.name} has no such joint: add it to the robot "
                "description, or use rows with the axis at one place"
            )


def repeat_findings(samples: Samples, robot: Robot, lines: IntArray) -> Iterator[Finding]:
    """Say how far readings of the same load at the same pose differ."""
    groups = repeated_rows(samples, robot)
    if not groups:
        return
    readings = [samples.deflection[rows] * MM_PER_M for rows in groups]
    spread_mm = np.array(
        [np.linalg.norm(each - each.mean(axis=0), axis=1).max() for each in readings]
    )
    yield fact(
        "repeats",
        f"{len(groups)} loads measured again, deflection within {np.median(spread_mm):.3f} mm of "
        f"their mean (median), {spread_mm.max():.3f} mm (largest)",
    )
    middle, deviation = middle_and_deviation(spread_mm)
    far = np.flatnonzero(spread_mm > max(middle + FAR_OFF * deviation, NOISE_MM))
    if len(groups) >= FEWEST_REPEATS and len(far):
        yield warning(
            f"repeats of a load differ far more than elsewhere, by up to {spread_mm[far].max():.3g}"
            " mm from their mean",
            lines[np.concatenate([groups[i] for i in far])],
        )


def middle_and_deviation(values: FloatArray) -> tuple[float, float]:
    """Return the median, and the standard deviation from it as outliers do not change it."""
    middle = float(np.median(values))
    return middle, 1.4826 * float(np.median(np.abs(values - middle)))  # of normal values


def repeated_rows(samples: Samples, robot: Robot) -> list[IntArray]:
    """Return the rows of each load that was measured more than once at the same pose."""
    poses = linked_rows(samples.q * file_units(robot), POSE_TOLERANCE)
    groups = []
    for pose in np.flatnonzero(np.bincount(poses) > 1):
        left = np.flatnonzero(poses == pose)
        while len(left):
            alike = _alike(samples.wrench[left], samples.wrench[left[0]])
            if alike.sum() > 1:
                groups.append(left[alike])
            left = left[~alike]
    return groups


def _alike(wrenches: FloatArray, wrench: FloatArray) -> BoolArray:
    """Return (n,) whether force and torque of `wrenches` (n, 6) are nearly those of `wrench`."""
    size = np.linalg.norm(wrench.reshape(2, 3), axis=1).repeat(3)
    return np.asarray(
        (np.abs(wrenches - wrench) <= np.maximum(SAME_LOAD * size, SENSOR_NOISE)).all(axis=1)
    )


def _repeats_of_earlier_rows(table: FloatArray) -> IntArray:
    """Return the rows of (n, k) that are equal to an earlier one."""
    _, first = np.unique(table, axis=0, return_index=True)
    return np.setdiff1d(np.arange(len(table)), first)


def _coincidences(table: FloatArray) -> float:
    """Return how many pairs of rows would be equal by chance: readings may have few digits."""
    distinct = np.unique(table, axis=0)  # so that copies do not make themselves likely
    share = 1.0
    for column in distinct.T:
        counts = np.unique(column, return_counts=True)[1]
        share *= (counts * (counts - 1)).sum() / max(len(column) * (len(column) - 1), 1)
    return float(share * len(table) * (len(table) - 1) / 2)
