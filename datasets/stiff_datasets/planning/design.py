"""What samples tell a model, and which candidates would tell it most: designs.

Two kinds of model say how well a deflection is known before it is measured. Joint springs, by the
information matrix of the samples (V. Fedorov, Theory of Optimal Experiments, 1972). A Gaussian
process, by its posterior covariance. For both an I-optimal design lowers the mean variance of
predictions over a workspace most (for a process: J. Sacks, W. Welch, T. Mitchell and H. Wynn,
Design and Analysis of Computer Experiments, 1989). Candidates are chosen one by one, so the first k
choices are the choice of k.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import cached_property
from typing import Literal

import numpy as np

from stiff_datasets.measured.identifiability import DEFLECTION_NOISE, TOLERANCE
from stiff_datasets.measured.load_file import Loads
from stiff_protocols.contract.progress import report
from stiff_protocols.contract.stiffness_model import StiffnessModel
from stiff_protocols.contract.types import FloatArray, IntArray

Criterion = Literal["d-optimal", "i-optimal"]

_BLOCK = 256
"""Candidates whose variances are computed at once."""

_START = 1e-6
"""Information that a plan without samples has on every joint, as a share of what one mean
candidate gives: a determinant exists from the first choice on and is not changed visibly later."""


def _determinant_gain(rows: FloatArray, information: FloatArray, _: FloatArray) -> FloatArray:
    """Return the factor by which each candidate raises the determinant of the information.

    By the matrix determinant lemma: det(M + B^T B) = det(M) det(I + B M^-1 B^T).
    """
    spread = rows @ np.linalg.inv(information) @ rows.transpose(0, 2, 1)
    return np.asarray(np.linalg.det(np.eye(3) + spread))


def _prediction_gain(rows: FloatArray, information: FloatArray, wanted: FloatArray) -> FloatArray:
    """Return by how much each candidate lowers the predictions' summed variance.

    The variance of a prediction with rows X goes with the trace of X M^-1 X^T; its decrease is by
    the Woodbury identity.
    """
    known = rows @ np.linalg.inv(information)
    spread = known @ rows.transpose(0, 2, 1)
    lowered = known @ wanted @ known.transpose(0, 2, 1)
    return np.asarray(np.trace(np.linalg.solve(np.eye(3) + spread, lowered), axis1=1, axis2=2))


_GAINS: dict[Criterion, Callable[[FloatArray, FloatArray, FloatArray], FloatArray]] = {
    "d-optimal": _determinant_gain,
    "i-optimal": _prediction_gain,
}
"""Of every candidate: its rows B (n, 3, k), the information M (k, k) of all samples before, and
that of the workspace -> (n,), the largest is the best."""


@dataclass(frozen=True, eq=False)
class SpringDesign:
    """Of one spring a joint, the linear virtual joint model.

    Attributes:
        candidates: (n, 3, n_joints) regressors.
        criterion: "d-optimal" (largest determinant of the information matrix) or "i-optimal"
            (smallest mean variance of predictions).
        workspace: (m, 3, n_joints) regressors where predictions are to be good; None: the
            candidates.
        measured: (k, 3, n_joints) regressors of the samples that are there; None: none.
        noise: variance [m²] of a measured deflection about its prediction, mean over the axes.
    """

    candidates: FloatArray
    criterion: Criterion
    workspace: FloatArray | None = None
    measured: FloatArray | None = None
    noise: float = DEFLECTION_NOISE**2

    @property
    def fewest(self) -> int:
        """How many are chosen at least: a sample has three components, all joints must show."""
        return 1 if self.measured is not None else -(-self.candidates.shape[2] // 3)

    def choose(self, n: int) -> IntArray:
        """Return (n,) row numbers of candidates, the one that tells most first.

        Joints that no candidate excites are left out; scaling a column changes nothing.
        """
        rows, information, wanted = self._scaled
        information = information + _START * np.eye(len(information))
        chosen, free = list[np.intp](), np.ones(len(rows), dtype=bool)
        for step in range(n):
            report("choose", step, n)
            gain = _GAINS[self.criterion](rows, information, wanted)
            best = np.argmax(np.where(free, gain, -np.inf))
            free[best] = False
            information += rows[best].T @ rows[best]
            chosen.append(best)
        return np.array(chosen, dtype=np.int64)

    def variance(self, rows: IntArray) -> float:
        """Return the mean variance [m²] of a prediction once these candidates are measured.

        Mean over workspace and axes, without noise; infinite where something is not identified.
        """
        excited, known, wanted = self._scaled
        gained = excited[rows].reshape(-1, excited.shape[2])
        information = known + gained.T @ gained
        eigenvalues = np.linalg.eigvalsh(information)
        if not eigenvalues[0] > TOLERANCE * eigenvalues[-1]:
            return np.inf
        spread = np.trace(np.linalg.solve(information, wanted))
        workspace = self.candidates if self.workspace is None else self.workspace
        return float(self.noise * spread / (3 * len(workspace)))

    @cached_property
    def _scaled(self) -> tuple[FloatArray, FloatArray, FloatArray]:
        """The candidates' columns that are not next to zero, each of unit mean square.

        And the information matrices, of the same columns, of all measured and of all workspace
        rows.
        """
        size = np.sqrt((self.candidates**2).sum(axis=1).mean(axis=0))
        excited = size > TOLERANCE * size.max()
        scale = size[excited]

        def information(rows: FloatArray) -> FloatArray:
            matrix = rows[:, :, excited].reshape(-1, len(scale)) / scale
            return np.asarray(matrix.T @ matrix)

        measured = self.candidates[:0] if self.measured is None else self.measured
        workspace = self.candidates if self.workspace is None else self.workspace
        rows = self.candidates[:, :, excited] / scale
        return rows, information(measured), information(workspace)


@dataclass(frozen=True, eq=False)
class ProcessDesign:
    """Of a model that says how unknown deflections go together, such as a Gaussian process.

    Attributes:
        model: fitted to the samples that are there; its hyperparameters count as known.
        candidates: to choose from.
        workspace: where predictions are to be good.
    """

    model: StiffnessModel
    candidates: Loads
    workspace: Loads

    criterion: Criterion = "i-optimal"
    fewest = 1

    @property
    def noise(self) -> float:
        """Variance of a measured deflection's own error, m², mean over the axes."""
        return float(self.model.noise_variance().mean())

    def choose(self, n: int) -> IntArray:
        """Return (n,) row numbers of candidates, each the one that lowers the mean variance most.

        A sample of variance v + noise lowers every covariance C(a, b) by C(a, sample) C(sample, b)
        over that.
        """
        every = np.arange(len(self.candidates.q))
        noise = self.model.noise_variance()[:, None]  # (3, 1)
        parts = np.array_split(every, -(-len(every) // _BLOCK))
        blocks = [np.diagonal(self._between(part, part), axis1=1, axis2=2) for part in parts]
        own = np.concatenate(blocks, axis=1)  # (3, n_candidates), their variances
        shared = self._shared  # (3, m, n_candidates)
        lowered = np.empty((0, 3, len(every)))  # by each choice so far: its covariances, scaled
        free = np.ones(len(every), dtype=bool)
        chosen = np.empty(n, dtype=np.int64)
        for step in range(n):
            report("choose", step, n)
            gain = ((shared**2).sum(axis=1) / (own + noise)).sum(axis=0)
            chosen[step] = best = np.argmax(np.where(free, gain, -np.inf))
            free[best] = False
            size = np.sqrt(own[:, [best]] + noise)
            here = self._between(every, every[[best]])[:, :, 0]
            here = (here - (lowered[:, :, [best]] * lowered).sum(axis=0)) / size
            there = shared[:, :, [best]] / size[:, :, None]
            shared = shared - there * here[:, None]
            own = np.maximum(own - here**2, 0.0)
            lowered = np.concatenate([lowered, here[None]])
        return chosen

    def variance(self, rows: IntArray) -> float:
        """Return the mean variance of a prediction, m², as `SpringDesign.variance`."""
        if not len(rows):
            return self._before
        known = self._between(rows, rows) + (
            self.model.noise_variance()[:, None, None] * np.eye(len(rows))
        )
        shared = self._shared[:, :, rows]
        lowered = shared.transpose(0, 2, 1) * np.linalg.solve(known, shared.transpose(0, 2, 1))
        return max(self._before - float(lowered.sum(axis=1).mean()), 0.0)

    @cached_property
    def _shared(self) -> FloatArray:
        """Covariance (3, m, n_candidates) of workspace and candidates, m²."""
        wanted, other = self.workspace, self.candidates
        return self.model.covariance(wanted.q, wanted.wrench, other.q, other.wrench)

    @cached_property
    def _before(self) -> float:
        """Mean variance over the workspace as it is, m²."""
        at = self.workspace
        own = self.model.covariance(at.q, at.wrench, at.q, at.wrench)
        return float(np.diagonal(own, axis1=1, axis2=2).mean())

    def _between(self, rows: IntArray, others: IntArray) -> FloatArray:
        q, wrench = self.candidates.q, self.candidates.wrench
        return self.model.covariance(q[rows], wrench[rows], q[others], wrench[others])


Design = SpringDesign | ProcessDesign
"""Chooses among candidates, and says what they tell."""
