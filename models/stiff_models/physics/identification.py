"""Least squares on compliances: what every virtual joint model identifies its springs with.

A deflection that is linear in the compliances is ``target = matrix @ compliance``. The columns of
the matrix differ by orders of magnitude from base to tip, so everything is computed on columns
scaled to unit length.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.optimize import minimize_scalar

from stiff_protocols.contract.errors import ModelError
from stiff_protocols.contract.identification import RANK_TOLERANCE, Solver, nonnegative
from stiff_protocols.contract.types import FloatArray


@dataclass(frozen=True, eq=False)
class Identified:
    """Compliances identified from samples, and what the samples can say of them.

    Attributes:
        compliance: (n_columns,) rad/(N m) or m/N. Of springs that the data cannot tell apart only
            the sum of their effects on the samples means anything.
        known: (n_columns,) whether the data can identify the spring.
        rank: rank of the regressor.
        condition: condition number of the column-scaled regressor over its identifiable part.
    """

    compliance: FloatArray
    known: np.ndarray[tuple[int, ...], np.dtype[np.bool_]]
    rank: int
    condition: float

    @property
    def stiffness(self) -> FloatArray:
        """1 / compliance; infinite for a spring found rigid, NaN where the data cannot tell."""
        with np.errstate(divide="ignore"):
            return np.where(self.known, 1.0 / self.compliance, np.nan)


def ridge(scaled: FloatArray, target: FloatArray) -> FloatArray:
    """Return the ridge solution over the directions that the regressor resolves.

    Its strength minimises the generalised cross-validation criterion (Golub, Heath and Wahba
    1979), between one that shrinks nothing by more than a millionth and one that halves all.
    """
    left, singular, axes = np.linalg.svd(scaled, full_matrices=False)
    kept = singular > RANK_TOLERANCE * singular[0]
    left, squares = left[:, kept], singular[kept] ** 2
    seen = left.T @ target  # the target's part that any spring can explain
    unseen = max(float(target @ target - seen @ seen), 0.0)

    def criterion(log_strength: float) -> float:
        left_over = np.exp(log_strength) / (squares + np.exp(log_strength))
        degrees = len(target) - len(squares) + left_over.sum()
        return float((unseen + ((left_over * seen) ** 2).sum()) / degrees**2)

    grid = np.log(np.geomspace(1e-6 * squares[-1], squares[0], 100))
    best = min(range(len(grid)), key=lambda i: criterion(float(grid[i])))
    around = (grid[max(best - 1, 0)], grid[min(best + 1, len(grid) - 1)])
    strength = np.exp(minimize_scalar(criterion, bounds=around, method="bounded").x)
    return np.asarray(axes[kept].T @ (singular[kept] / (squares + strength) * seen))


def identify(matrix: FloatArray, target: FloatArray, solver: Solver = nonnegative) -> Identified:
    """Identify compliances by least squares.

    Args:
        matrix: (rows, n_columns) deflection by each spring at unit compliance.
        target: (rows,) measured deflection.
        solver: `nonnegative` or `ridge`.

    Raises:
        ModelError: no spring can be identified (for example, every wrench is zero).
    """
    size = np.linalg.norm(matrix, axis=0)
    if not size.any():
        raise ModelError("no joint spring can be identified: no wrench turns any joint")
    turned = size > RANK_TOLERANCE * size.max()  # False: no sample bends this spring
    scaled = matrix[:, turned] / size[turned]
    _, singular, axes = np.linalg.svd(scaled, full_matrices=False)
    kept = singular > RANK_TOLERANCE * singular[0]
    # a spring is identifiable when its unit vector lies in the span of the kept directions
    known = turned.copy()
    known[turned] = (axes[kept] ** 2).sum(axis=0) > 1.0 - 1e-6
    # Springs that the data cannot tell apart stay in: left out, the others would take their share.
    compliance = np.zeros(matrix.shape[1])
    compliance[turned] = solver(scaled, target) / size[turned]
    return Identified(
        compliance=compliance,
        known=known,
        rank=int(kept.sum()),
        condition=float(singular[0] / singular[kept][-1]),
    )
