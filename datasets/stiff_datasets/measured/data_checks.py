"""What is legal in measured data and yet odd: copies, ranges, repeats, outliers.

Every check yields findings; `lines` is the (n,) row number of every sample in its file.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from typing import Literal

import numpy as np

from stiff_datasets.measured.file_options import POSE_TOLERANCE
from stiff_datasets.measured.hypotheses import Reading, compliances, normal_equations
from stiff_datasets.measured.identifiability import unit_deflections
from stiff_datasets.measured.sample_checks import linked_rows
from stiff_datasets.measured.sample_files import DEFLECTION_COLUMNS, MM_PER_M, file_units
from stiff_protocols.contract.identification import RANK_TOLERANCE
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
OUTLIER = 12.0
"""Robust standard deviations above the median from which on an error is an outlier. The most in
clean data of the shipped twins, the arms and the FANUC was 9, and 12 of 12 random poses."""
MODEL_ERROR = 0.7
"""Share of a deflection by which its prediction may miss it where nothing is wrong: the most in
the FANUC measurement is 0.55, in shipped twins and arms 0.35. A reading of the wrong sign misses by
2, one with the decimal point misplaced to the right by 9."""
FACTORS = {
    "ten times too large": 10.0,
    "ten times too small": 0.1,
    "of the opposite sign": -1.0,
}
SLIPS = {
    **{what: np.full(3, factor) for what, factor in FACTORS.items()},
    **{
        f"{column} {what}": np.where(np.arange(3) == axis, factor, 1.0)
        for axis, column in enumerate(DEFLECTION_COLUMNS)
        for what, factor in FACTORS.items()
    },
}
"""Slips of the pen -> (3,) factors of the deflections in the file."""
LOST_MOTION = 0.05
"""Share of a joint's largest torque up to which its lost motion is taken up."""
RIDGE = 0.1
"""Observations that the prior is worth, which holds unit coefficients of columns of unit size: it
settles what samples do not, and takes nothing from what they do."""
BLOCK = 10_000
"""Rows whose springs are in memory at once."""
FEWEST_FOR_OUTLIERS = 10
MOST_OUTLIERS = 0.2
"""Share of the rows; if more are far off, something is wrong with all of them."""
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


def outlier_findings(lines: IntArray, outliers: Outliers) -> Iterator[Finding]:
    """List the outliers, the largest first, with the slip that explains each."""
    rows = np.flatnonzero(outliers.odd)
    if not len(rows):
        return
    error_mm = outliers.error_mm
    rows = rows[np.argsort(-error_mm[rows], kind="stable")]
    listed = ", ".join(
        f"row {lines[row]} by {error_mm[row]:.3g} mm"
        + (f" ({outliers.slips[row]}?)" if row in outliers.slips else "")
        for row in rows[:LISTED]
    )
    more = f", and {len(rows) - LISTED} more rows" if len(rows) > LISTED else ""
    yield warning(
        "deflection far from what springs fitted to the other rows predict (half of the rows are "
        f"within {np.median(error_mm):.2g} mm): {listed}{more}",
        lines[rows],
    )


@dataclass(frozen=True, eq=False)
class Outliers:
    """Rows whose deflection the other rows do not predict.

    Attributes:
        error_mm: (n,) distance of each deflection from its prediction, mm.
        odd: (n,) whether a row is an outlier.
        slips: outlier -> slip of the pen that explains its deflection.
    """

    error_mm: FloatArray
    odd: BoolArray
    slips: dict[int, str]


def find_outliers(data: Reading) -> Outliers:
    """Find the rows whose deflection is far from what springs fitted to the other rows predict.

    The springs are those of the joints, three about the axes of every joint's frame, and the lost
    motion of every joint. An error is divided by its standard error, relative to the noise, and by
    the size of the deflection, because a model's error grows with the load. A row is an outlier if
    this share lies `OUTLIER` robust standard deviations above the median, and if it is more than
    `MODEL_ERROR` or one of `SLIPS` leaves a usual share. The springs are first fitted without the
    fifth of the rows that joint springs explain worst, then without the outliers until they stay
    the same: a gross outlier does not hide others.
    """
    n = len(data.q)
    given_mm = data.deflection * MM_PER_M
    left_mm = np.linalg.norm(given_mm - data.regressor() @ compliances(data) * MM_PER_M, axis=1)
    odd = left_mm > np.quantile(left_mm, 1.0 - MOST_OUTLIERS)
    for _ in range(5):
        predicted, root = _left_out(data, ~odd)
        error_mm = given_mm - predicted * MM_PER_M  # (n, 3)
        length_mm = np.linalg.norm(error_mm, axis=1)
        size_mm = np.linalg.norm([given_mm, given_mm - error_mm], axis=2).min(axis=0)
        size_mm = np.maximum(size_mm, max(np.median(size_mm), NOISE_MM))  # small ones are noise
        root /= size_mm[:, None, None]
        share = _lengths(root, error_mm)
        middle, deviation = _middle_and_deviation(share[~odd])
        usual = np.maximum(middle + FAR_OFF * deviation, NOISE_MM / size_mm)
        far = (share > middle + OUTLIER * deviation) & (length_mm > NOISE_MM)
        slips = {
            int(row): slip
            for row in np.flatnonzero(far)
            if (slip := _slip(given_mm[row], error_mm[row], root[row], usual[row]))
        }
        found = far & (share > MODEL_ERROR)
        found[[*slips]] = True
        if n < FEWEST_FOR_OUTLIERS or found.sum() > MOST_OUTLIERS * n:
            return Outliers(length_mm, np.zeros(n, dtype=bool), {})
        if (found == odd).all():
            break
        odd = found
    return Outliers(length_mm, found, slips)


