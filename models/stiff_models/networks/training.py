"""The one training loop: pre-training, fine-tuning and training from scratch all run here."""

from __future__ import annotations

import math
import warnings
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from types import MappingProxyType

import numpy as np
import torch

from stiff_models.networks.arithmetic import arithmetic
from stiff_models.networks.optimizers import optimizers, pull_back
from stiff_models.networks.training_plan import Trainable, TrainingPlan, loss_function
from stiff_protocols.contract.errors import ModelError, StiffBenchWarning
from stiff_protocols.contract.progress import report
from stiff_protocols.contract.types import FloatArray, IntArray

RISEN = 10.0
"""So many times both the first loss and that of outputs of zero: the training has diverged."""
ROWS_LOOKED_AT = 256  # at the end, for signs of divergence

Objective = Callable[[float, torch.Tensor, torch.Tensor], torch.Tensor]
"""Takes the progress of the training (0 at its first step, towards 1), inputs (n, n_features) and
standardised targets (n, 3); returns the loss."""

Visits = Mapping[int, Callable[[], None]]
"""Number of steps -> what is called then."""

PRETRAINING_VERSION = 2
"""Part of the name under which a finished training is kept. Raise it with every change after which
the same network, rows, plan and seed give other weights or other errors on the source: in this
loop, the optimizers, the losses, the alignments, a network's forward pass, `source_errors`."""

