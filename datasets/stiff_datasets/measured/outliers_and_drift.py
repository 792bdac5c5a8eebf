"""Rows that springs fitted to the other rows do not predict, and changes while rows were measured.

`lines` is the (n,) row number of every sample in its file.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np

from stiff_datasets.measured.mistakes import Reading, compliances, normal_equations
from stiff_datasets.measured.odd_rows import (
    FAR_OFF,
    NOISE_MM,
    Finding,
    middle_and_deviation,
    warning,
)
from stiff_datasets.measured.sample_columns import DEFLECTION_COLUMNS, MM_PER_M
from stiff_protocols.contract.types import BoolArray, FloatArray, IntArray
from stiff_protocols.kinematics.serial_chain import unit_deflections
from stiff_protocols.springs.identification import RANK_TOLERANCE

OUTLIER = 12.0
"""Robust standard deviations above the median from which on an error is an outlier. The most in
clean data of the shipped twins, the arms and the FANUC was 9, and 12 of 12 random poses."""
MODEL_ERROR = 0.7
"""Share of a deflection by which its prediction may miss it where nothing is wrong: the most in
the FANUC measurement is 0.55, in shipped twins and arms 0.35. A reading of the wrong sign misses by
2, one with the decimal point misplaced to the right by 9."""
FACTORS = {"ten times too large": 10.0, "ten times too small": 0.1, "of the opposite sign": -1.0}
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
FEWEST_FOR_CHANGE, FEWEST_BESIDE_JUMP = 20, 5
"""Rows."""
FEWEST_FOR_OUTLIERS = 10
MOST_OUTLIERS = 0.2
"""Share of the rows; if more are far off, something is wrong with all of them."""
LISTED = 10
"""Most outliers that are listed."""


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

    The springs are those of `_effects`. An error is divided by its standard error, relative to the
    noise, and by the size of the deflection, because a model's error grows with the load. A row is
    an outlier if this share lies `OUTLIER` robust standard deviations above the median, and if it
    is more than `MODEL_ERROR` or one of `SLIPS` leaves a usual share. The springs are first fitted
    without the fifth of the rows that joint springs explain worst, then without the outliers until
    they stay the same: a gross outlier does not hide others.
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
        middle, deviation = middle_and_deviation(share[~odd])
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
    compared = np.flatnonzero(~odd)
    if len(compared) < FEWEST_FOR_CHANGE:
        return None
    part, fitted = data.take(compared), np.ones(len(compared), dtype=bool)
    same = np.ones(len(lines))
    given = _left_out(part, fitted, same[compared, None])
    jump = lines[compared[_likeliest_jump(part, given)]]
    first, last = lines[0], lines[-1]
    jumped = f"jumped by {{}} mm at row {jump} and stayed there"
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
    load = (np.hstack([data.force, data.torque])[:, None] @ data.jacobian)[:, 0]
    knee = LOST_MOTION * np.abs(load).max(axis=0) + 1e-9  # (n_joints,) N m
    matrix = _effects(data, knee, courses)  # (n, 3, n_columns)
    gram, right = normal_equations(matrix[fitted], data.deflection[fitted])
    size = np.sqrt(np.diagonal(gram))
    size = np.where(size > RANK_TOLERANCE * size.max(), size, np.inf)
    weight = RIDGE / (3.0 * fitted.sum())
    inverse = np.linalg.inv(gram / np.outer(size, size) + weight * np.eye(len(size)))
    coefficients = inverse @ (right / size)
    matrix = matrix / size
    leverage = matrix @ inverse @ matrix.swapaxes(1, 2)  # (n, 3, 3) share of a row in its own fit
    inside = fitted[:, None, None]
    covariance = np.where(
        inside, np.linalg.inv(np.eye(3) - inside * leverage), np.eye(3) + leverage
    )
    error = (data.deflection - matrix @ coefficients)[..., None]
    error = np.where(inside, covariance @ error, error)[..., 0]
    return LeftOut(error, covariance, coefficients, inverse, size, knee)


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
