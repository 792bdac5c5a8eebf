"""Find outliers, and changes during the measurement, by springs fitted to the other rows.

`lines` is the (n,) row number of every sample in its file.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np

from stiff_datasets.measured.anomalies import (
    NOISE_MM,
    OUTLIER_DEVIATIONS,
    Finding,
    median_and_deviation,
    warning,
)
from stiff_datasets.measured.fault_hypotheses import Reading, compliances, normal_equations
from stiff_datasets.measured.sample_columns import DEFLECTION_COLUMNS, MM_PER_M
from stiff_protocols.contract.types import BoolArray, FloatArray, IntArray
from stiff_protocols.kinematics.serial_chain import unit_deflections
from stiff_protocols.springs.identification import RANK_TOLERANCE

GROSS_DEVIATIONS = 12.0
"""Robust standard deviations above the median at which an error is an outlier. In clean data of
the shipped twins, the arms and the FANUC the largest was 9; with 12 random poses it was 12."""
MODEL_ERROR = 0.7
"""Largest relative prediction error of a correct reading. The largest in the FANUC measurement is
0.55, in shipped twins and arms 0.35. A reading of the wrong sign has an error of 2, a reading with
the decimal point misplaced to the right an error of 9."""
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
"""Share of a joint's largest torque that takes up its lost motion."""
RIDGE = 0.1
"""Weight of the prior in observations; the prior has unit coefficients of columns of unit size. It
determines only what the samples leave open."""
MIN_CHANGE_F, CHANGE_GAIN = 16.0, 0.05
"""Least F statistic of a drift or a jump, and least share by which it lowers the RMS error of rows
left out. Of clean data with such a gain, from 20 poses on, the largest F was 12."""
MIN_ROWS_FOR_CHANGE, MIN_ROWS_BESIDE_JUMP = 20, 5
"""Rows."""
MIN_ROWS_FOR_OUTLIERS = 10
MAX_OUTLIERS = 0.2
"""Share of the rows; if more are outliers, something is wrong with all rows."""
MAX_LISTED = 10
"""Largest number of outliers in a list."""


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
        for row in rows[:MAX_LISTED]
    )
    more = f", and {len(rows) - MAX_LISTED} more rows" if len(rows) > MAX_LISTED else ""
    yield warning(
        "deflection far from what springs fitted to the other rows predict (half of the rows are "
        f"within {np.median(error_mm):.2g} mm): {listed}{more}",
        lines[rows],
    )


@dataclass(frozen=True, eq=False)
class Outliers:
    """Outliers: rows whose deflection the other rows do not predict.

    Attributes:
        error_mm: (n,) distance of each deflection from its prediction, mm.
        odd: (n,) true if a row is an outlier.
        slips: outlier -> slip of the pen that explains its deflection.
    """

    error_mm: FloatArray
    odd: BoolArray
    slips: dict[int, str]


def find_outliers(data: Reading) -> Outliers:
    """Find the rows that springs fitted to the other rows do not predict.

    The springs are described in `effects`. An error is divided by its standard error, relative to
    the noise, and by the size of the deflection, because a model's error grows with the load. A row
    is an outlier if this share lies `GROSS_DEVIATIONS` robust standard deviations above the median.
    The share must also exceed `MODEL_ERROR`, or one of `SLIPS` must leave a usual share.

    The springs are first fitted without the fifth of the rows that joint springs explain worst.
    Then they are fitted without the outliers until the outliers stay the same. So a gross outlier
    does not hide others.
    """
    n = len(data.q)
    given_mm = data.deflection * MM_PER_M
    residual_mm = np.linalg.norm(given_mm - data.regressor() @ compliances(data) * MM_PER_M, axis=1)
    odd = residual_mm > np.quantile(residual_mm, 1.0 - MAX_OUTLIERS)
    for _ in range(5):
        fit = left_out(data, ~odd)
        error_mm = fit.error * MM_PER_M  # (n, 3)
        length_mm = np.linalg.norm(error_mm, axis=1)
        size_mm = np.linalg.norm([given_mm, given_mm - error_mm], axis=2).min(axis=0)
        size_mm = np.maximum(size_mm, max(np.median(size_mm), NOISE_MM))  # small ones are noise
        root = np.linalg.inv(np.linalg.cholesky(fit.covariance)) / size_mm[:, None, None]
        share = _lengths(root, error_mm)
        middle, deviation = median_and_deviation(share[~odd])
        usual_share = np.maximum(middle + OUTLIER_DEVIATIONS * deviation, NOISE_MM / size_mm)
        is_far = (share > middle + GROSS_DEVIATIONS * deviation) & (length_mm > NOISE_MM)
        slips = {
            int(row): slip
            for row in np.flatnonzero(is_far)
            if (slip := _slip(given_mm[row], error_mm[row], root[row], usual_share[row]))
        }
        outlier = is_far & (share > MODEL_ERROR)
        outlier[[*slips]] = True
        if n < MIN_ROWS_FOR_OUTLIERS or outlier.sum() > MAX_OUTLIERS * n:
            return Outliers(length_mm, np.zeros(n, dtype=bool), {})
        if (outlier == odd).all():
            break
        odd = outlier
    return Outliers(length_mm, outlier, slips)


