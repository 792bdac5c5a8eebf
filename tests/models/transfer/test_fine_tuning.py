"""Check fine-tuning against the textbook loop in plain torch."""

from __future__ import annotations

from dataclasses import replace

import pytest
import torch

from helpers.plain_fine_tuning import Pretrained, largest_difference, our_loop, plain_loop
from stiff_models.networks.fully_connected import build_network
from stiff_models.networks.training import Rows, TrainingPlan

SAME = 1e-4
"""Relative tolerance. Sums are taken in another order, and the sign in the gradient of the mean
absolute error makes the differences grow from epoch to epoch."""


@pytest.fixture(scope="module")
def case():
    """Return a pre-trained network, and rows of a slightly different function."""
    generator = torch.Generator().manual_seed(0)
    network = build_network(6, layers=4, width=32, activation="relu", seed=1)
    second_network = build_network(6, layers=4, width=32, activation="relu", seed=2)

    def rows(n):
        inputs = torch.randn(n, 6, generator=generator)
        with torch.no_grad():
            return Rows(inputs, network(inputs) + 5 * second_network(inputs))

    return Pretrained(network, rows(48), rows(12))


@pytest.mark.parametrize(
    ("freeze", "moving"),
    [("layers:1,2", (0, 1)), ("layers:4,out", (3, 4)), ("full", range(5))],
)
@pytest.mark.parametrize(("optimizer", "rate"), [("adam", 3e-3), ("sgd", 0.1)])
def test_the_losses_are_those_of_the_textbook_loop(case, freeze, moving, optimizer, rate):
    plan = TrainingPlan(60, rate, loss="mae", optimizer=optimizer, keep_best=True)
    curve, plain_losses = our_loop(case, freeze, plan), plain_loop(case, moving, plan)
    assert plain_losses.train[-1] < 0.995 * plain_losses.train[0]
    assert len(curve.points) == 6
    assert largest_difference(curve, plain_losses) < SAME
    slower_losses = plain_loop(case, moving, replace(plan, learning_rate=rate / 2))
    assert largest_difference(curve, slower_losses) > 10 * SAME
