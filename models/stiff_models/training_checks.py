"""What a training must not end with in silence: a loss that rose, outputs that never change."""

from __future__ import annotations

import torch

RISEN = 10.0
"""So many times both the first loss and that of no output at all: the training has diverged."""
ROWS_LOOKED_AT = 256


def rose(first: float, last: float, of_nothing: float) -> str:
    """Return that the loss rose; "" where it did not, or where noise may explain it.

    Args:
        first: loss before the first step.
        last: loss at the end.
        of_nothing: loss of outputs that are all zero, which predict the mean.
    """
    if last <= RISEN * max(first, of_nothing):
        return ""
    return f"the loss rose from {first:.3g} to {last:.3g}"


def dead(inputs: torch.Tensor, outputs: torch.Tensor, targets: torch.Tensor) -> str:
    """Return that all outputs are the same; "" where they are not, or where they should be.

    Units that a step too far has pushed below zero for every row stay there for ever.

    Args:
        inputs: (n, n_features), n > 0
        outputs: (n, 3) of the trained network.
        targets: (n, 3)
    """
    if not _varies(inputs) or not _varies(targets) or _varies(outputs):
        return ""
    return "the network gives every row the same output"


def _varies(values: torch.Tensor) -> bool:
    return bool((values != values[0]).any())
