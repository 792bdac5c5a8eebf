"""`ft-mlp`: pre-trained on the simulated source domain, fine-tuned on the measurements.

The method of the source paper: VJM identified on the training part -> source domain ->
pre-training -> fine-tuning of the layers that a freeze strategy leaves free, on the mean
absolute error.
"""

from __future__ import annotations

import copy
import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Annotated, Literal

import numpy as np
import torch
from annotated_types import Ge

from stiff_models.networks.mlp import Epochs, LearningRate, Selection
from stiff_models.networks.network import linear_layers
from stiff_models.networks.training import Curve, Rows, train_network
from stiff_models.networks.training_plan import Trainable, TrainingPlan
from stiff_models.transfer.freeze import Stage, stages
from stiff_models.transfer.mlp_pretrained import MlpPretrained, Recipe
from stiff_protocols.contract.types import FloatArray, Robot, Samples

_FAST = TrainingPlan(steps=400, learning_rate=1e-3, loss="mae", optimizer="adam", schedule="linear")
# for networks of other kinds, in which every layer moves
GENTLE = TrainingPlan(steps=300, learning_rate=3e-4, loss="mae", optimizer="adam")
FINE_TUNING: dict[Recipe, TrainingPlan] = {
    "fast": _FAST,
    "best": _FAST,
    # exactly the paper's: rate 0.03, 50,000 epochs, mean absolute error; plain gradient descent
    "paper": TrainingPlan(steps=50_000, learning_rate=0.03, loss="mae", optimizer="sgd"),
}


@dataclass(kw_only=True, eq=False, repr=False)
class FtMlp(MlpPretrained):
    """Fine-tuned MLP.

    Attributes:
        freeze: layers that fine-tuning trains: "layers:1,2" (hidden layers from 1, "out" for the
            output layer; any set), "first:k", "last:k", "full", "head", "gradual",
            "discriminative", "l2sp", "lp-ft", "bias".
        training: "best" keeps the best epoch on the validation rows, "normal" the last.
        epochs: epochs of fine-tuning; none: the recipe's.
        learning_rate: learning rate of fine-tuning; none: the recipe's.
        precision: of matrix products in fine-tuning: "float32", or "bfloat16" where the device has
            it, which is faster; losses then differ by about 1 %.
        unfreeze_every: epochs between two layers of freeze="gradual".
        l2sp_alpha: strength of the penalty of freeze="l2sp", on the weights that the
            standardised network has.
    """

    freeze: str = "layers:1,2"
    training: Selection = "best"
    epochs: Epochs | None = None
    learning_rate: LearningRate | None = None
    precision: Literal["float32", "bfloat16"] = "float32"
    unfreeze_every: Annotated[int, Ge(1)] = 50
    l2sp_alpha: Annotated[float, Ge(0.0)] = 1.0

    @property
    def regime(self) -> str:
        """Nothing to say: the network learns from the measured deflections."""
        return ""

    def check_params(self) -> None:
        """Raise ConfigError where there is no such device, or no such layer to train."""
        super().check_params()
        self._stages(epochs=1)

    def chooses_epoch(self) -> bool:
        """Whether validation rows choose the epoch."""
        return self.training == "best"

    def _fit(self, train: Samples, robot: Robot, validation: Samples | None, seed: int) -> None:
        self.check_params()
        super()._fit(train, robot, None, seed)
        self.source_network_ = copy.deepcopy(self.network_)
        rows = self._measured_rows(train)
        held_out = None if validation is None else self._measured_rows(validation)
        plan = self._fine_tuning_plan(keep_best=held_out is not None)
        self.fine_tuning_ = fine_tune(
            self.network_, rows, plan, self._stages(plan.steps), validation=held_out, seed=seed
        )
        learned = np.abs(self.predict(train.q, train.wrench) - train.deflection)
        self.diagnostics_ |= {
            "training MAE [mm]": float(learned.mean()) * 1000.0,  # of all axes together
            "training STDE [mm]": float(learned.std()) * 1000.0,
        }

    @property
    def curves_(self) -> dict[str, FloatArray]:
        """The pre-training's curve and that of each stage of the fine-tuning."""
        found = super().curves_
        for number, curve in enumerate(self.fine_tuning_, start=1):
            stage = "" if len(self.fine_tuning_) == 1 else f" {number}"
            found[f"fine-tuning{stage}"] = curve.points
        return found

    def _fine_tuning_plan(self, *, keep_best: bool) -> TrainingPlan:
        plan = self._fine_tuning_recipe()
        return replace(
            plan,
            steps=plan.steps if self.epochs is None else self.epochs,
            learning_rate=plan.learning_rate if self.learning_rate is None else self.learning_rate,
            keep_best=keep_best and self.training == "best",
            mixed_precision=self.precision == "bfloat16",
        )

    def _fine_tuning_recipe(self) -> TrainingPlan:
        return FINE_TUNING[self.recipe]

    def _stages(self, epochs: int) -> tuple[Stage, ...]:
        return stages(
            self.freeze,
            hidden_layers=self.layers,
            epochs=epochs,
            unfreeze_every=self.unfreeze_every,
            l2sp_alpha=self.l2sp_alpha,
        )


def fine_tune(
    network: torch.nn.Module,
    rows: Rows,
    plan: TrainingPlan,
    steps: Sequence[Stage],
    *,
    validation: Rows | None,
    seed: int,
) -> list[Curve]:
    """Train `network` in place, stage after stage, and return each stage's curve.

    A stage goes on from the weights that the stage before kept; with `plan.keep_best` the best
    weights of all stages are put back at the end.
    """
    curves = []
    best_loss, best_weights = math.inf, copy.deepcopy(network.state_dict())
    for number, stage in enumerate(steps):
        phase = "fine-tune" if len(steps) == 1 else f"fine-tune {number + 1}/{len(steps)}"
        curve = train_network(
            network,
            rows,
            replace(plan, steps=stage.epochs),
            seed=seed,
            phase=phase,
            trainable=_trainable(network, stage),
            validation=validation,
        )
        curves.append(curve)
        if curve.best_loss < best_loss:
            best_loss, best_weights = curve.best_loss, copy.deepcopy(network.state_dict())
    if plan.keep_best:
        network.load_state_dict(best_weights)
    return curves


def _trainable(network: torch.nn.Module, stage: Stage) -> Trainable:
    rates: dict[torch.Tensor, float] = {}
    for number, layer in enumerate(linear_layers(network)):
        if number in stage.rates:
            rates[layer.bias] = stage.rates[number]
            if not stage.biases_only:
                rates[layer.weight] = stage.rates[number]
    return Trainable(rates, stage.pull)
