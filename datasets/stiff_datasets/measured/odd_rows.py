"""Find what is legal in measured data and yet odd: copies, ranges, repeats, outliers, drift.

Every check yields findings; `lines` is the (n,) row number of every sample in its file.
"""

from __future__ import annotations

import re
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from typing import Literal

import numpy as np

from stiff_datasets.measured.file_options import POSE_TOLERANCE
from stiff_datasets.measured.identifiability import unit_deflections
from stiff_datasets.measured.mistakes import Reading, compliances, normal_equations
from stiff_datasets.measured.row_checks import linked_rows
from stiff_datasets.measured.sample_columns import (
    DEFLECTION_COLUMNS,
    MM_PER_M,
    WRENCH_COLUMNS,
    file_units,
)
from stiff_datasets.measured.sheet_files import Sheet
from stiff_protocols.contract.identification import RANK_TOLERANCE
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
CLEAR_CHANGE, CHANGE_GAIN = 16.0, 0.05
"""F statistic of a drift or a jump, and the share by which it must lower the RMS error of rows that
are left out. Of the clean data that gained as much, from 20 poses on, the largest F was 12."""
FEWEST_FOR_CHANGE, MOST_FOR_CHANGE, FEWEST_BESIDE_JUMP = 20, 5000, 5
"""Rows; of a longer file rows at equal distances are compared."""
BLOCK = 10_000
"""Rows whose springs are in memory at once."""
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
FEWEST_FOR_OUTLIERS = 10
MOST_OUTLIERS = 0.2
"""Share of the rows; if more are far off, something is wrong with all of them."""
FEWEST_REPEATS = 5
LISTED = 10
"""Most outliers that are listed."""


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

    Args:
        sheet: the file as it was read.
        unused: names of its columns that are not used.
        robot: that was measured.
        lines: (n,) row numbers of the samples.
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
        fit = _left_out(data, ~odd)
        error_mm = fit.error * MM_PER_M  # (n, 3)
        length_mm = np.linalg.norm(error_mm, axis=1)
        size_mm = np.linalg.norm([given_mm, given_mm - error_mm], axis=2).min(axis=0)
        size_mm = np.maximum(size_mm, max(np.median(size_mm), NOISE_MM))  # small ones are noise
        root = np.linalg.inv(np.linalg.cholesky(fit.covariance)) / size_mm[:, None, None]
        share = _lengths(root, error_mm)
        middle, deviation = _middle_and_deviation(share[~odd])
        usual = np.maximum(middle + FAR_OFF * deviation, NOISE_MM / size_mm)
        far = (share > middle + OUTLIER * deviation) & (length_mm > NOISE_MM)
        slips = {
            int(row): slip
            for row in np.flatnonzero(far)
            if (slip := _slip(given_mm[row], error_mm[row], root[row], usual[row]))
        }
        outlier = far & (share > MODEL_ERROR)
        outlier[[*slips]] = True
        if n < FEWEST_FOR_OUTLIERS or outlier.sum() > MOST_OUTLIERS * n:
            return Outliers(length_mm, np.zeros(n, dtype=bool), {})
        if (outlier == odd).all():
            break
        odd = outlier
    return Outliers(length_mm, outlier, slips)


def _slip(given: FloatArray, error: FloatArray, root: FloatArray, usual: np.floating) -> str | None:
    """Return which of `SLIPS` leaves a usual error of a deflection (3,), if one does.

    A slip in numbers that would be as usual if they were zero says nothing.
    """
    factors = np.stack([*SLIPS.values()])  # (n_slips, 3)
    none = np.where(factors == 1.0, given, 0.0)
    corrected = np.stack([given / factors, none])  # (2, n_slips, 3)
    misfit, misfit_of_none = _lengths(root, corrected - given + error)
    misfit = np.where(misfit_of_none > usual, misfit, np.inf)
    likeliest = int(np.argmin(misfit))
    return [*SLIPS][likeliest] if misfit[likeliest] < usual else None


def _lengths(root: FloatArray, vectors: FloatArray) -> FloatArray:
    """Return (n,) the lengths of (n, 3) vectors after (n, 3, 3) matrices, or one for all."""
    return np.asarray(np.linalg.norm((root @ vectors[..., None])[..., 0], axis=-1))


