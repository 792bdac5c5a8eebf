"""Choose the samples that inform a model most: optimal designs.

Two kinds of model predict the variance of a deflection before it is measured. Joint springs use the
information matrix of the samples (V. Fedorov, Theory of Optimal Experiments, 1972). A Gaussian
process uses its posterior covariance. For both, an I-optimal design minimizes the mean variance of
predictions over a workspace (for a process: J. Sacks, W. Welch, T. Mitchell and H. Wynn, Design and
Analysis of Computer Experiments, 1989). Candidates are chosen one by one. Therefore the first k
choices are also the choice of k candidates.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from stiff_datasets.measured.identifiability import DEFLECTION_NOISE, TOLERANCE
from stiff_datasets.measured.query_file import Loads
from stiff_datasets.measured.sample_columns import Criterion
from stiff_protocols.contract.progress import report
from stiff_protocols.contract.stiffness_model import StiffnessModel
from stiff_protocols.contract.types import FloatArray, IntArray

_BLOCK = 256
"""Number of candidates whose variances are computed together."""

_START = 1e-6
"""Information on every joint before any sample, as a share of the information of a mean candidate.
It gives the determinant a value from the first choice on, and hardly changes it later."""


def _determinant_gain(rows: FloatArray, information: FloatArray, _: FloatArray) -> FloatArray:
    """Return the factor by which each candidate raises the determinant of the information.

    By the matrix determinant lemma: det(M + B^T B) = det(M) det(I + B M^-1 B^T).
    """
    spread = rows @ np.linalg.inv(information) @ rows.transpose(0, 2, 1)
    return np.asarray(np.linalg.det(np.eye(rows.shape[1]) + spread))


def _prediction_gain(
    rows: FloatArray, information: FloatArray, workspace_information: FloatArray
) -> FloatArray:
    """Return the decrease of the predictions' summed variance by each candidate.

    The variance of a prediction with rows X is proportional to the trace of X M^-1 X^T. Its
    decrease follows from the Woodbury identity.
    """
    whitened = rows @ np.linalg.inv(information)
    sample_spread = whitened @ rows.transpose(0, 2, 1)
    lowered = whitened @ workspace_information @ whitened.transpose(0, 2, 1)
    return np.asarray(
        np.trace(np.linalg.solve(np.eye(rows.shape[1]) + sample_spread, lowered), axis1=1, axis2=2)
    )


_GAINS: dict[Criterion, Callable[[FloatArray, FloatArray, FloatArray], FloatArray]] = {
    "d-optimal": _determinant_gain,
    "i-optimal": _prediction_gain,
}
"""Function of the candidates' rows B (n, 3, k), the information M (k, k) of all earlier samples and
the workspace's information; it returns (n,) gains, the largest is the best."""