def _slip(given: FloatArray, error: FloatArray, root: FloatArray, usual: np.floating) -> str | None:
    """Return which of `SLIPS` leaves a usual error of a deflection (3,), if one does.

    A slip in numbers that would be as usual if they were zero says nothing.
    """
    factors = np.stack([*SLIPS.values()])  # (n_slips, 3)
    none = np.where(factors == 1.0, given, 0.0)
    corrected = np.stack([given / factors, none])  # (2, n_slips, 3)
    left, left_by_none = _lengths(root, corrected - given + error)
    left = np.where(left_by_none > usual, left, np.inf)
    likeliest = int(np.argmin(left))
    return [*SLIPS][likeliest] if left[likeliest] < usual else None


def _lengths(root: FloatArray, vectors: FloatArray) -> FloatArray:
    """Return (n,) the lengths of (n, 3) vectors after (n, 3, 3) matrices, or one for all."""
    return np.asarray(np.linalg.norm((root @ vectors[..., None])[..., 0], axis=-1))


def _left_out(data: Reading, fitted: BoolArray) -> tuple[FloatArray, FloatArray]:
    """Predict each row by springs fitted to the others.

    Args:
        data: the samples.
        fitted: (n,) rows that the springs are fitted to.

    Returns:
        (n, 3) predicted deflections, m, and (n, 3, 3) the inverse root of the covariance of their
        errors, as a multiple of the noise's.
    """
    blocks = np.array_split(np.arange(len(fitted)), len(fitted) // BLOCK + 1)
    load = (np.hstack([data.force, data.torque])[:, None] @ data.jacobian)[:, 0]
    knee = LOST_MOTION * np.abs(load).max(axis=0) + 1e-9  # (n_joints,) N m
    n_columns = 5 * data.q.shape[1]
    gram, right = np.zeros((n_columns, n_columns)), np.zeros(n_columns)
    for rows in blocks:
        rows = rows[fitted[rows]]
        matrix = _spring_and_lost_motion(data.take(rows), knee)
        grams, rights = normal_equations(matrix, data.deflection[rows])
        gram, right = gram + grams, right + rights
    size = np.sqrt(np.diagonal(gram))
    size = np.where(size > RANK_TOLERANCE * size.max(), size, np.inf)
    weight = RIDGE / (3.0 * fitted.sum())
    inverse = np.linalg.inv(gram / np.outer(size, size) + weight * np.eye(len(size)))
    found = inverse @ (right / size)
    predicted, roots = np.empty_like(data.deflection), np.empty((len(fitted), 3, 3))
    for rows in blocks:
        matrix = _spring_and_lost_motion(data.take(rows), knee) / size
        own = matrix @ inverse @ matrix.swapaxes(1, 2)  # (n, 3, 3) share of a row in its own fit
        inside = fitted[rows][:, None, None]
        covariance = np.where(inside, np.linalg.inv(np.eye(3) - inside * own), np.eye(3) + own)
        error = (data.deflection[rows] - matrix @ found)[..., None]
        error = np.where(inside, covariance @ error, error)[..., 0]
        predicted[rows] = data.deflection[rows] - error
        roots[rows] = np.linalg.inv(np.linalg.cholesky(covariance))
    return predicted, roots


def _spring_and_lost_motion(data: Reading, knee: FloatArray) -> FloatArray:
    """Return (n, 3, 5 n_joints) the deflections by springs and lost motions of unit size.

    Lost motion goes with the arctangent of a joint's torque over its `knee` (n_joints,) [N m],
    from the torque of the arm's own weight on.
    """
    poses, jacobian = data.robot.forward(data.q), data.jacobian
    axes = poses.rotations.swapaxes(2, 3).reshape(len(jacobian), -1, 3)
    levers = np.repeat(poses.points[:, -1:] - poses.points[:, :-1], 3, axis=1)
    tilts = np.concatenate([np.cross(axes, levers), axes], axis=2).swapaxes(1, 2)
    wrench = np.hstack([data.force, data.torque])
    weight = data.robot.gravity_torque(data.q)
    load = (wrench[:, None] @ jacobian)[:, 0]
    lost = np.arctan((weight + load) / knee) - np.arctan(weight / knee)
    parts = data.regressor(), unit_deflections(tilts, wrench), jacobian[:, :3] * lost[:, None]
    return np.concatenate(parts, axis=2)


def far_off(values: FloatArray) -> BoolArray:
    """Return which values lie far above the median, on the scale of the median deviation."""
    middle, deviation = _middle_and_deviation(values)
    return np.asarray(values > middle + FAR_OFF * deviation)


def _middle_and_deviation(values: FloatArray) -> tuple[float, float]:
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