def _slip(given: FloatArray, error: FloatArray, root: FloatArray, usual: np.floating) -> str | None:
    """Return the slip of `SLIPS` that leaves a usual error of a deflection (3,); None: no slip.

    A slip does not count if zeros in place of its numbers would leave a usual error, too.
    """
    factors = np.stack([*SLIPS.values()])  # (n_slips, 3)
    zero_deflection = np.where(factors == 1.0, given, 0.0)
    corrected = np.stack([given / factors, zero_deflection])  # (2, n_slips, 3)
    misfit, misfit_of_none = _lengths(root, corrected - given + error)
    misfit = np.where(misfit_of_none > usual, misfit, np.inf)
    likeliest = int(np.argmin(misfit))
    return [*SLIPS][likeliest] if misfit[likeliest] < usual else None


def _lengths(root: FloatArray, vectors: FloatArray) -> FloatArray:
    """Return (n,) lengths of (n, 3) vectors times (n, 3, 3) matrices, or one matrix for all."""
    return np.asarray(np.linalg.norm((root @ vectors[..., None])[..., 0], axis=-1))


@dataclass(frozen=True, eq=False)
class Change:
    """A drift or a jump during the measurement of the rows.

    Attributes:
        text: description in one line.
        rows: row numbers since a jump; () for a drift.
        rms: RMS error of rows that are left out after the change is undone, m.
        offset: (n, 3) deflection that the change added, m.
    """

    text: str
    rows: IntArray | tuple[()]
    rms: float
    offset: FloatArray


def find_change(data: Reading, lines: IntArray, odd: BoolArray) -> Change | None:
    """Find a drift of the deflections over the rows, or a jump at a row.

    The rows, with their numbers `lines`, are in the order of the measurement.
    Each is an offset of the deflections. It is fitted with the springs and lost motions of
    `find_outliers` and a constant offset. It counts if the F statistic of its three numbers
    exceeds `MIN_CHANGE_F` and the RMS error of rows left out falls by `CHANGE_GAIN`. The better of
    the two is returned. The `odd` (n,) outliers are ignored.
    """
    compared = np.flatnonzero(~odd)
    if len(compared) < MIN_ROWS_FOR_CHANGE:
        return None
    part, fitted = data.take(compared), np.ones(len(compared), dtype=bool)
    constant = np.ones(len(lines))
    given = left_out(part, fitted, _offsets(constant[compared, None]))
    place, jump = np.arange(len(lines)), compared[_likeliest_jump(part, given)]
    jumped = f"jumped by {{}} mm at row {lines[jump]} and stayed there"
    drifted = f"drifted by {{}} mm from row {lines[0]} to row {lines[-1]}"
    after = place >= jump
    changes = []
    for what, course, rows in (
        (drifted, place / place[-1], ()),
        (jumped, after.astype(np.float64), lines[after]),
    ):
        fit = left_out(part, fitted, _offsets(np.column_stack([constant, course])[compared]))
        offset = fit.coefficients[-3:] / fit.size[-3:]
        if fit.statistic(offset) > MIN_CHANGE_F and fit.rms < (1.0 - CHANGE_GAIN) * given.rms:
            vector = ", ".join(f"{length:.2g}" for length in offset * MM_PER_M)
            text = (
                f"the deflections look as if they had {what.format(f'({vector})')}; springs fitted "
                f"to the other rows miss a row by {given.rms * MM_PER_M:.3g} mm RMS, and by "
                f"{fit.rms * MM_PER_M:.3g} mm without it (undone below)"
            )
            changes.append(Change(text, rows, fit.rms, course[:, None] * offset))
    return min(changes, key=lambda change: change.rms, default=None)


def left_out_rms(data: Reading, odd: BoolArray) -> float:
    """Return the RMS error [m] of rows left out, without a change and without outliers."""
    usual = data.take(~odd)
    every = np.ones(len(usual.q), dtype=bool)
    return left_out(usual, every, _offsets(np.ones((len(usual.q), 1)))).rms


def _offsets(courses: FloatArray) -> FloatArray:
    """Return the (n, 3, 3 m) deflections by unit offsets with the `courses` (n, m)."""
    return (courses[:, None, :, None] * np.eye(3)[:, None]).reshape(len(courses), 3, -1)


