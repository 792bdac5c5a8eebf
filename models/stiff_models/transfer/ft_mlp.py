"""`ft-mlp`: pre-trained on the simulated source domain, fine-tuned on the measurements.

The method of the source paper: VJM identified on the training part -> source domain ->
pre-training -> fine-tuning of the layers that a freeze strategy leaves free, on the mean
absolute error. Ours is anchored: fine-tuning starts from the best of three VJMs; see
`pretrained_mlp.py`.
"""

from __future__ import annotations

import copy
from dataclasses import dataclass, replace
from types import MappingProxyType
from typing import Self

import numpy as np
import torch

from stiff_models.networks.fully_connected import linear_layers
from stiff_models.networks.mlp import Epochs, LearningRate
from stiff_models.networks.network_model import ChoosesEpochs
from stiff_models.networks.training import Curve, Rows, TrainingPlan, Visits, train_network
from stiff_models.transfer.freeze_strategies import Stage, stages
from stiff_models.transfer.pretrained_mlp import PretrainedMlp, Recipe
from stiff_protocols.contract.record import TEACHER_EPOCHS
from stiff_protocols.contract.types import Robot, Samples

_FAST = TrainingPlan(steps=400, learning_rate=1e-4, loss="mae", optimizer="adam")
FINE_TUNING: dict[Recipe, TrainingPlan] = {
    "fast": _FAST,
    "best": _FAST,
    # exactly the paper's: rate 0.03, 50,000 epochs, mean absolute error; plain gradient descent
    "paper": TrainingPlan(steps=50_000, learning_rate=0.03, loss="mae", optimizer="sgd"),
}


@dataclass(kw_only=True, eq=False, repr=False)
class FtMlp(ChoosesEpochs, PretrainedMlp):
    """Pre-trained MLP that is fine-tuned on the measured samples.

    Attributes:
        freeze: layers that fine-tuning trains: "layers:1,2" (hidden layers from 1, "out" for the
            output layer; any set), or another strategy of docs/models.md.
        epochs: epochs of fine-tuning, or the most to choose from; none: the recipe's.
        learning_rate: learning rate of fine-tuning; none: the recipe's.
    """

    freeze: str = "layers:1,2"
    epochs: Epochs | None = None
    learning_rate: LearningRate | None = None

    @property
    def regime(self) -> str:
        """Empty: the network learns from the measured deflections."""
        return ""

    def check_params(self) -> None:
        """Raise ConfigError if the device or a layer to train does not exist."""
        super().check_params()
        self._stages(epochs=1)

    def _fit(self, train: Samples, robot: Robot, validation: Samples | None, seed: int) -> None:
        self.check_params()
        super()._fit(train, robot, None, seed)
        self.source_network_ = copy.deepcopy(self.network_)
        plan = self._fine_tuning_plan()
        curves = self._learn_measured(train, validation, plan, seed, self.training)
        for number, curve in enumerate(curves, start=1):
            stage = "" if len(curves) == 1 else f" {number}"
            self.curves_[f"fine-tuning{stage}"] = curve.points
        if self.is_anchored:
            self.diagnostics_[TEACHER_EPOCHS] = float(sum(curve.best_step for curve in curves))
        learned = np.abs(self.predict(train.q, train.wrench) - train.deflection)
        self.diagnostics_ |= {
            "training MAE [mm]": float(learned.mean()) * 1000.0,  # of all axes together
            "training STDE [mm]": float(learned.std()) * 1000.0,
        }

    def _learn(
        self,
        network: torch.nn.Module,
        rows: Rows,
        plan: TrainingPlan,
        seed: int,
        *,
        validation: Rows | None = None,
        visits: Visits = MappingProxyType({}),
    ) -> list[Curve]:
        """Train a network in place, stage after stage; `visits` count the steps of each.

        A stage starts from the weights that the previous stage kept. `plan.keep_best` can also
        choose these weights.
        """
        strategy, curves = self._stages(plan.steps), []
        for number, stage in enumerate(strategy):
            which = "" if len(strategy) == 1 else f" {number + 1}/{len(strategy)}"
            layers = linear_layers(network)
            curve = train_network(
                network,
                rows,
                replace(plan, steps=stage.epochs),
                seed=seed,
                phase=f"fine-tune{which}",
                trainable=[p for number in stage.layers for p in layers[number].parameters()],
                validation=validation,
                visits=visits,
            )
            curves.append(curve)
        return curves

    def _n_stages(self) -> int:
        return len(self._stages(epochs=1))

    def _fine_tuning_plan(self) -> TrainingPlan:
        plan = FINE_TUNING[self.recipe]
        return replace(
            plan,
            steps=plan.steps if self.epochs is None else self.epochs,
            learning_rate=plan.learning_rate if self.learning_rate is None else self.learning_rate,
        )

    def _stages(self, epochs: int) -> tuple[Stage, ...]:
        return stages(self.freeze, hidden_layers=self.layers, epochs=epochs)

    def fine_tuned_on(self, train: Samples, validation: Samples | None, seed: int) -> Self:
        """Return a copy of this fitted model, fine-tuned from its pre-training on other samples.

        Its teacher is also identified on them. With training="cv" the chosen number of epochs is
        used again.
        """
        copied_model, plan, training = copy.copy(self), self._fine_tuning_plan(), self.training
        if training == "cv":
            plan, training = replace(plan, steps=self.best_params_["epochs"]), "normal"
        copied_model.teacher_ = self._teacher_of(train)
        copied_model.network_ = copy.deepcopy(self.source_network_)
        copied_model._learn_measured(train, validation, plan, seed, training)
        return copied_model
