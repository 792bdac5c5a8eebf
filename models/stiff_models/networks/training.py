"""The training loop of pre-training, fine-tuning and training from scratch."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from types import MappingProxyType
from typing import Literal

import numpy as np
import torch

from stiff_models.device import arithmetic
from stiff_models.networks.fully_connected import linear_layers
from stiff_models.networks.muon import Muon
from stiff_protocols.contract.errors import ModelError, warn
from stiff_protocols.contract.progress import report
from stiff_protocols.contract.types import FloatArray, IntArray

Loss = Literal["huber", "mse", "mae"]
OptimizerName = Literal["muon", "adam", "sgd"]

HUBER_DELTA = 0.02  # standardised outputs
ADAM_RATE_BESIDE_MUON = 4e-3  # for biases and for the first and last layer
WARM_UP = 0.1  # share of the steps over which a "linear" schedule rises before it falls


@dataclass(frozen=True)
class TrainingPlan:
    """Settings of a network's training.

    Attributes:
        steps: number of optimizer steps; with `batch=None` a step is an epoch.
        learning_rate: highest learning rate of the schedule.
        loss: loss on standardised outputs; "huber" has a width of 0.02.
        optimizer: "muon" moves square hidden weights; Adam moves the other weights.
        batch: samples per step; None: all.
        schedule: "constant"; "linear": 10 % warm-up, then linear decay to zero.
        keep_best: end with the weights of the best step on the validation rows.
        mixed_precision: use bfloat16 if the device supports it in hardware.
    """

    steps: int
    learning_rate: float
    loss: Loss
    optimizer: OptimizerName
    batch: int | None = None
    schedule: Literal["constant", "linear"] = "constant"
    keep_best: bool = False
    mixed_precision: bool = False

    def rate(self, step: int) -> float:
        """Return the schedule's factor on the learning rate at a step, from 0."""
        if self.schedule == "constant":
            return 1.0
        rising = max(1, round(WARM_UP * self.steps))
        falling = max(1, self.steps - rising)
        return min((step + 1) / rising, (self.steps - step) / falling)


def loss_function(name: Loss) -> Callable[[torch.Tensor, torch.Tensor], torch.Tensor]:
    """Return the loss of (n, 3) outputs and targets."""
    huber = torch.nn.HuberLoss(delta=HUBER_DELTA)
    return {"huber": huber, "mse": torch.nn.MSELoss(), "mae": torch.nn.L1Loss()}[name]


RISEN = 10.0
"""The training has diverged if its last loss exceeds the first loss, and the loss of zero outputs,
by this factor."""
ROWS_LOOKED_AT = 256  # rows of the final check for divergence


Objective = Callable[[float, torch.Tensor, torch.Tensor], torch.Tensor]
"""Loss of a batch of inputs (n, n_features) and standardised targets (n, 3), minimised instead of
the plan's loss. The first argument is the progress of the training, from 0 up to 1."""
Visits = Mapping[int, Callable[[], None]]
"""Number of steps -> function to call after them."""

PRETRAINING_VERSION = 2
"""Part of the cache key of a finished training. Raise it with every change after which the same
network, rows, plan and seed give other weights or other errors on the source. Such changes may be
in this loop, the optimizers, losses, alignments, a network's forward pass or `source_errors`."""

FULL_PRECISION_END = 0.1  # share of the last steps, which mixed precision computes in float32
REPORT_EVERY = 10  # steps


@dataclass(frozen=True, eq=False)
class Rows:
    """Standardised samples on the device: inputs (n, n_features) and targets (n, 3), float32."""

    inputs: torch.Tensor
    targets: torch.Tensor

    def __len__(self) -> int:
        """Return the number of rows."""
        return len(self.inputs)

    def take(self, rows: IntArray) -> Rows:
        """Return the rows of these numbers."""
        chosen = torch.from_numpy(rows).to(self.inputs.device)
        return Rows(self.inputs[chosen], self.targets[chosen])


@dataclass(frozen=True, eq=False)
class Curve:
    """Losses of a training.

    Attributes:
        points: (n_points, 3) recorded steps: number, loss before the step, and mean absolute error
            of the validation rows (standardised; NaN: no rows).
        best_step: step whose weights were kept (the last step without validation rows).
        best_loss: validation loss of that step; NaN without validation rows.
    """

    points: FloatArray
    best_step: int
    best_loss: float


