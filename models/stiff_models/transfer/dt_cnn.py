"""`dt-cnn`: a 1x1-convolution network pre-trained on simulated samples; alignment on request.

With an `alignment` it is the method of Zhao et al. (UDTL, IEEE TIM 2021;
github.com/ZhaoZhibin/UDTL) for regression: the network learns the simulated source domain and,
from one sixth of the training on, also to give unlabelled target inputs the features of the source.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Annotated, Literal

import numpy as np
from annotated_types import Ge

from stiff_models.networks.encoded_model import Scaler
from stiff_models.networks.training import Loss, TrainingPlan
from stiff_models.transfer.alignment import AlignedObjective, Alignment, uses_target
from stiff_models.transfer.cnn import Cnn, Pool, adapt_statistics, build_cnn
from stiff_models.transfer.pretraining import PretrainedModel
from stiff_protocols.contract.errors import ModelError
from stiff_protocols.contract.types import FloatArray, Robot, Samples

UDTL_EPOCHS, UDTL_BATCH, UDTL_DROPOUT = 300, 64, 0.5

FAST = TrainingPlan(
    steps=3000,
    learning_rate=2e-3,
    loss="huber",
    optimizer="adam",
    batch=256,
    schedule="linear",
    mixed_precision=True,
)

# the rate is its own: ft-mlp's was chosen for ft-mlp
FINE_TUNING = TrainingPlan(steps=400, learning_rate=3e-4, loss="mae", optimizer="adam")


def udtl_plan(n_source: int) -> TrainingPlan:
    """Return UDTL's training over `n_source` rows; mean squared error for its cross-entropy."""
    return TrainingPlan(
        steps=UDTL_EPOCHS * -(-n_source // UDTL_BATCH),
        learning_rate=1e-3,
        loss="mse",
        optimizer="adam",
        batch=UDTL_BATCH,
        schedule="steps",
        weight_decay=1e-5,
    )


@dataclass(kw_only=True, eq=False, repr=False)
class DtCnn(PretrainedModel):
    """Deep-transfer CNN, in two regimes that cannot be compared; a table says in which a row is.

    Even with `supervision="none"`, as in UDTL, the training labels identify the joint stiffnesses
    that make the source, unless `source_stiffness="nominal"` or the source is another robot's.

    Attributes:
        preset: "ours" (no dropout, every feature standardised with the source's statistics) or
            "udtl" (the literal network: pooling, dropout 0.5, every sample normalised on its own)
            or "paper" (our network on the source domain of the source paper's Tables 4 and 5).
        pool: "udtl" cannot tell apart the features of a neighbouring pair; "none" gives every
            feature its own place; "auto": the preset's.
        alignment: "none", "adabn" (batch statistics taken anew from target inputs), or the distance
            of the features: "mk-mmd", "coral", "dann".
        alignment_weight: weight of the distance against the loss on standardised outputs.
        supervision: "none" (no measured deflection trains the network) or "fine-tune" (all layers
            then learn from the measured training samples, for a number of epochs that
            cross-validation chooses).
        recipe: "fast" (ours) or "udtl" (300 epochs of batches of 64: hours).
    """

    preset: Literal["ours", "udtl", "paper"] = "ours"
    pool: Literal["auto", "none", "udtl"] = "auto"
    alignment: Alignment = "none"
    alignment_weight: Annotated[float, Ge(0.0)] = 1.0
    supervision: Literal["none", "fine-tune"] = "none"
    recipe: Literal["fast", "udtl"] = "fast"

    @property
    def regime(self) -> str:
        """Whether measured deflections train the network."""
        return self._unlabelled() if self.supervision == "none" else ""

    @property
    def paper_source(self) -> bool:
        """With the paper's preset."""
        return self.preset == "paper"

    @property
    def shares_pretraining(self) -> bool:
        """Whether a pre-training serves all training parts: not where it sees their inputs."""
        return not uses_target(self.alignment) and super().shares_pretraining

    def _fit(self, train: Samples, robot: Robot, validation: Samples | None, seed: int) -> None:
        super()._fit(train, robot, validation, seed)
        if self.alignment == "adabn":
            adapt_statistics(self._cnn(), self._inputs(train.q, train.wrench))
        if self.supervision == "fine-tune":
            # measured rows are few, and would move the statistics away from what the layers know
            self._cnn().freeze_statistics()
            (curve,) = self._learn_measured(train, None, FINE_TUNING, seed, "cv")
            self.curves_["fine-tuning"] = curve.points

    def _objective(self, train: Samples, loss: Loss, seed: int) -> AlignedObjective | None:
        if not uses_target(self.alignment):
            return None
        target = self._inputs(train.q, train.wrench)
        if self.alignment == "coral" and len(target) < 2:
            raise ModelError("alignment 'coral' compares covariances: 2 training samples or more")
        return AlignedObjective(
            self._cnn(),
            target,
            alignment=self.alignment,
            weight=self.alignment_weight,
            loss=loss,
            seed=seed,
        )

    def _take_statistics(self, q: FloatArray, wrench: FloatArray, deflection: FloatArray) -> None:
        super()._take_statistics(q, wrench, deflection)
        if self.preset == "udtl":  # the network normalises each sample as it is
            n_inputs = len(self.input_scaler_.mean)
            self.input_scaler_ = Scaler(np.zeros(n_inputs), np.ones(n_inputs))

    def _cnn(self) -> Cnn:
        assert isinstance(self.network_, Cnn)  # for the type checker
        return self.network_

    def _new_network(self, n_inputs: int, seed: int, n_outputs: int = 3) -> Cnn:
        pool: Pool = "udtl" if self.preset == "udtl" else "none"
        return build_cnn(
            n_inputs,
            pool=pool if self.pool == "auto" else self.pool,
            dropout=UDTL_DROPOUT if self.preset == "udtl" else 0.0,
            per_sample=self.preset == "udtl",
            seed=seed,
            n_outputs=n_outputs,
        )

    def _recipe_plan(self, n_rows: int) -> TrainingPlan:
        return FAST if self.recipe == "fast" else udtl_plan(n_rows)