def _likeliest_jump(data: Reading, given: LeftOut) -> int:
    """Return the row from which an offset explains most of the residual of `given`.

    Rows are counted from 0; each side has at least `MIN_ROWS_BESIDE_JUMP`.
    """
    n = len(data.q)
    matrix = np.concatenate([effects(data, given.knee), _offsets(np.ones((n, 1)))], axis=2)
    matrix = matrix / given.size
    residual = data.deflection - matrix @ given.coefficients
    # by cumulative sums from each row to the last
    loads = np.cumsum(matrix[::-1], axis=0)[::-1]  # (n, 3, n_columns)
    residual = np.cumsum(residual[::-1], axis=0)[::-1]  # (n, 3)
    rows = np.arange(n, 0, -1)[:, None, None] * np.eye(3)
    information = (rows - loads @ given.inverse @ loads.swapaxes(1, 2))[1:]
    explained = (residual[1:] * np.linalg.solve(information, residual[1:, :, None])[..., 0]).sum(
        axis=1
    )
    inner = explained[MIN_ROWS_BESIDE_JUMP - 1 : n - MIN_ROWS_BESIDE_JUMP]
    return MIN_ROWS_BESIDE_JUMP + int(np.argmax(inner))


@dataclass(frozen=True, eq=False)
class LeftOut:
    """Errors when each row is predicted by springs fitted to the other rows.

    Attributes:
        error: (n, 3) deflection minus its prediction, m.
        covariance: (n, 3, 3) covariance of the errors, as a multiple of the noise variance.
        coefficients: (n_columns,) coefficients of the columns scaled to unit length.
        inverse: (n_columns, n_columns) covariance of the coefficients, as a multiple.
        size: (n_columns,) length of the columns; infinite for columns without an effect.
        knee: (n_joints,) see `effects`.
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

    def residual(self, data: Reading) -> FloatArray:
        """Return the (n, 3) deflection minus the fitted springs' prediction, m."""
        matrix = effects(data, self.knee)
        k = matrix.shape[2]
        return data.deflection - matrix @ (self.coefficients[:k] / self.size[:k])

    def statistic(self, numbers: FloatArray) -> float:
        """Return the F statistic of (m,) `numbers` as coefficients of the last columns."""
        m = len(numbers)
        size = self.size[-m:]
        scaled = numbers * np.where(np.isfinite(size), size, 0.0)
        information = np.linalg.inv(self.inverse[-m:, -m:])
        return float(scaled @ information @ scaled) * 3.0 / (m * self.rms**2)  # three axes


def left_out(data: Reading, fitted: BoolArray, columns: FloatArray | None = None) -> LeftOut:
    """Predict each row by springs fitted to the other rows.

    Args:
        data: the samples.
        fitted: (n,) true for rows that the springs are fitted to.
        columns: (n, 3, m) deflections by m further effects of unit size.
    """
    load = (np.hstack([data.force, data.torque])[:, None] @ data.jacobian)[:, 0]
    knee = LOST_MOTION * np.abs(load).max(axis=0) + 1e-9  # (n_joints,) N m
    matrix = effects(data, knee)  # (n, 3, n_columns)
    n_springs = matrix.shape[2]
    if columns is not None:
        matrix = np.concatenate([matrix, columns], axis=2)
    gram, right = normal_equations(matrix[fitted], data.deflection[fitted])
    size = np.sqrt(np.diagonal(gram))
    least = np.zeros(len(size))
    least[:n_springs] = RANK_TOLERANCE * size[:n_springs].max()
    size = np.where(size > least, size, np.inf)
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


def effects(data: Reading, knee: FloatArray) -> FloatArray:
    """Return the deflections (n, 3, 5 n_joints) by effects of unit size.

    They are joint springs, springs about the axes of every joint's frame, and the joints' lost
    motion. Lost motion is proportional to the arctangent of a joint's torque over its `knee`
    (n_joints,) [N m], relative to the arm's own weight.
    """
    poses, jacobian = data.robot.forward(data.q), data.jacobian
    axes = poses.rotations.swapaxes(2, 3).reshape(len(jacobian), -1, 3)
    levers = np.repeat(data.tcp[:, None] - poses.points[:, :-1], 3, axis=1)
    tilts = np.concatenate([np.cross(axes, levers), axes], axis=2).swapaxes(1, 2)
    wrench = np.hstack([data.force, data.torque])
    weight = data.robot.gravity_torque(data.q)
    load = (wrench[:, None] @ jacobian)[:, 0]
    lost = np.arctan((weight + load) / knee) - np.arctan(weight / knee)
    parts = data.regressor(), unit_deflections(tilts, wrench), jacobian[:, :3] * lost[:, None]
    return np.concatenate(parts, axis=2)
