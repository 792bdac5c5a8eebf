"""`tradaboost`: two-stage TrAdaBoost.R2, boosting of simulated and measured samples together.

Pardoe and Stone, "Boosting for Regression Transfer", ICML 2010. The weight of the simulated samples
falls step by step, fastest for the worst predicted samples. The last step uses only the measured
samples. In each step AdaBoost.R2 (Drucker 1997) learns with these weights; the source's weights are
constant within a step. Cross-validation on the measured samples chooses the best step.

Differences here: learners use weights instead of drawn samples; the cross-validation uses the mean
absolute error; all rows of a pose are in one fold.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from typing import Annotated, Any, Literal, NamedTuple

import numpy as np
from annotated_types import Ge
from scipy.optimize import brentq
from sklearn.base import clone
from sklearn.kernel_ridge import KernelRidge
from sklearn.model_selection import GroupKFold
from sklearn.tree import DecisionTreeRegressor

from stiff_models.networks.encoded_model import EncodedModel
from stiff_models.transfer.source_domain import PoseDesign, WrenchDesign
from stiff_models.transfer.source_model import SourceModel
from stiff_protocols.contract.types import AXES, FloatArray, IntArray, Robot, Samples, TextArray

LARGEST_EXPONENT = 1e6  # -log of the smallest beta
ERROR_MARGIN = 1e-12  # keeps AdaBoost.R2's error above 0 (perfect) and below 1/2 (useless)
TREE_DEPTH = 6
KERNEL_GAMMA = 1 / 3  # times the number of standardised features
RIDGE = 1e-4


@dataclass(frozen=True, eq=False)
class Boosted:
    """Fitted learners and their weights in the weighted median, (n_learners,)."""

    learners: tuple[Any, ...]
    weights: FloatArray

    def predict(self, inputs: FloatArray) -> FloatArray:
        """Return the (n,) weighted medians of the learners' predictions."""
        predicted = np.stack([learner.predict(inputs) for learner in self.learners], axis=1)
        order = np.argsort(predicted, axis=1)
        below = np.cumsum(self.weights[order], axis=1)
        median = (below >= 0.5 * below[:, -1:]).argmax(axis=1)
        rows = np.arange(len(inputs))
        return np.asarray(predicted[rows, order[rows, median]])


@dataclass(frozen=True, eq=False)
class Domains:
    """Samples of both domains: `inputs` (n, n_features), `outputs` (n,), source first."""

    inputs: FloatArray
    outputs: FloatArray
    n_source: int

    def __len__(self) -> int:
        """Return the number of rows."""
        return len(self.inputs)

    def take(self, chosen: IntArray) -> Domains:
        """Return these rows; all source rows must come first."""
        return Domains(self.inputs[chosen], self.outputs[chosen], self.n_source)


class Reweighting(NamedTuple):
    """Weights of the rows (n,) with the sum 1, and their error by `cross_validated`."""

    weights: FloatArray
    error: float


def adaboost_r2(learner: Any, rows: Domains, weights: FloatArray, rounds: int) -> Boosted:
    """Boost a learner `rounds` times, or until its weighted error is 1/2 or zero.

    The weights (n,) of the source's rows are constant, and so is the sum of the target's weights.
    """
    source, total = rows.n_source, weights[rows.n_source :].sum()
    learners: list[Any] = []
    votes: list[float] = []
    for _ in range(rounds):
        fitted = learned(learner, rows, weights)
        errors = relative_errors(fitted, rows)
        error = float(weights @ errors)
        if error >= 0.5 and learners:
            break
        bounded = float(np.clip(error, ERROR_MARGIN, 0.5 - ERROR_MARGIN))
        beta = bounded / (1.0 - bounded)
        learners.append(fitted)
        votes.append(-np.log(beta))
        if error != bounded:
            break
        raised = weights[source:] * beta ** (1.0 - errors[source:])
        weights = np.concatenate([weights[:source], raised * (total / raised.sum())])
    return Boosted(tuple(learners), np.array(votes))


def learned(learner: Any, rows: Domains, weights: FloatArray) -> Any:
    """Return a copy of the learner, fitted with weights of mean 1.

    Rows without weight are omitted, because a learner may store every row.
    """
    used = weights > 0.0
    shares = weights[used] / weights[used].mean()
    return clone(learner).fit(rows.inputs[used], rows.outputs[used], sample_weight=shares)


def relative_errors(fitted: Any, rows: Domains) -> FloatArray:
    """Return the (n,) absolute errors, divided by the largest of them."""
    errors = np.abs(fitted.predict(rows.inputs) - rows.outputs)
    return np.asarray(errors / (errors.max() or 1.0))


def steps_of(
    learner: Any, rows: Domains, groups: TextArray, *, steps: int, rounds: int, folds: int
) -> Iterator[Reweighting]:
    """Yield the steps of the first stage; no fold divides a group of `groups` (n_target,).

    The target's share of the weight grows evenly, from its share of the rows to 1.
    """
    n_target, n = len(rows) - rows.n_source, len(rows)
    weights = np.full(n, 1.0 / n)
    for number, share in enumerate(np.linspace(n_target / n, 1.0, steps)):
        if number:
            weights = reweighted(learner, rows, weights, share)
        error = cross_validated(learner, rows, weights, groups, rounds=rounds, folds=folds)
        yield Reweighting(weights, error)


