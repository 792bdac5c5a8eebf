"""`mlp`: the base network from scratch on the measured training samples; `residual-mlp`."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Annotated

import torch
from annotated_types import Ge, Gt

from stiff_models.networks.network_model import ChoosesEpochs, NetworkModel
from stiff_models.networks.onnx_export import SumOf, physics_module
from stiff_models.networks.training import TrainingPlan
from stiff_models.physics.vjm import OnPhysics
from stiff_protocols.contract.errors import warn
from stiff_protocols.contract.types import Robot, Samples

Epochs = Annotated[int, Ge(0)]
LearningRate = Annotated[float, Gt(0.0)]


@dataclass(kw_only=True, eq=False, repr=False)
class Mlp(ChoosesEpochs, NetworkModel):
    """MLP from scratch, full-batch Adam on the mean absolute error.

    Attributes:
        epochs: number of epochs, or the most to choose from.
        learning_rate: constant learning rate of Adam.
    """

    epochs: Epochs = 1000
    learning_rate: LearningRate = 1e-3

    def _fit(self, train: Samples, robot: Robot, validation: Samples | None, seed: int) -> None:
        self._start(robot, train.q, train.wrench, train.deflection, seed)
        plan = TrainingPlan(self.epochs, self.learning_rate, loss="mae", optimizer="adam")
        (curve,) = self._learn_measured(train, validation, plan, seed, self.training)
        self.curves_ = {"training": curve.points}
        if curve.best_step == 0 and len(curve.points):
            warn(
                f"none of {self.epochs} epochs was better on the validation rows than the "
                "untrained network, which is used; try a learning rate below "
                f"{self.learning_rate:g}"
            )


@dataclass(kw_only=True, eq=False, repr=False)
class ResidualMlp(OnPhysics, Mlp):
    """Physics plus a network from scratch on the residuals."""

    def _torch_module(self) -> torch.nn.Module:
        return SumOf([physics_module(self.physics_), super()._torch_module()])
