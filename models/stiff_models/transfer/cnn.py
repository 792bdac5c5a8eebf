"""The 1x1-convolution network of `dt-cnn`.

Its shape follows Zhao et al., "Applications of Unsupervised Deep Transfer Learning to Intelligent
Fault Diagnosis: A Survey and Comparative Study", IEEE TIM 2021 (UDTL, `models/cnn_1d.py`), with
linear outputs and kernels of width 1. The features of a sample are not a signal, so their order has
no meaning.
"""

from __future__ import annotations

import itertools
from typing import Literal

import torch

Pool = Literal["none", "udtl"]

CHANNELS = (1, 16, 32, 64, 128)
POOLED_AFTER = 2  # convolutions before the max pooling of pairs
CELLS = 4  # cells of the adaptive pooling after the last convolution
WIDTH = 256  # width of the hidden and the bottleneck layer


class CellMaxPool(torch.nn.Module):
    """Adaptive max pooling of a fixed length to `CELLS` cells.

    Cell i of m values covers floor(i m / 4) to ceil((i+1) m / 4), as in torch's
    AdaptiveMaxPool1d, which ONNX supports only if 4 divides m.
    """

    def __init__(self, length: int) -> None:
        """Store the cells for `length` values per channel."""
        super().__init__()
        self.cells = [
            (i * length // CELLS, -(-(i + 1) * length // CELLS))  # floor and ceiling
            for i in range(CELLS)
        ]

    def forward(self, values: torch.Tensor) -> torch.Tensor:
        """Return (n, channels, 4) maxima of (n, channels, length) values."""
        return torch.stack([values[..., start:stop].amax(-1) for start, stop in self.cells], -1)


class Cnn(torch.nn.Module):
    """Four 1x1 convolutions, a hidden layer, a bottleneck layer, linear outputs.

    Batch normalisation and ReLU follow each convolution; ReLU and dropout follow the two layers of
    256. With `pool="udtl"` the maximum of neighbouring pairs follows the second convolution, and
    adaptive max pooling to 4 cells follows the fourth. One input channel and kernels of width 1
    apply one scalar function to every feature. So a pooled network cannot distinguish the two
    features of a pair: its output does not change if they are swapped. With `pool="none"` the layer
    of 256 gets every feature at its own position.
    """

    def __init__(
        self, n_inputs: int, n_outputs: int, *, pool: Pool, dropout: float, per_sample: bool
    ) -> None:
        """Draw the weights from torch's random state.

        `dropout` is the share of the outputs of both layers of 256 that a training step drops.
        `per_sample`: the features of each sample are normalised first.
        """
        super().__init__()
        modules: list[torch.nn.Module] = []
        if per_sample:  # UDTL's "mean-std" (`datasets/sequence_aug.py`), its scripts' default
            modules.append(torch.nn.LayerNorm(n_inputs, eps=1e-12, elementwise_affine=False))
        modules.append(torch.nn.Unflatten(1, (1, n_inputs)))  # (n, 1 channel, n_inputs)
        length = n_inputs
        for number, (n_in, n_out) in enumerate(itertools.pairwise(CHANNELS), start=1):
            modules += [
                torch.nn.Conv1d(n_in, n_out, kernel_size=1),
                torch.nn.BatchNorm1d(n_out),
                torch.nn.ReLU(),
            ]
            if pool == "udtl" and number == POOLED_AFTER:
                modules.append(torch.nn.MaxPool1d(2))
                length //= 2
        if pool == "udtl":
            modules.append(CellMaxPool(length))
            length = CELLS
        modules += [torch.nn.Flatten(), *_layer(CHANNELS[-1] * length, dropout)]
        self.body = torch.nn.Sequential(*modules, *_layer(WIDTH, dropout))
        self.head = torch.nn.Linear(WIDTH, n_outputs)
        self.statistics_frozen = False

    def bottleneck(self, inputs: torch.Tensor) -> torch.Tensor:
        """Return the (n, 256) bottleneck features of (n, n_inputs) inputs."""
        features: torch.Tensor = self.body(inputs)
        return features

    def forward(self, inputs: torch.Tensor) -> torch.Tensor:
        """Return the (n, n_outputs) outputs of (n, n_inputs) inputs."""
        outputs: torch.Tensor = self.head(self.bottleneck(inputs))
        return outputs

    def train(self, mode: bool = True) -> Cnn:
        """Set the training mode; frozen batch statistics do not change in either mode."""
        super().train(mode)
        if self.statistics_frozen:
            for module in self.norms():
                module.eval()
        return self

    def freeze_statistics(self) -> None:
        """Freeze the batch statistics, also in training."""
        self.statistics_frozen = True
        self.train(self.training)

    def norms(self) -> list[torch.nn.BatchNorm1d]:
        """Return the batch normalisations, first to last."""
        return [module for module in self.body if isinstance(module, torch.nn.BatchNorm1d)]


def build_cnn(
    n_inputs: int,
    *,
    pool: Pool,
    dropout: float,
    per_sample: bool,
    seed: int,
    n_outputs: int = 3,
) -> Cnn:
    """Return a network with weights from `seed`; torch's global random state is unchanged."""
    with torch.random.fork_rng(devices=[]):
        torch.manual_seed(seed)
        return Cnn(n_inputs, n_outputs, pool=pool, dropout=dropout, per_sample=per_sample)


@torch.no_grad()
def adapt_statistics(network: Cnn, inputs: torch.Tensor) -> None:
    """Recompute the batch statistics in place from (n > 1, n_inputs) target `inputs`.

    AdaBN: Li et al., "Adaptive Batch Normalization for Practical Domain Adaptation", 2018. All
    rows pass at once, so that every layer gets the adapted outputs of the previous layer. The
    network is in evaluation mode afterwards.
    """
    network.eval()
    norms = network.norms()
    momenta = [norm.momentum for norm in norms]
    for norm in norms:
        norm.reset_running_stats()
        norm.train()
        norm.momentum = None  # the plain mean over all batches: here, a single batch
    network(inputs)
    for norm, momentum in zip(norms, momenta, strict=True):
        norm.momentum = momentum
    network.eval()


def _layer(n_inputs: int, dropout: float) -> list[torch.nn.Module]:
    return [torch.nn.Linear(n_inputs, WIDTH), torch.nn.ReLU(), torch.nn.Dropout(dropout)]