def reweighted(learner: Any, rows: Domains, weights: FloatArray, share: float) -> FloatArray:
    """Return (n,) weights in which the target has the larger `share`."""
    errors = relative_errors(learned(learner, rows, weights), rows)
    source_weights, target_weights = np.split(weights, [rows.n_source])
    source_total = target_weights.sum() * (1.0 - share) / share
    changed = np.concatenate(
        [faded(source_weights, errors[: rows.n_source], source_total), target_weights]
    )
    return np.asarray(changed / changed.sum())


def faded(weights: FloatArray, errors: FloatArray, total: float) -> FloatArray:
    """Return (n,) weights times beta^errors, with the beta (0..1) for which their sum is `total`.

    `total` is less than the current sum. If rows without error have a larger sum, the remaining
    weights are scaled.
    """
    if total <= 0.0:
        return np.zeros_like(weights)

    def surplus(exponent: float) -> float:
        return float(weights @ np.exp(-exponent * errors)) - total

    at_bound = surplus(LARGEST_EXPONENT) >= 0.0
    exponent = LARGEST_EXPONENT if at_bound else brentq(surplus, 0.0, LARGEST_EXPONENT)
    remaining = weights * np.exp(-exponent * errors)
    return np.asarray(remaining * (total / remaining.sum()))


def cross_validated(
    learner: Any, rows: Domains, weights: FloatArray, groups: TextArray, *, rounds: int, folds: int
) -> float:
    """Return the mean absolute error on left-out target rows of the boosted learner.

    The target's weights in each training part keep their sum. NaN: there is only one group.
    """
    folds = min(folds, len(np.unique(groups)))
    if folds < 2:
        return np.nan
    source = rows.n_source
    errors = np.empty(len(groups))
    for learned_rows, held_out in GroupKFold(folds).split(groups, groups=groups):
        chosen = np.concatenate([np.arange(source), source + learned_rows])
        share = weights[chosen].copy()
        share[source:] *= weights[source:].sum() / share[source:].sum()
        boosted = adaboost_r2(learner, rows.take(chosen), share, rounds)
        tested = source + held_out
        errors[held_out] = np.abs(boosted.predict(rows.inputs[tested]) - rows.outputs[tested])
    return float(errors.mean())


@dataclass(kw_only=True, eq=False, repr=False)
class TrAdaBoost(SourceModel, EncodedModel):
    """Two-stage TrAdaBoost.R2, one model per axis.

    As with `mf-gp`, the few simulated samples should lie near the measured samples.

    Attributes:
        source_samples: number of simulated samples, drawn at random; at most all.
        learner: "kernel-ridge" (ridge regression with a Gaussian kernel) or "tree" (a decision tree
            of depth 6).
        steps: number of steps in which the weight of the simulated samples falls to zero.
        rounds: rounds of boosting within a step.
        folds: folds of the cross-validation that chooses the step, by pose.
    """

    source_poses: PoseDesign = "sobol"
    source_wrenches: WrenchDesign = "sobol"
    source_samples: Annotated[int, Ge(1)] = 1000
    learner: Literal["kernel-ridge", "tree"] = "kernel-ridge"
    steps: Annotated[int, Ge(2)] = 6
    rounds: Annotated[int, Ge(1)] = 3
    folds: Annotated[int, Ge(2)] = 5

    def _fit(self, train: Samples, robot: Robot, validation: Samples | None, seed: int) -> None:
        inputs, targets = self._trained_rows(robot, train)
        origin = self._origin(train, robot)
        domain = self._simulated(origin.samples, origin.robot, seed)
        order = np.random.default_rng(seed).permutation(len(domain))
        drawn = domain.take(order[: self.source_samples])
        inputs_of_both = np.vstack([self._features(robot, drawn.q, drawn.wrench), inputs])
        outputs = np.vstack([self.output_scaler_.apply(drawn.deflection), targets])
        learner = self._learner(inputs_of_both.shape[1], seed)
        self.diagnostics_: dict[str, float] = {}
        boosted = []
        for axis, name in enumerate(AXES):
            rows = Domains(inputs_of_both, outputs[:, axis], len(drawn))
            settings = {"steps": self.steps, "rounds": self.rounds, "folds": self.folds}
            steps = list(steps_of(learner, rows, train.pose_id, **settings))
            best = int(np.nan_to_num([step.error for step in steps], nan=np.inf).argmin())
            weights = steps[best].weights
            boosted.append(adaboost_r2(learner, rows, weights, self.rounds))
            self.diagnostics_ |= {
                f"step {name.upper()}": best + 1.0,
                f"simulated share of the weight {name.upper()}": float(weights[: len(drawn)].sum()),
            }
        self.boosted_ = tuple(boosted)

    def _learner(self, n_features: int, seed: int) -> Any:
        if self.learner == "tree":
            return DecisionTreeRegressor(max_depth=TREE_DEPTH, random_state=seed)
        return KernelRidge(kernel="rbf", gamma=KERNEL_GAMMA / n_features, alpha=RIDGE)

    def _predict(self, q: FloatArray, wrench: FloatArray) -> FloatArray:
        inputs = self._features(self.robot_, q, wrench)
        predicted = np.stack([boosted.predict(inputs) for boosted in self.boosted_], axis=1)
        return self.output_scaler_.undo(predicted)
