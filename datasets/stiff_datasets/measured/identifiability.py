"""How well samples identify each joint's compliance, and which of many candidates do best.

The linear virtual joint model, with the Jacobian J at the tool centre point (TCP) and its
translational rows J_v: deflection = sum_i J_v,i (J_i^T w) c_i, linear in the compliances c_i. The
optimal designs are those of linear least squares (V. Fedorov, Theory of Optimal Experiments,
1972).
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np

from stiff_protocols.contract.errors import DataError
from stiff_protocols.contract.progress import report
from stiff_protocols.contract.types import FloatArray, IntArray, Robot, frozen_array

TOLERANCE = 1e-6
"""A joint that moves the TCP less than this share of what the strongest joint does is not
excited: the share goes with the square of the lever, so this is 1 mm beside 1 m. Also the share
of the largest singular value, columns scaled, below which joints cannot be told apart."""

DEFLECTION_NOISE = np.sqrt(2.0) * 1e-5
"""m, standard deviation an axis: a tracker that repeats 0.01 mm, read with and without load."""

REFERENCE_COMPLIANCE = 1.0 / 5e4
"""rad/(N m); assumption, the order of the KR10's A1 to A3. Wrists are softer."""

_START = 1e-6
"""Information that a plan without samples has on every joint, as a share of what one mean
candidate gives: a determinant exists from the first choice on and is not changed visibly later."""


@dataclass(frozen=True, eq=False)
class Identifiability:
    """What samples tell of each joint's compliance.

    Attributes:
        names: joint names, base to tip.
        rank: rank of the regressor.
        condition: condition number of the regressor with columns scaled to unit length; infinite
            where a joint cannot be identified.
        log_det: natural logarithm of the determinant of the information matrix of the *relative*
            compliances c_i / c_ref,i, which has no unit; -inf where a joint cannot be identified.
            The scale is the same for all samples: scaled by the plan's own columns it would not
            see how strongly a plan excites the joints. Between two plans of one robot the
            difference depends neither on the reference nor on the noise.
        relative_standard_error: (n_joints,) standard error of the least squares compliance over
            c_ref,i; infinite where it cannot be identified. It is proportional to the noise and
            to 1 / c_ref,i.
        unidentifiable: names of the joints that are hardly excited, or that the samples cannot
            tell from other joints.
    """

    names: tuple[str, ...]
    rank: int
    condition: float
    log_det: float
    relative_standard_error: FloatArray
    unidentifiable: tuple[str, ...]


def regressor(robot: Robot, q: FloatArray, wrench: FloatArray) -> FloatArray:
    """Return the deflection by each joint at unit compliance.

    Args:
        robot: that is measured.
        q: (n, n_joints) joint positions, rad or m.
        wrench: (n, 6) load at the TCP, force [N] then torque [N m], base frame.

    Returns:
        (n, 3, n_joints), m per rad/(N m) (m per m/N for prismatic joints), base frame.

    Raises:
        DataError: an array has another shape, or an entry is not finite.
    """
    q = frozen_array(q, "q", (None, robot.n_joints))
    return unit_deflections(robot.jacobian(q), frozen_array(wrench, "wrench", (len(q), 6)))


def unit_deflections(jacobian: FloatArray, wrench: FloatArray) -> FloatArray:
    """Return the deflections of `regressor` by (n, 6, n_joints) Jacobians, translation first."""
    return np.asarray(jacobian[:, :3] * (wrench[:, None] @ jacobian))


def identifiability(
    regressors: FloatArray,
    joint_names: Sequence[str],
    *,
    reference_compliance: float | FloatArray = REFERENCE_COMPLIANCE,
    deflection_noise: float = DEFLECTION_NOISE,
) -> Identifiability:
    """Say how well samples identify each joint by linear least squares.

    Args:
        regressors: (n, 3, n_joints), as `regressor` gives.
        joint_names: base to tip.
        reference_compliance: that errors are relative to, rad/(N m) (m/N for prismatic joints); one
            for all joints or (n_joints,).
        deflection_noise: standard deviation of a measured deflection an axis, m.

    Raises:
        DataError: the shapes do not fit, or reference or noise is not above zero.
    """
    names = tuple(joint_names)
    regressors = frozen_array(regressors, "regressors", (None, 3, len(names)))
    reference = per_joint(reference_compliance, len(names))
    if not (np.isfinite(deflection_noise) and deflection_noise > 0.0):
        raise DataError(f"deflection_noise is {deflection_noise:g}, expected m above 0")
    matrix = regressors.reshape(-1, len(names))
    size = np.linalg.norm(matrix, axis=0)
    excited = size > TOLERANCE * size.max()
    _, singular, axes = np.linalg.svd(matrix[:, excited] / size[excited], full_matrices=False)
    kept = singular > TOLERANCE * singular.max(initial=0.0)
    # a joint is identifiable when its unit vector lies in the span of the kept directions
    known = excited.copy()
    known[excited] = (axes[kept] ** 2).sum(axis=0) > 1.0 - 1e-6
    variance = np.full(len(names), np.inf)  # of compliance times column length, at unit noise
    variance[excited] = ((axes[kept] / singular[kept, None]) ** 2).sum(axis=0)
    signal = size * reference / deflection_noise  # length of each column, relative compliance
    error = np.full(len(names), np.inf)
    error[known] = np.sqrt(variance[known]) / signal[known]
    condition, log_det = np.inf, -np.inf
    if known.all():
        condition = singular[0] / singular[-1]
        log_det = 2.0 * (np.log(singular).sum() + np.log(signal).sum())
    return Identifiability(
        names=names,
        rank=int(kept.sum()),
        condition=float(condition),
        log_det=float(log_det),
        relative_standard_error=error,
        unidentifiable=tuple(n for n, is_known in zip(names, known, strict=True) if not is_known),
    )


