"""Check the torch modules of Jacobian and prediction against the numpy functions."""

from __future__ import annotations

from dataclasses import replace

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
    jacobian = TorchJacobian(robot)(q)
    assert jacobian.dtype == dtype
    assert np.abs(jacobian.numpy() - truth).max() <= tolerance * np.abs(truth).max()


@pytest.mark.parametrize("endless", [False, True])
@pytest.mark.parametrize("encoding", ["sincos", "raw"])
def test_an_encoded_network_sees_the_features_that_training_saw(encoding, endless, rng):
    robot = random_chain(rng, CHAINS[1])
    if endless:
        limits = np.array([3.0, 3.0, 3.0, np.inf, 3.0])
        robot = replace(robot, lower=-limits, upper=limits)
    q, wrench = rng.normal(size=(20, 5)), rng.normal(size=(20, 6))
    features = encode(robot, q, wrench, encoding)
    scalers = Scaler.of(features), Scaler(rng.normal(size=3), rng.uniform(1, 2, size=3))
    network = build_network(features.shape[1], layers=1, width=8, activation="tanh", seed=0)
    module = EncodedNetwork(robot, network, encoding, *scalers)
    with torch.no_grad():
        inputs = torch.tensor(scalers[0].apply(features), dtype=torch.float32)
        truth = scalers[1].undo(network(inputs).double().numpy())
        outputs = module(torch.tensor(q), torch.tensor(wrench)).numpy()
    np.testing.assert_allclose(outputs, truth, atol=1e-6)
    if endless:
        turned = q + 2.0 * np.pi * np.eye(5)[3]
        np.testing.assert_allclose(encode(robot, turned, wrench, encoding), features, atol=1e-12)