def train_network(
    network: torch.nn.Module,
    rows: Rows,
    plan: TrainingPlan,
    *,
    seed: int,
    phase: str,
    trainable: Sequence[torch.nn.Parameter] | None = None,
    validation: Rows | None = None,
    objective: Objective | None = None,
    visits: Visits = MappingProxyType({}),
) -> Curve:
    """Train `network` in place; it is in eval mode afterwards.

    Args:
        network: network from (n, n_features) inputs to (n, 3) outputs.
        rows: training rows.
        plan: settings of the training.
        seed: seed of the batches' order and of the layers' random numbers.
        phase: name for progress reports.
        trainable: parameters that move; None: all parameters of the network.
        validation: rows that choose the step if the plan keeps the best; never used for training.
        objective: loss to minimise; None: the plan's loss on the network's outputs.
        visits: functions by number of steps, from 0; they see the network in eval mode.

    Raises:
        ModelError: the loss became NaN or infinite.
    """
    trainable = [*network.parameters()] if trainable is None else trainable
    moving = set(trainable)
    for parameter in network.parameters():
        parameter.requires_grad_(parameter in moving)
    held_out = validation if plan.keep_best else None
    kind = arithmetic(rows.inputs.device, mixed_precision=plan.mixed_precision)
    with kind.in_force(), torch.random.fork_rng():
        torch.manual_seed(seed)  # for random layers: dropout
        run = _Run(network, rows, plan, trainable, held_out, seed, objective, kind.bfloat16)
        curve = run.steps(phase, visits)
    network.eval()
    return curve