@dataclass(frozen=True, eq=False)
class SpringDesign:
    """Design for one spring per joint, the linear virtual joint model.

    Attributes:
        candidates: (n, m, n_joints) regressors of m numbers each: 3 for deflections.
        criterion: "d-optimal" (largest determinant of the information matrix) or "i-optimal"
            (smallest mean variance of predictions).
        workspace: (m, 3, n_joints) regressors of the predictions to improve; None: the candidates.
        measured: (k, 3, n_joints) regressors of the existing samples; None: no samples.
        noise: variance [m²] of a measured deflection about its prediction, mean over the axes.
    """

    candidates: FloatArray
    criterion: Criterion
    workspace: FloatArray | None = None
    measured: FloatArray | None = None
    noise: float = DEFLECTION_NOISE**2

    @property
    def fewest(self) -> int:
        """Least number of choices: each sample has m components, all joints must be excited."""
        _, m, n_joints = self.candidates.shape
        return 1 if self.measured is not None else -(-n_joints // m)

    def choose(self, n: int) -> IntArray:
        """Return (n,) row numbers of candidates, the most informative first.

        Joints that no candidate excites are omitted. Scaling a column does not change the result.
        """
        rows, information, workspace_information = self._scaled
        information = information + _START * np.eye(len(information))
        chosen, is_free = list[np.intp](), np.ones(len(rows), dtype=bool)
        for step in range(n):
            report("choose", step, n)
            gain = _GAINS[self.criterion](rows, information, workspace_information)
            best = np.argmax(np.where(is_free, gain, -np.inf))
            is_free[best] = False
            information += rows[best].T @ rows[best]
            chosen.append(best)
        return np.array(chosen, dtype=np.int64)

    def variance(self, rows: IntArray) -> float:
        """Return the mean variance [m²] of a prediction after measuring these candidates.

        It is the mean over workspace and axes, without noise; infinite if a joint is not
        identified.
        """
        excited, measured_information, workspace_information = self._scaled
        chosen_rows = excited[rows].reshape(-1, excited.shape[2])
        information = measured_information + chosen_rows.T @ chosen_rows
        eigenvalues = np.linalg.eigvalsh(information)
        if not eigenvalues[0] > TOLERANCE * eigenvalues[-1]:
            return np.inf
        spread = np.trace(np.linalg.solve(information, workspace_information))
        workspace = self.candidates if self.workspace is None else self.workspace
        return float(self.noise * spread / (workspace.shape[1] * len(workspace)))

    @cached_property
    def _scaled(self) -> tuple[FloatArray, FloatArray, FloatArray]:
        """Nonzero columns of the candidates, scaled to unit mean square, and information matrices.

        The matrices belong to all measured rows and to all workspace rows, with the same columns.
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
    """Design for a model with a covariance of deflections, such as a Gaussian process.

    Attributes:
        model: model fitted to the existing samples; its hyperparameters are taken as known.
        candidates: loads at poses to choose from.
        workspace: loads at poses of the predictions to improve.
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
        """Return (n,) row numbers of candidates; each lowers the mean variance most.

        A sample of variance v + noise lowers every covariance C(a, b) by C(a, sample) C(sample, b)
        / (v + noise).
        """
        all_rows = np.arange(len(self.candidates.q))
        noise = self.model.noise_variance()[:, None]  # (3, 1)
        parts = np.array_split(all_rows, -(-len(all_rows) // _BLOCK))
        blocks = [np.diagonal(self._between(part, part), axis1=1, axis2=2) for part in parts]
        variance = np.concatenate(blocks, axis=1)  # (3, n_candidates)
        shared = self._shared  # (3, m, n_candidates)
        lowered = np.empty((0, 3, len(all_rows)))  # scaled covariances of each choice
        is_free = np.ones(len(all_rows), dtype=bool)
        chosen = np.empty(n, dtype=np.int64)
        for step in range(n):
            report("choose", step, n)
            gain = ((shared**2).sum(axis=1) / (variance + noise)).sum(axis=0)
            chosen[step] = best = np.argmax(np.where(is_free, gain, -np.inf))
            is_free[best] = False
            size = np.sqrt(variance[:, [best]] + noise)
            candidate_covariance = self._between(all_rows, all_rows[[best]])[:, :, 0]
            candidate_covariance = (
                candidate_covariance - (lowered[:, :, [best]] * lowered).sum(axis=0)
            ) / size
            workspace_covariance = shared[:, :, [best]] / size[:, :, None]
            shared = shared - workspace_covariance * candidate_covariance[:, None]
            variance = np.maximum(variance - candidate_covariance**2, 0.0)
            lowered = np.concatenate([lowered, candidate_covariance[None]])
        return chosen

    def variance(self, rows: IntArray) -> float:
        """Return the mean variance of a prediction, m²; see `SpringDesign.variance`."""
        if not len(rows):
            return self._before
        sample_covariance = self._between(rows, rows) + (
            self.model.noise_variance()[:, None, None] * np.eye(len(rows))
        )
        shared = self._shared[:, :, rows]
        lowered = shared.transpose(0, 2, 1) * np.linalg.solve(
            sample_covariance, shared.transpose(0, 2, 1)
        )
        return max(self._before - float(lowered.sum(axis=1).mean()), 0.0)

    @cached_property
    def _shared(self) -> FloatArray:
        """Covariance (3, m, n_candidates) of workspace and candidates, m²."""
        workspace, candidates = self.workspace, self.candidates
        return self.model.covariance(workspace.q, workspace.wrench, candidates.q, candidates.wrench)

    @cached_property
    def _before(self) -> float:
        """Mean variance over the workspace without new samples, m²."""
        workspace = self.workspace
        covariance = self.model.covariance(
            workspace.q, workspace.wrench, workspace.q, workspace.wrench
        )
        return float(np.diagonal(covariance, axis1=1, axis2=2).mean())

    def _between(self, rows: IntArray, other_rows: IntArray) -> FloatArray:
        q, wrench = self.candidates.q, self.candidates.wrench
        return self.model.covariance(q[rows], wrench[rows], q[other_rows], wrench[other_rows])


Design = SpringDesign | ProcessDesign
"""Chooses candidates and computes the variance that they leave."""
