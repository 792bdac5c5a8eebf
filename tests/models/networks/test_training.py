"""Check the training loop, its optimizers and its passes without autograd."""

from __future__ import annotations

import math

import pytest
import torch

from stiff_models.networks.fully_connected import build_network
from stiff_models.networks.training import Rows, TrainingPlan, train_network


def network(seed=0, width=16):
    return build_network(5, layers=3, width=width, activation="relu", seed=seed)


def rows(n=64, seed=1):
    generator = torch.Generator().manual_seed(seed)
    inputs = torch.randn(n, 5, generator=generator)
    return Rows(inputs, torch.stack([inputs[:, 0], inputs[:, 1] * inputs[:, 2], inputs[:, 3]], 1))


def plan(**changes):
    return TrainingPlan(
        **({"steps": 40, "learning_rate": 1e-2, "loss": "mae", "optimizer": "adam"} | changes)
    )


def train(net, data=None, training_plan=None, **options):
    data, training_plan = data or rows(), training_plan or plan()
    return train_network(net, data, training_plan, **({"seed": 0, "phase": "t"} | options))


def error(net, data):
    with torch.no_grad():
        return (net(data.inputs) - data.targets).abs().mean().item()


@pytest.mark.parametrize(
    ("optimizer", "loss", "rate"),
    # the Huber loss is narrow, so its gradients are small
    [("adam", "mse", 1e-2), ("sgd", "huber", 10.0), ("sgd", "mae", 0.1), ("muon", "huber", 0.02)],
)
def test_training_lowers_the_error(optimizer, loss, rate):
    net, data = network(), rows()
    before = error(net, data)
    training_plan = plan(steps=100, optimizer=optimizer, loss=loss, learning_rate=rate)
    train(net, data, training_plan)
    assert error(net, data) < 0.9 * before


@pytest.mark.slow
def test_the_best_step_on_the_validation_rows_is_kept():
    net, data, held_out = network(width=64), rows(12), rows(200, seed=2)
    curve = train(net, data, plan(steps=300, keep_best=True), validation=held_out)
    assert error(net, held_out) == pytest.approx(curve.best_loss, rel=1e-5)
    assert 0 < curve.best_step < 300
    last_network = network(width=64)
    train(last_network, data, plan(steps=300), validation=held_out)
    assert curve.best_loss < error(last_network, held_out)


def test_validation_rows_do_not_change_what_is_learned():
    validated_network, plain_network = network(), network()
    curve = train(validated_network, validation=rows(9, seed=5))
    train(plain_network)
    assert math.isnan(curve.best_loss)
    assert all(
        torch.equal(a, b)
        for a, b in zip(validated_network.parameters(), plain_network.parameters(), strict=True)
    )
