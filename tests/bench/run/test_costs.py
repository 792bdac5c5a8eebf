"""What is asked of a model whose costs are measured."""

from __future__ import annotations

import numpy as np

from stiff_bench.run.costs import MOST_SINGLE_PREDICTIONS, latency


class Asked:
    """Remembers what it was asked."""

    def __init__(self):
        self.rows = []

    def fit(self, train, *, robot, validation=None, seed=0):
        return self

    def predict(self, q, wrench):
        self.rows.append((q, wrench))
        return np.zeros((len(q), 3))

    def get_params(self, deep=True):
        return {}

    def set_params(self, **params):
        return self


Q, WRENCH = np.arange(12.0).reshape(2, 6), np.arange(12.0, 24.0).reshape(2, 6)


def test_the_latency_of_a_model_is_that_of_one_row_after_another():
    model = Asked()
    assert latency(model, Q, WRENCH) > 0.0
    assert len(model.rows) == MOST_SINGLE_PREDICTIONS
    for i, (q, wrench) in enumerate(model.rows):
        np.testing.assert_array_equal(q, Q[i % 2 : i % 2 + 1])
        np.testing.assert_array_equal(wrench, WRENCH[i % 2 : i % 2 + 1])
