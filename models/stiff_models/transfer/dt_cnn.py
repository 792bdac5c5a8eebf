"""`dt-cnn`: a 1x1-convolution network pre-trained on simulated samples; alignment on request.

With an `alignment` it is the method of Zhao et al. (UDTL, IEEE TIM 2021;
github.com/ZhaoZhibin/UDTL) for regression: the network learns the simulated source domain. After
one sixth of the training it also aligns features of unlabelled target inputs with the source's.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Annotated, Literal

import numpy as np
from annotated_types import Ge

from stiff_models.networks.encoded_model import Scaler
from stiff_models.networks.training import Loss, TrainingPlan
from stiff_models.transfer.alignment import AlignedObjective, Alignment, uses_target
from stiff_models.transfer.cnn import Cnn, adapt_statistics, build_cnn
from stiff_models.transfer.pretraining import PretrainedModel
from stiff_protocols.contract.errors import ModelError
from stiff_protocols.contract.types import FloatArray, Robot, Samples

UDTL_DROPOUT = 0.5

FAST = TrainingPlan(
    steps=3000,
    learning_rate=2e-3,
    loss="huber",
    optimizer="adam",
    batch=256,
    schedule="linear",
    mixed_precision=True,
)

# a separate learning rate: ft-mlp's was chosen for ft-mlp
FINE_TUNING = TrainingPlan(steps=400, learning_rate=3e-4, loss="mae", optimizer="adam")


@dataclass(kw_only=True, eq=False, repr=False)
class DtCnn(PretrainedModel):
    """Deep-transfer CNN, in two regimes that cannot be compared; tables state each row's regime.

    Even with `supervision="none"`, as in UDTL, the training labels identify the joint stiffnesses
    of the source, unless `source_stiffness="nominal"` or the source is another robot's.

    Attributes:
        preset: "ours" (no dropout, every feature standardised with the source's statistics),
            "udtl" (the literal network: pooling, dropout 0.5, every sample normalised separately)
            or "paper" (our network on the source domain of the source paper's Tables 4 and 5).
        alignment: "none", "adabn" (batch statistics recomputed from target inputs), or the distance
            of the features: "mk-mmd", "coral", "dann".
        alignment_weight: weight of the distance against the loss on standardised outputs.
        supervision: "none" (no measured deflection trains the network) or "fine-tune" (all layers
            then learn from the measured training samples, for a number of epochs that
            cross-validation chooses).
    """

    preset: Literal["ours", "udtl", "paper"] = "ours"
    alignment: Alignment = "none"
    alignment_weight: Annotated[float, Ge(0.0)] = 1.0
    supervision: Literal["none", "fine-tune"] = "none"

    @property
    def regime(self) -> str:
        """Regime of the training; "" if measured deflections train the network."""
        return self._unlabelled() if self.supervision == "none" else ""

    @property
    def paper_source(self) -> bool:
        """True with the paper's preset."""
        return self.preset == "paper"

    @property
    def shares_pretraining(self) -> bool:
        """True if all training parts share a pre-training, which then ignores their inputs."""
        return not uses_target(self.alignment) and super().shares_pretraining

    def _fit(self, train: Samples, robot: Robot, validation: Samples | None, seed: int) -> None:
        super()._fit(train, robot, validation, seed)
        if self.alignment == "adabn":
            adapt_statistics(self._cnn(), self._inputs(train.q, train.wrench))
        if self.supervision == "fine-tune":
            # the few measured rows would move the statistics away from the layers' training
            self._cnn().freeze_statistics()
            (curve,) = self._learn_measured(train, None, FINE_TUNING, seed, "cv")
            self.curves_["fine-tuning"] = curve.points

    def _objective(self, train: Samples, loss: Loss, seed: int) -> AlignedObjective | None:
        if not uses_target(self.alignment):
            return None
        target = self._inputs(train.q, train.wrench)
        if self.alignment == "coral" and len(target) < 2:
            raise ModelError("alignment 'coral' compares covariances: give 2 samples or more")
        return AlignedObjective(
            self._cnn(),
            target,
            alignment=self.alignment,
            weight=self.alignment_weight,
            loss=loss,
            seed=seed,
        )

    def _take_statistics(
        self, robot: Robot, q: FloatArray, wrench: FloatArray, deflection: FloatArray
    ) -> None:
        super()._take_statistics(robot, q, wrench, deflection)
        if self.preset == "udtl":  # the network normalises each sample itself
            n_inputs = len(self.input_scaler_.mean)
            self.input_scaler_ = Scaler(np.zeros(n_inputs), np.ones(n_inputs))

    def _cnn(self) -> Cnn:
        assert isinstance(self.network_, Cnn)  # for the type checker
        return self.network_

    def _new_network(self, n_inputs: int, seed: int, n_outputs: int = 3) -> Cnn:
        literal = self.preset == "udtl"
        return build_cnn(
            n_inputs,
            pool="udtl" if literal else "none",
            dropout=UDTL_DROPOUT if literal else 0.0,
            per_sample=literal,
            seed=seed,
            n_outputs=n_outputs,
        )

    def _recipe_plan(self) -> TrainingPlan:
        return FAST
