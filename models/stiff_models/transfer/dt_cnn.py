"""`dt-cnn`: deep transfer of a 1x1-convolution network by aligning source and target features.

The method of Zhao et al. (UDTL, IEEE TIM 2021; github.com/ZhaoZhibin/UDTL) for regression: the
network learns the simulated source domain and, from one sixth of the training on, also to give
unlabelled target inputs the features of the source.
"""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass, replace
from typing import Annotated, Literal

import numpy as np
import torch
from annotated_types import Ge

from stiff_models.networks.cache import Trained
from stiff_models.networks.features import Scaler
from stiff_models.networks.network_model import EncodedNetworkModel
from stiff_models.networks.training import Rows, train_network
from stiff_models.networks.training_plan import Trainable, TrainingPlan
from stiff_models.transfer.alignment import AlignedObjective, Alignment, uses_target
from stiff_models.transfer.cnn import Cnn, Pool, adapt_statistics, build_cnn
from stiff_models.transfer.ft_mlp import GENTLE
from stiff_models.transfer.mlp_pretrained import divided, source_errors, source_report
from stiff_models.transfer.source_model import SourceModel
from stiff_protocols.contract.errors import ModelError
from stiff_protocols.contract.types import FloatArray, Robot, Samples

SOURCE_TEST_ROWS = 4096  # of the randomly drawn test part: this network is slow to predict
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
class DtCnn(SourceModel, EncodedNetworkModel):
    """Deep-transfer CNN, in two regimes that cannot be compared; a table says in which a row is.

    Even with `supervision="none"`, as in UDTL, the training labels identify the joint stiffnesses
    that make the source, unless `source_stiffness="nominal"` or the source is another robot's.

    Attributes:
        preset: "ours" (no dropout, every feature standardised with the source's statistics) or
            "udtl" (the literal network: pooling, dropout 0.5, every sample normalised on its own).
        pool: "udtl" cannot tell apart the features of a neighbouring pair; "none" gives every
            feature its own place; "auto": the preset's.
        alignment: "none", "adabn" (batch statistics taken anew from target inputs), or the distance
            of the features: "mk-mmd", "jmmd", "coral", "dann", "rsd", "dare-gram".
        alignment_weight: weight of the distance against the loss on standardised outputs.
        supervision: "none" (no measured deflection trains the network) or "fine-tune" (all layers
            then learn from the measured training samples).
        recipe: "fast" (ours) or "udtl" (300 epochs of batches of 64: hours).
        pretrain_steps: length of the training on the source; none: the recipe's.
    """

    preset: Literal["ours", "udtl"] = "ours"
    pool: Literal["auto", "none", "udtl"] = "auto"
    alignment: Alignment = "mk-mmd"
    alignment_weight: Annotated[float, Ge(0.0)] = 1.0
    supervision: Literal["none", "fine-tune"] = "none"
    recipe: Literal["fast", "udtl"] = "fast"
    pretrain_steps: Annotated[int, Ge(0)] | None = None

    @property
    def regime(self) -> str:
        """Whether measured deflections train the network."""
        return self._unlabelled() if self.supervision == "none" else ""

    def chooses_epoch(self) -> bool:
        """Whether validation rows choose the epoch: only of the fine-tuning."""
        return self.supervision == "fine-tune"

    def _fit(self, train: Samples, robot: Robot, validation: Samples | None, seed: int) -> None:
        origin = self._origin(train, robot)
        domain = self._simulated(origin.samples, origin.robot, seed)
        learn, test = divided(domain, seed)
        self._start(origin.robot, learn.q, learn.wrench, learn.deflection, seed)
        rows = self._rows(learn.q, learn.wrench, learn.deflection)
        trained = self._transfer(rows, self._inputs(train.q, train.wrench), seed)
        self.history_ = trained.curve
        some = test.take(np.arange(min(len(test), SOURCE_TEST_ROWS)))
        self.source_errors_ = source_errors(self, learn, some)
        self.diagnostics_ = source_report(len(domain), trained.seconds, self.source_errors_)
        self.robot_ = robot  # predictions are of the target from here on
        if self.supervision == "fine-tune":
            held_out = None if validation is None else self._measured_rows(validation)
            self._fine_tune(self._measured_rows(train), held_out, seed)

    @property
    def curves_(self) -> dict[str, FloatArray]:
        """The curve of the training on the source, and of a fine-tuning."""
        found = {"pre-training": self.history_.points}
        if self.supervision == "fine-tune":
            found["fine-tuning"] = self.fine_tuning_.points
        return found

    def _transfer(self, rows: Rows, target: torch.Tensor, seed: int) -> Trained:
        """Train the network on source rows and on the (n, n_inputs) inputs of target rows."""
        plan = self._plan(len(rows))
        with _seeded(seed):
            if uses_target(self.alignment):
                trained = self._train_aligned(rows, target, plan, seed)
            else:
                trained = self._train_remembered(rows, plan, seed, "pre-train")
        if self.alignment == "adabn":
            adapt_statistics(self._cnn(), target)
        return trained

    def _train_aligned(
        self, rows: Rows, target: torch.Tensor, plan: TrainingPlan, seed: int
    ) -> Trained:
        if self.alignment == "coral" and len(target) < 2:
            raise ModelError("alignment 'coral' compares covariances: 2 training samples or more")
        objective = AlignedObjective(
            self._cnn(),
            target,
            alignment=self.alignment,
            weight=self.alignment_weight,
            loss=plan.loss,
            seed=seed,
        )
        moving = [*self.network_.parameters(), *objective.parameters()]
        return self._train_remembered(
            rows,
            plan,
            seed,
            "pre-train",
            trainable=Trainable(dict.fromkeys(moving, 1.0)),
            objective=objective,
            extra=(target,),
            about=f"{self.alignment} {self.alignment_weight!r}",
        )

    def _fine_tune(self, rows: Rows, validation: Rows | None, seed: int) -> None:
        """Train every layer on measured rows, with the batch statistics of the pre-training.

        The measured rows are few, and would move the statistics away from what the layers know.
        """
        self._cnn().freeze_statistics()
        with _seeded(seed):
            self.fine_tuning_ = train_network(
                self.network_,
                rows,
                replace(GENTLE, keep_best=validation is not None),
                seed=seed,
                phase="fine-tune",
                validation=validation,
            )

    def _start(
        self, robot: Robot, q: FloatArray, wrench: FloatArray, deflection: FloatArray, seed: int
    ) -> None:
        super()._start(robot, q, wrench, deflection, seed)
        if self.preset == "udtl":  # the network normalises each sample as it is
            n_inputs = len(self.input_scaler_.mean)
            self.input_scaler_ = Scaler(np.zeros(n_inputs), np.ones(n_inputs))

    def _cnn(self) -> Cnn:
        assert isinstance(self.network_, Cnn)  # for the type checker
        return self.network_

    def _new_network(self, seed: int) -> Cnn:
        pool: Pool = "udtl" if self.preset == "udtl" else "none"
        return build_cnn(
            len(self.input_scaler_.mean),
            pool=pool if self.pool == "auto" else self.pool,
            dropout=UDTL_DROPOUT if self.preset == "udtl" else 0.0,
            per_sample=self.preset == "udtl",
            seed=seed,
        )

    def _plan(self, n_rows: int) -> TrainingPlan:
        plan = FAST if self.recipe == "fast" else udtl_plan(n_rows)
        return plan if self.pretrain_steps is None else replace(plan, steps=self.pretrain_steps)


@contextmanager
def _seeded(seed: int) -> Iterator[None]:
    """Draw what torch's layers draw (dropout) from `seed`, and leave its random state as it was."""
    with torch.random.fork_rng():
        torch.manual_seed(seed)
        yield
