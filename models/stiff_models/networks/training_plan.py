"""How a network is trained: plan, schedule and loss."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Literal

import torch

Loss = Literal["huber", "mse", "mae"]
OptimizerName = Literal["muon", "adam", "sgd"]

HUBER_DELTA = 0.02  # standardised outputs
WARM_UP = 0.1  # share of the steps over which a "linear" schedule rises before it falls
STEP_DECAYS = (1 / 2, 5 / 6)  # shares of the steps after which a "steps" schedule falls to a tenth


@dataclass(frozen=True)
class TrainingPlan:
    """How a network is trained.

    Attributes:
        steps: number of optimizer steps; with `batch=None` a step is an epoch.
        learning_rate: at its highest.
        loss: on standardised outputs; "huber" has a width of 0.02.
        optimizer: "muon" moves square hidden weights, Adam the rest beside it.
        batch: samples a step; None: all.
        schedule: "constant"; "linear": 10 % warm-up, then linear decay to zero; "steps": a tenth
            after half of the steps, and again after five sixths.
        keep_best: end with the weights of the step that was best on the validation rows.
        mixed_precision: use bfloat16 where the device has it in hardware.
        weight_decay: of "adam", added to the gradient (L2).
    """

    steps: int
    learning_rate: float
    loss: Loss
    optimizer: OptimizerName
    batch: int | None = None
    schedule: Literal["constant", "linear", "steps"] = "constant"
    keep_best: bool = False
    mixed_precision: bool = False
    weight_decay: float = 0.0

    def rate(self, step: int) -> float:
        """Return the schedule's factor on the learning rate at a step, from 0."""
        if self.schedule == "constant":
            return 1.0
        if self.schedule == "steps":
            return 0.1 ** sum(step >= share * self.steps for share in STEP_DECAYS)
        rising = max(1, round(WARM_UP * self.steps))
        falling = max(1, self.steps - rising)
        return min((step + 1) / rising, (self.steps - step) / falling)


def loss_function(name: Loss) -> Callable[[torch.Tensor, torch.Tensor], torch.Tensor]:
    """Return the loss of (n, 3) outputs and targets."""
    huber = torch.nn.HuberLoss(delta=HUBER_DELTA)
    return {"huber": huber, "mse": torch.nn.MSELoss(), "mae": torch.nn.L1Loss()}[name]