class _Run:
    """State of one call of `train_network`."""

    def __init__(
        self,
        network: torch.nn.Module,
        rows: Rows,
        plan: TrainingPlan,
        trainable: Sequence[torch.nn.Parameter],
        validation: Rows | None,
        seed: int,
        objective: Objective | None,
        bfloat16: bool,
    ) -> None:
        self.network, self.plan = network, plan
        self.rows, self.validation, self.objective = rows, validation, objective
        self.device, self.bfloat16 = rows.inputs.device, bfloat16
        self.loss = loss_function(plan.loss)
        self.optimizers = _optimizers(network, plan, trainable, rows.inputs, bfloat16=bfloat16)
        self.highest = [[g["lr"] for g in opt.param_groups] for opt in self.optimizers]
        self.generator = torch.Generator().manual_seed(seed)
        self.order = torch.empty(0, dtype=torch.int64)
        self.kept_weights = [parameter.detach() for parameter in trainable]
        self.validation_loss = math.nan
        self.best_step, self.best_loss = 0, math.inf
        self.best_weights: list[torch.Tensor] = []

    def steps(self, phase: str, visits: Visits) -> Curve:
        plan, points = self.plan, []
        too_high = f"use a learning rate below {plan.learning_rate:g}"

        def finite(loss: torch.Tensor, steps: int) -> float:
            value = loss.item()
            if not math.isfinite(value):
                raise ModelError(f"{phase}: the loss is {value} after {steps} steps; {too_high}")
            return value

        report(phase, 0, plan.steps)
        self.network.train()
        first = loss = torch.tensor(0.0)
        for step in range(plan.steps):
            self._visit(visits, step)
            loss = self.step(step)
            first = loss if step == 0 else first
            if (step + 1) % REPORT_EVERY == 0 or step + 1 == plan.steps:
                value = finite(loss, step + 1)
                points.append((step + 1, value, self.validation_loss))
                report(phase, step + 1, plan.steps, value)
        self._visit(visits, plan.steps)
        if self.validation is not None:
            self._judge(plan.steps, self.validation)
            torch._foreach_copy_(self.kept_weights, self.best_weights)
        if plan.steps:
            inputs, targets = self.rows.inputs[:ROWS_LOOKED_AT], self.rows.targets[:ROWS_LOOKED_AT]
            outputs = self._predicted(inputs)
            last = max(loss.item(), finite(self.loss(outputs, targets), plan.steps))
            of_zeros = self.loss(torch.zeros_like(targets), targets).item()  # the mean's
            finding = ""
            if last > RISEN * max(first.item(), of_zeros):
                finding = f"the loss rose from {first.item():.3g} to {last:.3g}"
            elif _varies(inputs) and _varies(targets) and not _varies(outputs):
                # units that a too long step made negative for every row stay so
                finding = "the network gives every row the same output"
            if finding:
                warn(f"{phase}: {finding}; {too_high}")
        curve = np.array(points, dtype=np.float64).reshape(-1, 3)
        if self.validation is None:
            return Curve(curve, plan.steps, math.nan)
        return Curve(curve, self.best_step, self.best_loss)

    def step(self, step: int) -> torch.Tensor:
        for optimizer, highest in zip(self.optimizers, self.highest, strict=True):
            for group, rate in zip(optimizer.param_groups, highest, strict=True):
                group["lr"] = rate * self.plan.rate(step)
            optimizer.zero_grad(set_to_none=True)
        loss = self._loss(step)
        loss.backward()  # type: ignore[no-untyped-call]
        for optimizer in self.optimizers:
            optimizer.step()
        return loss.detach()

    def _loss(self, step: int) -> torch.Tensor:
        inputs, targets = self._batch()
        low = self.bfloat16 and step < (1.0 - FULL_PRECISION_END) * self.plan.steps
        if self.objective is not None:
            with self._autocast(low):
                return self.objective(step / self.plan.steps, inputs, targets)
        if self.validation is not None:
            self._judge(step, self.validation)
        with self._autocast(low):
            outputs: torch.Tensor = self.network(inputs)
        return self.loss(outputs.float(), targets)

    def _autocast(self, low: bool) -> torch.autocast:
        return torch.autocast(self.device.type, dtype=torch.bfloat16, enabled=low)

    @torch.no_grad()
    def _predicted(self, inputs: torch.Tensor) -> torch.Tensor:
        """Return the outputs as in a prediction: dropout off, batch statistics fixed."""
        self.network.eval()
        outputs: torch.Tensor = self.network(inputs)
        self.network.train()
        return outputs

    @torch.no_grad()
    def _visit(self, visits: Visits, step: int) -> None:
        if step in visits:
            self.network.eval()
            visits[step]()
            self.network.train()

    def _batch(self) -> tuple[torch.Tensor, torch.Tensor]:
        batch = self.plan.batch
        if batch is None or batch >= len(self.rows):
            return self.rows.inputs, self.rows.targets
        if len(self.order) < batch:
            self.order = torch.randperm(len(self.rows), generator=self.generator)
        chosen, self.order = self.order[:batch].to(self.device), self.order[batch:]
        return self.rows.inputs[chosen], self.rows.targets[chosen]

    def _judge(self, step: int, rows: Rows) -> None:
        """Store the weights if their validation loss is the lowest so far."""
        self.validation_loss = (self._predicted(rows.inputs) - rows.targets).abs().mean().item()
        if self.validation_loss < self.best_loss or not self.best_weights:
            self.best_step, self.best_loss = step, self.validation_loss
            self.best_weights = self.best_weights or [
                torch.empty_like(t) for t in self.kept_weights
            ]
            torch._foreach_copy_(self.best_weights, self.kept_weights)


def _optimizers(
    network: torch.nn.Module,
    plan: TrainingPlan,
    trainable: Sequence[torch.nn.Parameter],
    inputs: torch.Tensor,
    *,
    bfloat16: bool,
) -> list[torch.optim.Optimizer]:
    """Return the optimizers of the `trainable` parameters.

    `inputs` are the (n, n_inputs) training inputs of `network`. `bfloat16`: low precision is
    available.
    """
    rate = plan.learning_rate
    if plan.optimizer == "sgd":
        return [torch.optim.SGD(trainable, lr=rate)]
    if plan.optimizer == "adam":
        return [torch.optim.Adam(trainable, lr=rate, fused=True)]
    trainable_set = set(trainable)
    hidden = [
        layer
        for layer in linear_layers(network)[1:-1]
        if layer.weight in trainable_set and layer.in_features == layer.out_features
    ]
    weights = {layer.weight for layer in hidden}
    other_parameters = [parameter for parameter in trainable if parameter not in weights]
    optimizers: list[torch.optim.Optimizer] = [
        torch.optim.Adam(other_parameters, lr=ADAM_RATE_BESIDE_MUON, fused=True)
    ]
    if hidden:
        optimizers.append(Muon(network, hidden, inputs, lr=rate, low_precision=bfloat16))
    return optimizers


def _varies(values: torch.Tensor) -> bool:
    return bool((values != values[0]).any())
