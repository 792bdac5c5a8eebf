"""The optimizers of the training loop, and the pull towards the first weights."""

from __future__ import annotations

from collections.abc import Mapping

import torch

from stiff_models.muon import WHITENED_ROWS, Muon
from stiff_models.networks import linear_layers
from stiff_models.training_plan import Trainable, TrainingPlan

ADAM_RATE_BESIDE_MUON = 4e-3  # of biases and of the first and last layer


def optimizers(
    network: torch.nn.Module,
    plan: TrainingPlan,
    trainable: Trainable,
    inputs: torch.Tensor,
    *,
    bfloat16: bool,
) -> list[torch.optim.Optimizer]:
    """Return the optimizers, each parameter in one group of its own rate.

    Args:
        network: that is trained.
        plan: how.
        trainable: which parameters move.
        inputs: (n, n_inputs) of the network, of the rows it learns from.
        bfloat16: low precision is at hand.
    """
    rates = trainable.rates
    if plan.optimizer == "sgd":
        return [torch.optim.SGD(_groups(rates, plan.learning_rate))]
    if plan.optimizer == "adam":
        groups = _groups(rates, plan.learning_rate)
        return [torch.optim.Adam(groups, weight_decay=plan.weight_decay, fused=True)]
    hidden = [layer for layer in linear_layers(network)[1:-1] if layer.weight in rates]
    weights = {layer.weight for layer in hidden}
    rest = {parameter: rate for parameter, rate in rates.items() if parameter not in weights}
    optimizers: list[torch.optim.Optimizer] = [
        torch.optim.Adam(_groups(rest, ADAM_RATE_BESIDE_MUON), fused=True)
    ]
    if hidden:
        sample = inputs[:: max(1, len(inputs) // WHITENED_ROWS)][:WHITENED_ROWS]
        optimizers.append(
            Muon(network, hidden, sample, lr=plan.learning_rate, low_precision=bfloat16)
        )
    return optimizers


def _groups(rates: Mapping[torch.Tensor, float], learning_rate: float) -> list[dict[str, object]]:
    by_rate: dict[float, list[torch.Tensor]] = {}
    for parameter, rate in rates.items():
        by_rate.setdefault(rate, []).append(parameter)
    return [{"params": group, "lr": rate * learning_rate} for rate, group in by_rate.items()]


@torch.no_grad()
def pull_back(
    moving: list[torch.Tensor],
    origin: list[torch.Tensor],
    trainable: Trainable,
    learning_rate: float,
) -> None:
    """Apply the penalty alpha/2 |w - w0|^2 as its proximal step.

    Taken implicitly it is stable for every alpha and tends to w0 as alpha grows; as a gradient
    an adaptive optimizer would rescale it away.
    """
    for parameter, first in zip(moving, origin, strict=True):
        shrink = 1.0 / (1.0 + trainable.pull * learning_rate * trainable.rates[parameter])
        parameter.copy_(first + (parameter - first) * shrink)