@dataclass(frozen=True, eq=False)
class Change:
    """A change while the rows were measured, one after the other.

    Attributes:
        text: what it is, in one line.
        rows: row numbers since a jump; () of a drift.
        rms: RMS error of rows that are left out, once it is undone, m.
        offset: (n, 3) what it added to the deflections, m.
    """

    text: str
    rows: IntArray | tuple[()]
    rms: float
    offset: FloatArray


def find_change(data: Reading, lines: IntArray, odd: BoolArray) -> Change | None:
    """Find a drift of the deflections over the rows of a file, or a jump at one of them.

    Each is an offset of the deflections, fitted with the springs and lost motions of
    `find_outliers` and a constant offset. It is found if the F statistic of its three numbers
    exceeds `CLEAR_CHANGE` and if the RMS error of rows that are left out falls by `CHANGE_GAIN`. Of
    the two, the better one is returned. The `odd` (n,) outliers are not looked at.
    """
    every = len(lines) // MOST_FOR_CHANGE + 1
    compared = np.flatnonzero(~odd)[::every]
    if len(compared) < FEWEST_FOR_CHANGE:
        return None
    part, fitted = data.take(compared), np.ones(len(compared), dtype=bool)
    same = np.ones(len(lines))
    given = _left_out(part, fitted, same[compared, None])
    jump = lines[compared[_likeliest_jump(part, given)]]
    first, last = lines[0], lines[-1]
    jumped = f"jumped by {{}} mm {'near' if every > 1 else 'at'} row {jump} and stayed there"
    drifted = f"drifted by {{}} mm from row {first} to row {last}"
    after = lines >= jump
    changes = []
    for what, course, rows in (
        (drifted, (lines - first) / (last - first), ()),
        (jumped, after.astype(np.float64), lines[after]),
    ):
        fit = _left_out(part, fitted, np.column_stack([same, course])[compared])
        numbers = fit.coefficients[-3:]
        information = np.linalg.inv(fit.inverse[-3:, -3:])
        statistic = float(numbers @ information @ numbers) / fit.rms**2  # of 3 numbers, 3 axes
        if statistic > CLEAR_CHANGE and fit.rms < (1.0 - CHANGE_GAIN) * given.rms:
            offset = numbers / fit.size[-3:]
            vector = ", ".join(f"{length:.2g}" for length in offset * MM_PER_M)
            text = (
                f"the deflections look as if they had {what.format(f'({vector})')}; springs fitted "
                f"to the other rows miss a row by {given.rms * MM_PER_M:.3g} mm RMS, and by "
                f"{fit.rms * MM_PER_M:.3g} mm without it (undone below)"
            )
            changes.append(Change(text, rows, fit.rms, course[:, None] * offset))
    return min(changes, key=lambda change: change.rms, default=None)


def left_out_rms(data: Reading, odd: BoolArray) -> float:
    """Return the RMS error [m] of rows that are left out, if nothing changed; not of outliers."""
    usual = data.take(~odd)
    every = np.ones(len(usual.q), dtype=bool)
    return _left_out(usual, every, np.ones((len(usual.q), 1))).rms


def _likeliest_jump(data: Reading, given: LeftOut) -> int:
    """Return from which row on an offset explains the most of what `given` leaves.

    Rows are counted from 0; each side has at least `FEWEST_BESIDE_JUMP`.
    """
    n = len(data.q)
    matrix = _effects(data, given.knee, np.ones((n, 1))) / given.size
    residual = data.deflection - matrix @ given.coefficients
    # by cumulative sums from each row to the last
    loads = np.cumsum(matrix[::-1], axis=0)[::-1]  # (n, 3, n_columns)
    residual = np.cumsum(residual[::-1], axis=0)[::-1]  # (n, 3)
    rows = np.arange(n, 0, -1)[:, None, None] * np.eye(3)
    information = (rows - loads @ given.inverse @ loads.swapaxes(1, 2))[1:]
    explained = (residual[1:] * np.linalg.solve(information, residual[1:, :, None])[..., 0]).sum(
        axis=1
    )
    inner = explained[FEWEST_BESIDE_JUMP - 1 : n - FEWEST_BESIDE_JUMP]
    return FEWEST_BESIDE_JUMP + int(np.argmax(inner))


