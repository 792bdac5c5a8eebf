"""The base network of all learned families."""

from __future__ import annotations

import itertools
from typing import Literal

import torch

Activation = Literal["relu", "tanh", "sigmoid", "gelu", "sharp-gelu"]
ChosenActivation = Literal["auto", "relu", "tanh", "sigmoid", "gelu", "sharp-gelu"]


class SharpGelu(torch.nn.Module):
    """GELU with a standard deviation of 1/4: x P(X <= 4 x), of a standard normal X."""

    def forward(self, x: torch.Tensor) -> torch.Tensor:
        """Return the same shape."""
        return torch.nn.functional.gelu(4.0 * x) * 0.25


_ACTIVATIONS: dict[Activation, type[torch.nn.Module]] = {
    "relu": torch.nn.ReLU,
    "tanh": torch.nn.Tanh,
    "sigmoid": torch.nn.Sigmoid,
    "gelu": torch.nn.GELU,
    "sharp-gelu": SharpGelu,
}


def build_network(
    n_inputs: int,
    *,
    layers: int,
    width: int,
    activation: Activation,
    seed: int,
    n_outputs: int = 3,
) -> torch.nn.Sequential:
    """Return a fully connected network with `layers` hidden layers and linear outputs.

    Weights are torch's default initialisation, drawn from `seed`. Torch's global random state is
    not changed.
    """
    sizes = [n_inputs, *[width] * layers]
    with torch.random.fork_rng(devices=[]):
        torch.manual_seed(seed)
        modules: list[torch.nn.Module] = []
        for n_in, n_out in itertools.pairwise(sizes):
            modules += [torch.nn.Linear(n_in, n_out), _ACTIVATIONS[activation]()]
        modules.append(torch.nn.Linear(sizes[-1], n_outputs))
    return torch.nn.Sequential(*modules)


def linear_layers(network: torch.nn.Module) -> list[torch.nn.Linear]:
    """Return the hidden layers, then the output layer."""
    return [module for module in network.modules() if isinstance(module, torch.nn.Linear)]
