"""Features and outputs of two small domains, for distances between them."""

from __future__ import annotations

import torch


def normal(n_rows: int, n_columns: int, seed: int) -> torch.Tensor:
    """Return (n_rows, n_columns) standard normal numbers."""
    return torch.randn(n_rows, n_columns, generator=torch.Generator().manual_seed(seed))


INPUTS, TARGETS, OF_TARGET = normal(50, 7, 0), normal(50, 3, 1), 1.0 + normal(40, 7, 2)
"""A batch of a source's scaled inputs and deflections, and a target's inputs."""
_INDEX = torch.arange(15, dtype=torch.float64).reshape(3, 5)
SOURCE, TARGET = torch.sin(1.0 + 1.7 * _INDEX), torch.cos(0.4 + 0.9 * _INDEX**1.1)