def choose_d_optimal(
    candidates: FloatArray, n: int, *, measured: FloatArray | None = None
) -> IntArray:
    """Choose candidates one by one, each the one that raises the determinant most.

    The first k choices are the choice of k. A candidate's effect on the determinant is exact, by
    the matrix determinant lemma: det(M + B^T B) = det(M) det(I + B M^-1 B^T), B its three rows.
    Joints that no candidate excites are left out; scaling a column changes nothing.

    Args:
        candidates: (n_candidates, 3, n_joints), as `regressor` gives.
        n: how many, at most n_candidates.
        measured: (n_measured, 3, n_joints) regressors of samples that are there already; None:
            none.

    Returns:
        (n,) row numbers in the order of choice; of equals the first.
    """
    rows, information = excited_columns(candidates, measured)

    def gain(information: FloatArray) -> FloatArray:
        spread = rows @ np.linalg.inv(information) @ rows.transpose(0, 2, 1)
        return np.asarray(np.linalg.det(np.eye(3) + spread))

    return _one_by_one(rows, n, _regularised(information), gain)


def choose_i_optimal(
    candidates: FloatArray,
    n: int,
    *,
    workspace: FloatArray,
    measured: FloatArray | None = None,
) -> IntArray:
    """Choose candidates one by one, each the one that lowers the mean variance of predictions most.

    The variance of a prediction with rows X goes with the trace of X M^-1 X^T, M the information
    matrix. Its decrease by a candidate is exact, by the Woodbury identity. Also called V- or
    IV-optimal. `workspace` are (m, 3, n_joints) regressors where predictions are to be good; the
    other arguments and the return value are those of `choose_d_optimal`.
    """
    rows, information, wanted = excited_columns(candidates, measured, workspace)

    def gain(information: FloatArray) -> FloatArray:
        known = rows @ np.linalg.inv(information)
        spread = known @ rows.transpose(0, 2, 1)
        lowered = known @ wanted @ known.transpose(0, 2, 1)
        traces = np.trace(np.linalg.solve(np.eye(3) + spread, lowered), axis1=1, axis2=2)
        return np.asarray(traces)

    return _one_by_one(rows, n, _regularised(information), gain)


def choose_by_condition(
    candidates: FloatArray, n: int, *, measured: FloatArray | None = None
) -> IntArray:
    """Choose candidates one by one, each the one that leaves the smallest condition number.

    The condition number is that of `Identifiability`: columns scaled to unit length. Where it is
    infinite at first, the first choices, one a joint that cannot be identified, are those of
    `choose_d_optimal`. Arguments and return value as there.

    A warning: this evens the joints out by weakly loaded poses, so that the standard errors grow.
    """
    rows, information = excited_columns(candidates, measured)
    missing = rows.shape[2] - int(np.linalg.matrix_rank(information, TOLERANCE, hermitian=True))
    first = choose_d_optimal(candidates, min(n, missing), measured=measured)
    added = rows.transpose(0, 2, 1) @ rows  # (n_candidates, n_joints, n_joints)

    def gain(information: FloatArray) -> FloatArray:
        trial = information + added
        size = np.sqrt(np.diagonal(trial, axis1=1, axis2=2))
        eigenvalues = np.linalg.eigvalsh(trial / (size[:, :, None] * size[:, None, :]))
        # the floor: joints that no candidate can tell apart leave nothing but rounding
        return -eigenvalues[:, -1] / np.maximum(eigenvalues[:, 0], TOLERANCE**2)

    return _one_by_one(rows, n, information, gain, first)


def _regularised(information: FloatArray) -> FloatArray:
    return information + _START * np.eye(len(information))


def _one_by_one(
    rows: FloatArray,
    n: int,
    information: FloatArray,
    gain: Callable[[FloatArray], FloatArray],
    first: Sequence[int] | IntArray = (),
) -> IntArray:
    """Choose (n,) of (n_candidates, 3, n_columns) rows: `first`, then each of the largest gain.

    `gain` gives that of every candidate, from the information of all chosen before.
    """
    chosen, free = list(first), np.ones(len(rows), dtype=bool)
    free[chosen] = False
    known = rows[chosen].reshape(-1, rows.shape[2])
    information = information + known.T @ known
    for step in range(len(chosen), n):
        report("choose", step, n)
        best = np.argmax(np.where(free, gain(information), -np.inf))
        free[best] = False
        information += rows[best].T @ rows[best]
        chosen.append(best)
    return np.array(chosen, dtype=np.int64)


def excited_columns(candidates: FloatArray, *others: FloatArray | None) -> tuple[FloatArray, ...]:
    """Return the columns that are not next to zero, each of unit mean square over candidates.

    Of the candidates as rows, of each of the others as the information matrix of all its rows.
    """
    size = np.sqrt((candidates**2).sum(axis=1).mean(axis=0))
    excited = size > TOLERANCE * size.max()
    scale = size[excited]
    found = [candidates[:, :, excited] / scale]
    for other in others:
        matrix = np.empty((0, 3, len(size))) if other is None else other
        matrix = matrix[:, :, excited].reshape(-1, len(scale)) / scale
        found.append(matrix.T @ matrix)
    return tuple(found)


def per_joint(compliance: float | FloatArray, n_joints: int) -> FloatArray:
    """Return the reference compliance as (n_joints,) numbers above zero."""
    value = np.asarray(compliance, dtype=np.float64)
    given = frozen_array(
        np.full(n_joints, value) if value.ndim == 0 else value, "reference_compliance", (n_joints,)
    )
    if (given <= 0.0).any():
        raise DataError(f"reference_compliance is {given.min():g}, expected rad/(N m) above 0")
    return given
