"""The Jacobian and the parts of a prediction as torch modules, against the numpy ones."""

from __future__ import annotations

import numpy as np
import pytest
import torch

from helpers.made_robots import random_chain
from stiff_models.networks.encoded_model import Scaler, encode
from stiff_models.networks.fully_connected import build_network
from stiff_models.networks.onnx_export import EncodedNetwork, TorchJacobian

CHAINS = [
    ("revolute",) * 6,
    ("prismatic", "revolute", "prismatic", "revolute", "revolute"),
    ("revolute",),
    ("prismatic", "prismatic"),
]


@pytest.mark.parametrize("kinds", CHAINS)
@pytest.mark.parametrize(("dtype", "tolerance"), [(torch.float64, 1e-12), (torch.float32, 1e-6)])
def test_the_torch_jacobian_is_the_numpy_one(kinds, dtype, tolerance, rng):
    robot = random_chain(rng, kinds)
    q = torch.tensor(rng.uniform(-3, 3, size=(200, robot.n_joints)), dtype=dtype)
    truth = robot.jacobian(q.double().numpy())
    ours = TorchJacobian(robot)(q)
    assert ours.dtype == dtype
    assert np.abs(ours.numpy() - truth).max() <= tolerance * np.abs(truth).max()


@pytest.mark.parametrize("encoding", ["sincos", "raw"])
def test_an_encoded_network_sees_the_features_that_training_saw(encoding, rng):
    robot = random_chain(rng, CHAINS[1])
    q, wrench = rng.normal(size=(20, 5)), rng.normal(size=(20, 6))
    features = encode(robot, q, wrench, encoding)
    scalers = Scaler.of(features), Scaler(rng.normal(size=3), rng.uniform(1, 2, size=3))
    network = build_network(features.shape[1], layers=1, width=8, activation="tanh", seed=0)
    module = EncodedNetwork(robot, network, encoding, *scalers)
    with torch.no_grad():
        inputs = torch.tensor(scalers[0].apply(features), dtype=torch.float32)
        truth = scalers[1].undo(network(inputs).double().numpy())
        ours = module(torch.tensor(q), torch.tensor(wrench)).numpy()
    np.testing.assert_allclose(ours, truth, atol=1e-6)
