"""What samples tell a model, and which candidates would tell it most: designs.

Two kinds of model say how well a deflection is known before it is measured. Joint springs, by the
information matrix of the samples. A Gaussian process, by its posterior covariance. For both an
I-optimal design lowers the mean variance of predictions over a workspace most (for a process:
J. Sacks, W. Welch, T. Mitchell and H. Wynn, Design and Analysis of Computer Experiments, 1989).
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from typing import Literal

import numpy as np

from stiff_datasets.measured.identifiability import (
    DEFLECTION_NOISE,
    TOLERANCE,
    choose_by_condition,
    choose_d_optimal,
    choose_i_optimal,
    excited_columns,
)
from stiff_datasets.measured.load_file import Loads
from stiff_protocols.contract.interfaces import PredictsCovariance
from stiff_protocols.contract.progress import report
from stiff_protocols.contract.types import FloatArray, IntArray

Criterion = Literal["d-optimal", "i-optimal", "condition"]

_BLOCK = 256
"""Candidates whose variances are computed at once."""


@dataclass(frozen=True, eq=False)
class SpringDesign:
    """Of one spring a joint, the linear virtual joint model.

    Attributes:
        candidates: (n, 3, n_joints) regressors.
        criterion: "d-optimal" (largest determinant of the information matrix), "i-optimal"
            (smallest mean variance of predictions) or "condition" (smallest condition number of
            the column-scaled regressor).
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
        """Return (n,) row numbers of candidates, the one that tells most first."""
        if self.criterion == "i-optimal":
            wanted = self._workspace
            return choose_i_optimal(self.candidates, n, workspace=wanted, measured=self.measured)
        choose = choose_d_optimal if self.criterion == "d-optimal" else choose_by_condition
        return choose(self.candidates, n, measured=self.measured)

    def variance(self, rows: IntArray) -> float:
        """Return the mean variance [m²] of a prediction once these candidates are measured.

        Mean over workspace and axes, without noise; infinite where something is not identified.
        """
        excited, known, wanted = excited_columns(self.candidates, self.measured, self._workspace)
        gained = excited[rows].reshape(-1, excited.shape[2])
        information = known + gained.T @ gained
        eigenvalues = np.linalg.eigvalsh(information)
        if not eigenvalues[0] > TOLERANCE * eigenvalues[-1]:
            return np.inf
        spread = np.trace(np.linalg.solve(information, wanted))
        return float(self.noise * spread / (3 * len(self._workspace)))

    @property
    def _workspace(self) -> FloatArray:
        return self.candidates if self.workspace is None else self.workspace


@dataclass(frozen=True, eq=False)
class ProcessDesign:
    """Of a model that says how unknown deflections go together, such as a Gaussian process.

    Attributes:
        model: fitted to the samples that are there; its hyperparameters count as known.
        candidates: to choose from.
        workspace: where predictions are to be good.
    """

    model: PredictsCovariance
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
        over that. The covariances C(workspace, candidates) are not computed anew: of them only the
        sums of squares over the workspace are needed.
        """
        every = np.arange(len(self.candidates.q))
        noise = self.model.noise_variance()[:, None]  # (3, 1)
        parts = np.array_split(every, -(-len(every) // _BLOCK))
        blocks = [np.diagonal(self._between(part, part), axis1=1, axis2=2) for part in parts]
        own = np.concatenate(blocks, axis=1)  # (3, n_candidates), their variances
        squares = np.einsum("amn,amn->an", self._shared, self._shared)
        below = np.empty((0, 3, len(self.workspace.q)))  # of each choice so far
        beside = np.empty((0, 3, len(every)))
        free = np.ones(len(every), dtype=bool)
        chosen = np.empty(n, dtype=np.int64)
        for step in range(n):
            report("choose", step, n)
            gain = (squares / (own + noise)).sum(axis=0)
            chosen[step] = best = np.argmax(np.where(free, gain, -np.inf))
            free[best] = False
            size = np.sqrt(own[:, [best]] + noise)
            at_best = beside[:, :, [best]]
            there = (self._shared[:, :, best] - (at_best * below).sum(axis=0)) / size
            here = self._between(every, every[[best]])[:, :, 0]
            here = (here - (at_best * beside).sum(axis=0)) / size
            together = np.einsum("amn,am->an", self._shared, there)
            together -= np.einsum("kan,kam,am->an", beside, below, there, optimize=True)
            squares += here**2 * (there**2).sum(axis=1, keepdims=True) - 2.0 * here * together
            own = np.maximum(own - here**2, 0.0)
            below = np.concatenate([below, there[None]])
            beside = np.concatenate([beside, here[None]])
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
