"""The base network of all learned families, and where it runs."""

from __future__ import annotations

import itertools
import os
from typing import Literal

import torch

from stiff_protocols.errors import ConfigError

Activation = Literal["relu", "tanh", "sigmoid", "gelu"]
ChosenActivation = Literal["auto", "relu", "tanh", "sigmoid", "gelu"]
Device = Literal["auto", "cpu", "cuda"]

_ACTIVATIONS = {
    "relu": torch.nn.ReLU,
    "tanh": torch.nn.Tanh,
    "sigmoid": torch.nn.Sigmoid,
    "gelu": torch.nn.GELU,
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

    Weights are torch's default initialisation drawn from `seed`; torch's own random state is
    left as it was.
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


def torch_device(device: Device) -> torch.device:
    """Return the device a network runs on; "auto" takes a GPU where there is one.

    A GPU's matrix products are told to repeat themselves; `arithmetic` sees to the rest of a
    training.

    Raises:
        ConfigError: "cuda" was asked for and there is none.
    """
    on_gpu = device != "cpu" and torch.cuda.is_available()
    if device == "cuda" and not on_gpu:
        raise ConfigError("device 'cuda': no CUDA device is available here (valid: auto, cpu)")
    if on_gpu:
        os.environ.setdefault("CUBLAS_WORKSPACE_CONFIG", ":4096:8")  # cuBLAS reads it as it starts
    return torch.device("cuda" if on_gpu else "cpu")
