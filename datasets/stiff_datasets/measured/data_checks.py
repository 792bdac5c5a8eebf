"""What is legal in measured data and yet odd: copies, ranges, repeats, outliers.

Every check yields findings; `lines` is the (n,) row number of every sample in its file.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from typing import Literal

import numpy as np

from stiff_datasets.measured.file_options import POSE_TOLERANCE
from stiff_datasets.measured.hypotheses import Reading, compliances
from stiff_datasets.measured.sample_checks import linked_rows
from stiff_datasets.measured.sample_files import DEFLECTION_COLUMNS, MM_PER_M, file_units
from stiff_protocols.contract.types import BoolArray, FloatArray, IntArray, Robot, Samples

LARGEST_FORCE_N = 5000.0
"""More than a tool of a common industrial robot carries; the column may be in another unit."""
SMALLEST_FORCE_N = 1.0
"""A robot does not give way measurably under less; the column may be in kN or kg."""
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
MODEL_ERROR = 1.25
"""Share of a deflection by which joint springs may miss it where nothing is wrong: the most in the
FANUC measurement is 0.64, in ten specimens each of the shipped twins 1.14. A reading of the wrong
sign misses by 2, one with the decimal point misplaced to the right by 9."""
FEWEST_FOR_OUTLIERS = 10
FEWEST_REPEATS = 5
LISTED = 10
"""So many outliers are listed at most."""


@dataclass(frozen=True)
class Finding:
    """One thing to know about a file.

    Attributes:
        level: "error": the file cannot be used; "warning": look at it; "fact": as it should be.
        message: one line, of a fact "name: value".
        rows: row numbers in the file (see `stiff_datasets.measured.sample_files.Sheet`).
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

    `near_poses` describes the poses of two names (see `sample_checks.CheckedSamples`).
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
    odd = ~loaded & (size_mm > NOISE_MM)
    if odd.any():
        yield warning(f"deflection without a load, up to {size_mm[odd].max():.3g} mm", lines[odd])


def repeat_findings(samples: Samples, robot: Robot, lines: IntArray) -> Iterator[Finding]:
    """Say how far readings of the same load at the same pose differ."""
    groups = repeated_rows(samples, robot)
    if not groups:
        return
    spread_mm = np.array([_spread(samples.deflection[rows]) for rows in groups]) * MM_PER_M
    yield fact(
        "repeats",
        f"{len(groups)} loads measured again, deflection within {np.median(spread_mm):.3f} mm of "
        f"their mean (median), {spread_mm.max():.3f} mm (largest)",
    )
    far = np.flatnonzero(far_off(spread_mm) & (spread_mm > NOISE_MM))
    if len(groups) >= FEWEST_REPEATS and len(far):
        yield warning(
            f"repeats of a load differ far more than elsewhere, by up to {spread_mm[far].max():.3g}"
            " mm from their mean",
            lines[np.concatenate([groups[i] for i in far])],
        )


def outlier_findings(lines: IntArray, residual_mm: FloatArray, odd: BoolArray) -> Iterator[Finding]:
    """List the outliers of `residuals_and_outliers`, the largest first."""
    rows = np.flatnonzero(odd)
    if not len(rows):
        return
    rows = rows[np.argsort(-residual_mm[rows], kind="stable")]
    sizes = ", ".join(f"row {lines[row]} by {residual_mm[row]:.3g}" for row in rows[:LISTED])
    more = f", and {len(rows) - LISTED} more rows" if len(rows) > LISTED else ""
    yield warning(
        "deflection far from what joint springs explain (half of the rows are within "
        f"{np.median(residual_mm):.2g} mm): {sizes} mm{more}",
        lines[rows],
    )


def residuals_and_outliers(data: Reading) -> tuple[FloatArray, BoolArray]:
    """Return (n,) the length of each residual [mm], and whether it is an outlier.

    An outlier's residual is far off as a share of the deflection, since a model's error grows with
    the load, and more than `MODEL_ERROR` of the deflection. Joint springs are fitted again without
    the outliers until they stay the same, so that a gross one does not hide others. Of the errors
    planted in the FANUC measurement and in KR10 twins, a reading of the wrong sign and one ten
    times too large are found; one ten times too small is not.
    """
    odd = np.zeros(len(data.q), dtype=bool)
    matrix, residual_mm = data.regressor(), np.zeros(len(data.q))
    for _ in range(5):
        predicted = matrix @ compliances(data.take(~odd))
        residual_mm = np.linalg.norm(data.deflection - predicted, axis=1) * MM_PER_M
        if len(odd) < FEWEST_FOR_OUTLIERS:
            break
        sizes = (np.linalg.norm(each, axis=1) for each in (predicted, data.deflection))
        size_mm = np.minimum(*sizes) * MM_PER_M
        size_mm = np.maximum(size_mm, np.median(size_mm))  # small ones are mostly noise
        share = residual_mm / np.maximum(size_mm, NOISE_MM)
        found = far_off(share) & (share > MODEL_ERROR) & (residual_mm > NOISE_MM)
        if (found == odd).all() or found.sum() > len(odd) // 5:
            break
        odd = found
    return residual_mm, odd


def far_off(values: FloatArray) -> BoolArray:
    """Return which values lie far above the median, on the scale of the median deviation."""
    middle = np.median(values)
    deviation = 1.4826 * np.median(np.abs(values - middle))  # of normal values the standard one
    return np.asarray(values - middle > FAR_OFF * deviation)


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


def _spread(deflection: FloatArray) -> float:
    return float(np.linalg.norm(deflection - deflection.mean(axis=0), axis=1).max())


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
