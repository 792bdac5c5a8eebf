"""`mlp`: the base network trained from scratch on the measured training samples alone."""

from __future__ import annotations

import warnings
from dataclasses import dataclass
from typing import Annotated, Literal

from annotated_types import Ge, Gt

from stiff_models.networks.network_model import NetworkModel
from stiff_models.networks.training import train_network
from stiff_models.networks.training_plan import TrainingPlan
from stiff_protocols.contract.errors import StiffBenchWarning
from stiff_protocols.contract.types import FloatArray, Robot, Samples

Epochs = Annotated[int, Ge(0)]
LearningRate = Annotated[float, Gt(0.0)]
Selection = Literal["best", "normal"]


@dataclass(kw_only=True, eq=False, repr=False)
class Mlp(NetworkModel):
    """MLP from scratch, full-batch Adam on the mean absolute error.

    Attributes:
        epochs: length of the training.
        learning_rate: constant learning rate of Adam.
        training: "best" keeps the best epoch on the validation rows, "normal" the last.
    """

    epochs: Epochs = 1000
    learning_rate: LearningRate = 1e-3
    training: Selection = "best"

    @property
    def curves_(self) -> dict[str, FloatArray]:
        """The training's curve."""
        return {"training": self.history_.points}

    def chooses_epoch(self) -> bool:
        """Whether validation rows choose the epoch."""
        return self.training == "best"

    def _fit(self, train: Samples, robot: Robot, validation: Samples | None, seed: int) -> None:
        self._start(robot, train.q, train.wrench, train.deflection, seed)
        self.history_ = train_network(
            self.network_,
            self._measured_rows(train),
            TrainingPlan(
                steps=self.epochs,
                learning_rate=self.learning_rate,
                loss="mae",
                optimizer="adam",
                keep_best=self.training == "best",
            ),
            seed=seed,
            phase="train",
            validation=None if validation is None else self._measured_rows(validation),
        )
        if self.history_.best_step < min(self.epochs, 1):
            warnings.warn(
                f"none of {self.epochs} epochs was better on the validation rows than the "
                "untrained network, which is kept; is a learning rate of "
                f"{self.learning_rate:g} too high?",
                StiffBenchWarning,
                stacklevel=3,
            )
