"""Two-stage TrAdaBoost.R2 on domains whose difference is known, alone and as `tradaboost`."""

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
    """Both domains, of which the source is `shift` (n_source,) off."""
    inputs = np.vstack([SOURCE, TARGET])
    outputs = truth(inputs)
    outputs[:N_SOURCE] += shift
    return Domains(inputs, outputs, N_SOURCE)


def all_steps(rows, steps=6, rounds=2):
    return [*steps_of(RIDGE, rows, GROUPS, steps=steps, rounds=rounds, folds=4)]


def best(steps):
    return min(steps, key=lambda step: step.error)


def error_of(model):
    return np.abs(model.predict(LINE) - truth(LINE)).mean()


class Witness(DecisionTreeRegressor):
    """Notes the weights that it learns with, as shares of all."""

    seen: list[np.ndarray]

    def fit(self, inputs, outputs, sample_weight):
        Witness.seen.append(sample_weight / sample_weight.sum())
        return super().fit(inputs, outputs, sample_weight=sample_weight)


def test_boosting_raises_target_rows_by_their_error_and_leaves_the_source_alone(monkeypatch):
    monkeypatch.setattr(Witness, "seen", [], raising=False)
    rows = rows_with(0.0)
    weights = np.full(len(rows), 1.0 / len(rows))
    boosted = adaboost_r2(Witness(max_depth=2, random_state=0), rows, weights, rounds=2)
    first, second = Witness.seen
    np.testing.assert_allclose(first, weights)
    np.testing.assert_allclose(second[:N_SOURCE], weights[:N_SOURCE])
    # Drucker 1997: w beta^(1 - e), beta = error / (1 - error), error = sum w e
    errors = relative_errors(boosted.learners[0], rows)
    beta = (weights @ errors) / (1.0 - weights @ errors)
    raised = weights[N_SOURCE:] * beta ** (1.0 - errors[N_SOURCE:])
    expected = raised / raised.sum() * weights[N_SOURCE:].sum()
    np.testing.assert_allclose(second[N_SOURCE:], expected)
    assert boosted.weights[0] == pytest.approx(-np.log(beta))


def test_simulated_rows_that_contradict_the_measured_ones_lose_their_weight():
    wrong = np.arange(N_SOURCE) % 3 == 0
    steps = all_steps(rows_with(np.where(wrong, 2.0, 0.0)))
    ratios = []
    for step in steps[:-1]:
        of_source = step.weights[:N_SOURCE]
        ratios.append(of_source[wrong].max() / of_source[~wrong].min())
    assert ratios[0] == 1.0 and (np.diff(ratios) <= 0.0).all()
    assert ratios[-1] < 0.05


def test_a_source_that_is_off_everywhere_does_no_harm():
    rows = rows_with(2.0)
    chosen = best(all_steps(rows))
    assert chosen.weights[:N_SOURCE].sum() < 0.3
    boosted = adaboost_r2(RIDGE, rows, chosen.weights, rounds=2)
    everything = RIDGE.fit(rows.inputs, rows.outputs)
    assert error_of(boosted) < 0.2 * error_of(everything)


def test_rows_of_a_pose_are_never_in_two_folds():
    outputs = np.where(np.arange(N_TARGET) % 2, 5.0, -5.0)
    twice = np.repeat(np.arange(N_TARGET), 2)
    rows = Domains(TARGET[twice], outputs[twice], 0)
    weights = np.full(len(rows), 1.0 / len(rows))
    memory = DecisionTreeRegressor(random_state=0)
    by_pose, by_row = (
        cross_validated(memory, rows, weights, groups, rounds=1, folds=4)
        for groups in (GROUPS[twice], np.arange(2 * N_TARGET).astype(str))
    )
    assert by_pose > 5.0 > by_row
    one = np.full(len(rows), "a")
    assert np.isnan(cross_validated(memory, rows, weights, one, rounds=1, folds=4))
