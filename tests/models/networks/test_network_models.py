"""Check `mlp`, `mlp-pretrained` and `ft-mlp` as models, on small networks."""

from __future__ import annotations

import numpy as np
import pytest
import torch

from stiff_models.networks.fully_connected import linear_layers
from stiff_models.networks.mlp import Mlp
from stiff_models.transfer.ft_mlp import FtMlp

pytestmark = pytest.mark.usefixtures("small_source")

SMALL = {"layers": 4, "width": 16, "device": "cpu"}
SMALL_SOURCE = SMALL | {"pretrain_steps": 30, "source_poses": "sobol"}
EVERY = frozenset({0, 2, 4, 6, 8})
STRATEGIES = {"layers:1,2": {0, 2}, "layers:4,out": {6, 8}, "lp-ft": EVERY}
"""Freeze strategy -> numbers of the modules that it trains."""


def fit(model, parts, seed=5, validation=True):
    robot, train, held_out, _ = parts
    return model.fit(train, robot=robot, validation=held_out if validation else None, seed=seed)


def state(network):
    return {name: value.numpy().copy() for name, value in network.state_dict().items()}


def test_the_default_network_is_4_x_380_relu_on_18_features(parts):
    model = fit(Mlp(epochs=0, device="cpu"), parts)
    sizes = [(layer.in_features, layer.out_features) for layer in linear_layers(model.network_)]
    assert sizes == [(18, 380), (380, 380), (380, 380), (380, 380), (380, 3)]
    assert sum(isinstance(module, torch.nn.ReLU) for module in model.network_) == 4


def test_an_angle_and_the_same_angle_a_turn_later_are_one_input(parts):
    _, _, _, test = parts
    model = fit(Mlp(**SMALL, epochs=2), parts)
    np.testing.assert_allclose(
        model.predict(test.q + 2 * np.pi, test.wrench),
        model.predict(test.q, test.wrench),
        atol=1e-8,
    )


@pytest.mark.slow
@pytest.mark.parametrize("freeze", STRATEGIES)
def test_every_strategy_moves_its_own_parameters_and_no_others(freeze, parts):
    model = fit(FtMlp(**SMALL_SOURCE, epochs=20, freeze=freeze, training="normal"), parts)
    before, after = state(model.source_network_), state(model.network_)
    changed_names = {name for name in before if not np.array_equal(before[name], after[name])}
    expected_names = {
        f"{layer}.{kind}" for layer in STRATEGIES[freeze] for kind in ("weight", "bias")
    }
    assert changed_names == expected_names