FULL_PRECISION_END = 0.1  # share of the steps that mixed precision leaves to float32
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
    """What happened in a training.

    Attributes:
        points: (n_points, 3) recorded steps: number, loss before the step, and mean absolute error
            of the validation rows (standardised; NaN: no rows).
        best_step: the step whose weights were kept (the last one without validation rows).
        best_loss: its validation loss; NaN where there are no validation rows.
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
    trainable: Trainable | None = None,
    validation: Rows | None = None,
    objective: Objective | None = None,
    visits: Visits = MappingProxyType({}),
) -> Curve:
    """Train `network` in place; it is in train mode meanwhile, and in eval mode afterwards.

    Args:
        network: maps (n, n_features) inputs to (n, 3) outputs.
        rows: what it learns from.
        plan: how.
        seed: of the batches' order and of what layers draw.
        phase: name for progress reports.
        trainable: which parameters move; None: all of the network's.
        validation: rows that choose the step when the plan keeps the best; never learned from. The
            network has no batch statistics and no dropout then, and no other `objective`.
        objective: what is minimised; None: the plan's loss on the network's outputs.
        visits: what is called after so many steps, from 0, with the network in eval mode.

    Raises:
        ModelError: the loss became NaN or infinite.
    """
    trainable = trainable or Trainable.all_of(network)
    for parameter in network.parameters():
        parameter.requires_grad_(parameter in trainable.rates)
    held_out = validation if plan.keep_best else None
    kind = arithmetic(rows.inputs.device, mixed_precision=plan.mixed_precision)
    with kind.in_force(), torch.random.fork_rng():
        torch.manual_seed(seed)  # what layers draw: dropout
        run = _Run(network, rows, plan, trainable, held_out, seed, objective, kind.bfloat16)
        curve = _steps(run, plan, trainable, phase, visits)
    network.eval()
    return curve


def _steps(
    run: _Run,
    plan: TrainingPlan,
    trainable: Trainable,
    phase: str,
    visits: Visits,
) -> Curve:
    origin = [each.detach().clone() for each in trainable.rates] if trainable.pull else []
    too_high = f"a learning rate of {plan.learning_rate:g} is too high here"

    def finite(loss: torch.Tensor, steps: int) -> float:
        value = loss.item()
        if not math.isfinite(value):
            raise ModelError(f"{phase}: the loss is {value} after {steps} steps; {too_high}")
        return value

    report(phase, 0, plan.steps)
    run.network.train()
    first = loss = torch.tensor(0.0)
    for step in range(plan.steps):
        run.visited(visits, step)
        loss = run.step(step)
        first = loss if step == 0 else first
        if origin:
            pull_back(origin, trainable, plan.learning_rate * plan.rate(step))
        if (step + 1) % REPORT_EVERY == 0 or step + 1 == plan.steps:
            value = finite(loss, step + 1)
            run.points.append((step + 1, value, run.validation_loss))
            report(phase, step + 1, plan.steps, value)
    run.visited(visits, plan.steps)
    curve = run.finish()
    if plan.steps:
        inputs, targets = run.rows.inputs[:ROWS_LOOKED_AT], run.rows.targets[:ROWS_LOOKED_AT]
        outputs = run.predicted(inputs)
        last = max(loss.item(), finite(run.loss(outputs, targets), plan.steps))
        of_zeros = run.loss(torch.zeros_like(targets), targets).item()  # which predict the mean
        finding = ""
        if last > RISEN * max(first.item(), of_zeros):
            finding = f"the loss rose from {first.item():.3g} to {last:.3g}"
        elif _varies(inputs) and _varies(targets) and not _varies(outputs):
            # units that a step too far has pushed below zero for every row stay there for ever
            finding = "the network gives every row the same output"
        if finding:
            warnings.warn(f"{phase}: {finding}; {too_high}", StiffBenchWarning, stacklevel=4)
    return curve


class _Run:
    """State of one call of `train_network`."""

    def __init__(
        self,
        network: torch.nn.Module,
        rows: Rows,
        plan: TrainingPlan,
        trainable: Trainable,
        validation: Rows | None,
        seed: int,
        objective: Objective | None,
        bfloat16: bool,
    ) -> None:
        self.network = network
        self.plan = plan
        self.device = rows.inputs.device
        self.bfloat16 = bfloat16
        self.objective = objective
        self.tail, before = (
            _split_at_first_moving(network, trainable)
            if objective is None
            else (network, torch.nn.Sequential())
        )
        self.rows = _through(before, rows)
        self.validation = None if validation is None else _through(before, validation)
        self.loss = loss_function(plan.loss)
        self.optimizers = optimizers(
            self.tail, plan, trainable, self.rows.inputs, bfloat16=self.bfloat16
        )
        self.highest = [[g["lr"] for g in opt.param_groups] for opt in self.optimizers]
        self.generator = torch.Generator().manual_seed(seed)
        self.order = torch.empty(0, dtype=torch.int64)
        self.kept = [tensor.detach() for tensor in trainable.rates]
        self.points: list[tuple[float, float, float]] = []
        self.validation_loss = math.nan
        self.best_step, self.best_loss = 0, math.inf
        self.best_weights: list[torch.Tensor] = []

    def step(self, step: int) -> torch.Tensor:
        for optimizer, highest in zip(self.optimizers, self.highest, strict=True):
            for group, rate in zip(optimizer.param_groups, highest, strict=True):
                group["lr"] = rate * self.plan.rate(step)
            optimizer.zero_grad(set_to_none=True)
        loss = self._gradients(step)
        for optimizer in self.optimizers:
            optimizer.step()
        return loss.detach()

    def _gradients(self, step: int) -> torch.Tensor:
        """Set the gradients of a batch's loss and return that loss."""
        inputs, targets = self._batch()
        low = self.bfloat16 and step < (1.0 - FULL_PRECISION_END) * self.plan.steps
        if self.objective is not None:
            with self._autocast(low):
                loss = self.objective(step / self.plan.steps, inputs, targets)
        else:
            n = len(targets)
            if self.validation is not None:  # one pass serves both
                inputs = torch.cat([inputs, self.validation.inputs])
            with self._autocast(low):
                outputs: torch.Tensor = self.tail(inputs)
            outputs = outputs.float()
            if self.validation is not None:
                self._judge(step, outputs[n:].detach())
            loss = self.loss(outputs[:n], targets)
        loss.backward()  # type: ignore[no-untyped-call]
        return loss

    def _autocast(self, low: bool) -> torch.autocast:
        return torch.autocast(self.device.type, dtype=torch.bfloat16, enabled=low)

    def predicted(self, inputs: torch.Tensor) -> torch.Tensor:
        """Return the outputs as a prediction has them: dropout off, batch statistics fixed."""
        self.network.eval()
        with torch.no_grad():
            outputs: torch.Tensor = self.tail(inputs)
        self.network.train()
        return outputs

    def visited(self, visits: Visits, step: int) -> None:
        """Call what is to be called after so many steps."""
        if step in visits:
            self.network.eval()
            with torch.no_grad():
                visits[step]()
            self.network.train()

    def finish(self) -> Curve:
        """Judge the last weights, put the best ones back, and return what happened."""
        points = np.array(self.points, dtype=np.float64).reshape(-1, 3)
        if self.validation is None:
            return Curve(points, self.plan.steps, math.nan)
        self._judge(self.plan.steps, self.predicted(self.validation.inputs))
        torch._foreach_copy_(self.kept, self.best_weights)
        return Curve(points, self.best_step, self.best_loss)

    def _batch(self) -> tuple[torch.Tensor, torch.Tensor]:
        batch = self.plan.batch
        if batch is None or batch >= len(self.rows):
            return self.rows.inputs, self.rows.targets
        if len(self.order) < batch:
            self.order = torch.randperm(len(self.rows), generator=self.generator)
        chosen, self.order = self.order[:batch].to(self.device), self.order[batch:]
        return self.rows.inputs[chosen], self.rows.targets[chosen]

    def _judge(self, step: int, outputs: torch.Tensor) -> None:
        """Remember the weights if the validation rows were never predicted better."""
        assert self.validation is not None  # for the type checker
        self.validation_loss = (outputs - self.validation.targets).abs().mean().item()
        if self.validation_loss < self.best_loss or not self.best_weights:
            self.best_step, self.best_loss = step, self.validation_loss
            self.best_weights = self.best_weights or [torch.empty_like(t) for t in self.kept]
            torch._foreach_copy_(self.best_weights, self.kept)


def _varies(values: torch.Tensor) -> bool:
    return bool((values != values[0]).any())


def _split_at_first_moving(
    network: torch.nn.Module, trainable: Trainable
) -> tuple[torch.nn.Module, torch.nn.Sequential]:
    """Return the part from the first moving layer on, and the frozen part before it.

    A network that is no plain sequence, or has batch statistics, stays whole.
    """
    if not isinstance(network, torch.nn.Sequential) or [*network.buffers()]:
        return network, torch.nn.Sequential()
    for index, module in enumerate(network):
        if any(parameter in trainable.rates for parameter in module.parameters()):
            modules = list(network)
            return torch.nn.Sequential(*modules[index:]), torch.nn.Sequential(*modules[:index])
    return torch.nn.Sequential(), network


def _through(part: torch.nn.Sequential, rows: Rows) -> Rows:
    """Pass rows through the frozen part once, instead of once a step."""
    if len(part) == 0:
        return rows
    with torch.no_grad():
        return Rows(part(rows.inputs), rows.targets)
