"""Check two-stage TrAdaBoost.R2 on domains whose difference is known."""

from __future__ import annotations

import numpy as np
import pytest
from sklearn.kernel_ridge import KernelRidge
from sklearn.tree import DecisionTreeRegressor

from stiff_models.regressors.tradaboost import (
    Domains,
    adaboost_r2,
    cross_validated,
    relative_errors,
    steps_of,
)

RIDGE = KernelRidge(kernel="rbf", gamma=20.0, alpha=1e-3)
N_SOURCE, N_TARGET = 60, 12
SOURCE = np.linspace(0.0, 1.0, N_SOURCE)[:, None]
TARGET = np.linspace(0.02, 0.98, N_TARGET)[:, None]
GROUPS = np.arange(N_TARGET).astype(str)
LINE = np.linspace(0.05, 0.95, 91)[:, None]


def truth(x):
    return np.sin(8.0 * x[:, 0])


def rows_with(shift):
    """Return both domains; the source's outputs are off by `shift` (n_source,)."""
    inputs = np.vstack([SOURCE, TARGET])
    outputs = truth(inputs)
    outputs[:N_SOURCE] += shift
    return Domains(inputs, outputs, N_SOURCE)


def all_steps(rows, steps=6, rounds=2):
    return [*steps_of(RIDGE, rows, GROUPS, steps=steps, rounds=rounds, folds=4)]


def best_step(steps):
    return min(steps, key=lambda step: step.error)


def error_of(model):
    return np.abs(model.predict(LINE) - truth(LINE)).mean()


class RecordingTree(DecisionTreeRegressor):
    """Record the weights of each fit as shares of their sum."""

    seen: list[np.ndarray]

    def fit(self, inputs, outputs, sample_weight):
        RecordingTree.seen.append(sample_weight / sample_weight.sum())
        return super().fit(inputs, outputs, sample_weight=sample_weight)


def test_boosting_raises_target_rows_by_their_error_and_leaves_the_source_alone(monkeypatch):
    monkeypatch.setattr(RecordingTree, "seen", [], raising=False)
    rows = rows_with(0.0)
    weights = np.full(len(rows), 1.0 / len(rows))
    boosted = adaboost_r2(RecordingTree(max_depth=2, random_state=0), rows, weights, rounds=2)
    first_weights, second_weights = RecordingTree.seen
    np.testing.assert_allclose(first_weights, weights)
    np.testing.assert_allclose(second_weights[:N_SOURCE], weights[:N_SOURCE])
    # Drucker 1997: w beta^(1 - e), beta = error / (1 - error), error = sum w e
    errors = relative_errors(boosted.learners[0], rows)
    beta = (weights @ errors) / (1.0 - weights @ errors)
    raised_weights = weights[N_SOURCE:] * beta ** (1.0 - errors[N_SOURCE:])
    expected = raised_weights / raised_weights.sum() * weights[N_SOURCE:].sum()
    np.testing.assert_allclose(second_weights[N_SOURCE:], expected)
    assert boosted.weights[0] == pytest.approx(-np.log(beta))


def test_simulated_rows_that_contradict_the_measured_ones_lose_their_weight():
    is_wrong = np.arange(N_SOURCE) % 3 == 0
    steps = all_steps(rows_with(np.where(is_wrong, 2.0, 0.0)))
    ratios = []
    for step in steps[:-1]:
        source_weights = step.weights[:N_SOURCE]
        ratios.append(source_weights[is_wrong].max() / source_weights[~is_wrong].min())
    assert ratios[0] == 1.0 and (np.diff(ratios) <= 0.0).all()
    assert ratios[-1] < 0.05


def test_a_source_that_is_off_everywhere_does_no_harm():
    rows = rows_with(2.0)
    chosen_step = best_step(all_steps(rows))
    assert chosen_step.weights[:N_SOURCE].sum() < 0.3
    boosted = adaboost_r2(RIDGE, rows, chosen_step.weights, rounds=2)
    plain_ridge = RIDGE.fit(rows.inputs, rows.outputs)
    assert error_of(boosted) < 0.2 * error_of(plain_ridge)


def test_rows_of_a_pose_are_never_in_two_folds():
    outputs = np.where(np.arange(N_TARGET) % 2, 5.0, -5.0)
    repeated_rows = np.repeat(np.arange(N_TARGET), 2)
    rows = Domains(TARGET[repeated_rows], outputs[repeated_rows], 0)
    weights = np.full(len(rows), 1.0 / len(rows))
    memory = DecisionTreeRegressor(random_state=0)
    pose_error, row_error = (
        cross_validated(memory, rows, weights, groups, rounds=1, folds=4)
        for groups in (GROUPS[repeated_rows], np.arange(2 * N_TARGET).astype(str))
    )
    assert pose_error > 5.0 > row_error
    one_group = np.full(len(rows), "a")
    assert np.isnan(cross_validated(memory, rows, weights, one_group, rounds=1, folds=4))