@dataclass(frozen=True, eq=False)
class LeftOut:
    """Errors of the predictions of each row by springs that were fitted to the others.

    Attributes:
        error: (n, 3) deflection minus its prediction, m.
        covariance: (n, 3, 3) of the errors, as a multiple of the noise's.
        coefficients: (n_columns,) of columns of unit length.
        inverse: (n_columns, n_columns) covariance of the coefficients, as a multiple.
        size: (n_columns,) length of the columns; infinite of those without an effect.
        knee: (n_joints,) see `_effects`.
    """

    error: FloatArray
    covariance: FloatArray
    coefficients: FloatArray
    inverse: FloatArray
    size: FloatArray
    knee: FloatArray

    @property
    def rms(self) -> float:
        """RMS length of the errors, m."""
        return float(np.sqrt((self.error**2).sum(axis=1).mean()))


def _left_out(data: Reading, fitted: BoolArray, courses: FloatArray | None = None) -> LeftOut:
    """Predict each row by springs fitted to the others.

    Args:
        data: the samples.
        fitted: (n,) rows that the springs are fitted to.
        courses: (n, m) how m offsets of the deflections change from row to row.
    """
    courses = np.empty((len(fitted), 0)) if courses is None else courses
    blocks = np.array_split(np.arange(len(fitted)), len(fitted) // BLOCK + 1)
    load = (np.hstack([data.force, data.torque])[:, None] @ data.jacobian)[:, 0]
    knee = LOST_MOTION * np.abs(load).max(axis=0) + 1e-9  # (n_joints,) N m
    n_columns = 5 * data.q.shape[1] + 3 * courses.shape[1]
    gram, right = np.zeros((n_columns, n_columns)), np.zeros(n_columns)
    for rows in blocks:
        rows = rows[fitted[rows]]
        matrix = _effects(data.take(rows), knee, courses[rows])
        grams, rights = normal_equations(matrix, data.deflection[rows])
        gram, right = gram + grams, right + rights
    size = np.sqrt(np.diagonal(gram))
    size = np.where(size > RANK_TOLERANCE * size.max(), size, np.inf)
    weight = RIDGE / (3.0 * fitted.sum())
    inverse = np.linalg.inv(gram / np.outer(size, size) + weight * np.eye(n_columns))
    coefficients = inverse @ (right / size)
    errors, covariances = np.empty_like(data.deflection), np.empty((len(fitted), 3, 3))
    for rows in blocks:
        matrix = _effects(data.take(rows), knee, courses[rows]) / size
        leverage = (
            matrix @ inverse @ matrix.swapaxes(1, 2)
        )  # (n, 3, 3) share of a row in its own fit
        inside = fitted[rows][:, None, None]
        covariance = np.where(
            inside, np.linalg.inv(np.eye(3) - inside * leverage), np.eye(3) + leverage
        )
        error = (data.deflection[rows] - matrix @ coefficients)[..., None]
        errors[rows] = np.where(inside, covariance @ error, error)[..., 0]
        covariances[rows] = covariance
    return LeftOut(errors, covariances, coefficients, inverse, size, knee)


def _effects(data: Reading, knee: FloatArray, courses: FloatArray) -> FloatArray:
    """Return (n, 3, 5 n_joints + 3 m) the deflections by effects of unit size.

    They are joint springs, springs about the axes of every joint's frame, the joints' lost motion,
    and offsets with the `courses` (n, m). Lost motion goes with the arctangent of a joint's torque
    over its `knee` (n_joints,) [N m], from the torque of the arm's own weight on.
    """
    poses, jacobian = data.robot.forward(data.q), data.jacobian
    axes = poses.rotations.swapaxes(2, 3).reshape(len(jacobian), -1, 3)
    levers = np.repeat(poses.points[:, -1:] - poses.points[:, :-1], 3, axis=1)
    tilts = np.concatenate([np.cross(axes, levers), axes], axis=2).swapaxes(1, 2)
    wrench = np.hstack([data.force, data.torque])
    weight = data.robot.gravity_torque(data.q)
    load = (wrench[:, None] @ jacobian)[:, 0]
    lost = np.arctan((weight + load) / knee) - np.arctan(weight / knee)
    offsets = courses[:, None, :, None] * np.eye(3)[:, None]  # (n, 3, m, 3)
    parts = data.regressor(), unit_deflections(tilts, wrench), jacobian[:, :3] * lost[:, None]
    return np.concatenate([*parts, offsets.reshape(len(jacobian), 3, -1)], axis=2)


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
