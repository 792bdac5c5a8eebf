"""Fine-tuning does what the textbook loop in plain torch does."""

from __future__ import annotations

from dataclasses import replace

import pytest
import torch

from helpers.plain_fine_tuning import Pretrained, largest_difference, our_loop, plain_loop
from stiff_models.networks.fully_connected import build_network
from stiff_models.networks.training import Rows, TrainingPlan

SAME = 1e-4
"""Relative: the sums are taken in another order, and the sign in the gradient of the mean absolute
error makes the differences grow from epoch to epoch."""


@pytest.fixture(scope="module")
def case():
    """A network that knows a function, and rows of a somewhat different one."""
    generator = torch.Generator().manual_seed(0)
    network = build_network(6, layers=4, width=32, activation="relu", seed=1)
    other = build_network(6, layers=4, width=32, activation="relu", seed=2)

    def rows(n):
        inputs = torch.randn(n, 6, generator=generator)
        with torch.no_grad():
            return Rows(inputs, network(inputs) + 5 * other(inputs))

    return Pretrained(network, rows(48), rows(12))


@pytest.mark.parametrize(
    ("freeze", "moving"),
    [("layers:1,2", (0, 1)), ("layers:4,out", (3, 4)), ("full", range(5))],
)
@pytest.mark.parametrize(("optimizer", "rate"), [("adam", 3e-3), ("sgd", 0.1)])
def test_the_losses_are_those_of_the_textbook_loop(case, freeze, moving, optimizer, rate):
    plan = TrainingPlan(60, rate, loss="mae", optimizer=optimizer, keep_best=True)
    curve, plain = our_loop(case, freeze, plan), plain_loop(case, moving, plan)
    assert plain.train[-1] < 0.995 * plain.train[0]
    assert len(curve.points) == 6
    assert largest_difference(curve, plain) < SAME
    slower = plain_loop(case, moving, replace(plan, learning_rate=rate / 2))
    assert largest_difference(curve, slower) > 10 * SAME
