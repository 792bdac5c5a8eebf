"""A textbook loop of fine-tuning in plain torch, to compare ours with."""

from __future__ import annotations

import copy
from collections.abc import Iterable
from dataclasses import dataclass

import numpy as np
import torch

from stiff_models.networks.fully_connected import linear_layers
from stiff_models.networks.training import Curve, Rows, TrainingPlan
from stiff_models.transfer.ft_mlp import FtMlp


@dataclass(frozen=True, eq=False)
class Pretrained:
    """A network, its measured rows for fine-tuning, and rows to choose the epoch."""

    network: torch.nn.Sequential
    rows: Rows
    held_out: Rows


@dataclass(frozen=True)
class PlainCurve:
    """Losses of each epoch: on the rows before its step, on the held-out rows after it."""

    train: list[float]
    held_out: list[float]


def plain_loop(case: Pretrained, moving: Iterable[int], plan: TrainingPlan) -> PlainCurve:
    """Fine-tune a copy of the network as most people write it: a separate validation pass.

    Args:
        case: network and rows to fine-tune.
        moving: numbers of the layers that move, from 0.
        plan: its length, its constant learning rate, and "adam" or "sgd"; on the mean absolute
            error.
    """
    network = copy.deepcopy(case.network).requires_grad_(False)
    layers = linear_layers(network)
    free = [parameter for number in moving for parameter in layers[number].parameters()]
    for parameter in free:
        parameter.requires_grad_()
    kinds = {"adam": torch.optim.Adam, "sgd": torch.optim.SGD}
    optimizer = kinds[plan.optimizer](free, lr=plan.learning_rate)
    loss_of = torch.nn.L1Loss()
    best, best_weights = torch.tensor(torch.inf), [torch.empty_like(weights) for weights in free]
    losses, judged = [], []
    for _ in range(plan.steps):
        optimizer.zero_grad()
        loss = loss_of(network(case.rows.inputs), case.rows.targets)
        loss.backward()
        optimizer.step()
        losses.append(loss.detach())
        with torch.no_grad():
            judged.append(loss_of(network(case.held_out.inputs), case.held_out.targets))
            if judged[-1] < best:
                best = judged[-1]
                copy_into(best_weights, free)
    with torch.no_grad():
        copy_into(free, best_weights)
    return PlainCurve(torch.stack(losses).tolist(), torch.stack(judged).tolist())


def copy_into(places: Iterable[torch.Tensor], values: Iterable[torch.Tensor]) -> None:
    for place, value in zip(places, values, strict=True):
        place.copy_(value)


def our_loop(case: Pretrained, freeze: str, plan: TrainingPlan) -> Curve:
    """Fine-tune a copy of the network through the product's code."""
    model, network = FtMlp(freeze=freeze), copy.deepcopy(case.network)
    (curve,) = model._learn(network, case.rows, plan, 0, validation=case.held_out)
    return curve


def largest_difference(curve: Curve, plain: PlainCurve) -> float:
    """Return the largest difference of a loss from the plain loop's, as a share of the latter."""
    pairs = [(curve.best_loss, min(plain.held_out))]
    for step, train_loss, validation_loss in curve.points:
        pairs.append((train_loss, plain.train[int(step) - 1]))
        pairs.append((validation_loss, plain.held_out[int(step) - 2]))
    ours, theirs = np.array(pairs).T
    return float((abs(ours - theirs) / theirs).max())
