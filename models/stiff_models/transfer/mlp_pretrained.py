"""`mlp-pretrained`: the base network trained on the simulated source domain alone.

It sees the measurements only through the VJM that is identified on the training part and
supplies the source domain's deflections; with another robot's source it does not see them at all.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Annotated, Literal

import numpy as np
import torch
from annotated_types import Ge

from stiff_models.base import FittedModel
from stiff_models.networks.network import Activation
from stiff_models.networks.network_model import NetworkModel
from stiff_models.networks.training_plan import TrainingPlan
from stiff_models.transfer.source import SourceDomain
from stiff_models.transfer.source_model import SourceModel
from stiff_protocols.contract.types import AXES, FloatArray, Robot, Samples

Recipe = Literal["fast", "best", "paper"]

SOURCE_TRAIN_SHARE = 0.7  # source paper: 70 % train, 30 % test, at random
SOURCE_ERRORS = (
    *(f"test MAE {axis.upper()}" for axis in AXES),
    "training MAE",
    "training STDE",
    "test MAE",
    "test STDE",
)

_FAST = TrainingPlan(
    steps=1000,
    learning_rate=0.04,
    loss="huber",
    optimizer="muon",
    batch=1024,
    schedule="linear",
    mixed_precision=True,
)
PRETRAINING: dict[Recipe, TrainingPlan] = {
    "fast": _FAST,
    "best": replace(_FAST, steps=4000),
    # The paper gives 100,000 iterations and the mean squared error; optimizer, rate and batch
    # are not stated. Ours: Adam at its usual rate and 256 samples.
    "paper": TrainingPlan(
        steps=100_000, learning_rate=1e-3, loss="mse", optimizer="adam", batch=256
    ),
}


@dataclass(kw_only=True, eq=False, repr=False)
class MlpPretrained(SourceModel, NetworkModel):
    """Pre-training on the source domain.

    Attributes:
        recipe: "fast" (ours, 1,000 steps: half a minute of one core), "best" (4,000 steps, with
            GELU unless `activation` says otherwise: two minutes, and a tenth of the error on the
            source) or "paper" (the paper's schedule of 100,000 iterations).
        pretrain_steps: length of the pre-training; none: the recipe's.
    """

    recipe: Recipe = "fast"
    pretrain_steps: Annotated[int, Ge(0)] | None = None

    @property
    def regime(self) -> str:
        """No measured deflection trains the network."""
        return self._unlabelled()

    def _fit(self, train: Samples, robot: Robot, validation: Samples | None, seed: int) -> None:
        origin = self._origin(train, robot)
        domain = self._simulated(origin.samples, origin.robot, seed)
        learn, test = divided(domain, seed)
        self._start(origin.robot, learn.q, learn.wrench, learn.deflection, seed)
        trained = self._train_remembered(
            self._rows(learn.q, learn.wrench, learn.deflection),
            self._pretraining_plan(),
            seed,
            "pre-train",
            judge=lambda: source_errors(self, learn, test),
            extra=map(torch.from_numpy, (test.q, test.wrench, test.deflection)),
        )
        self.history_ = trained.curve
        self.source_errors_ = trained.judged
        self.diagnostics_ = source_report(len(domain), trained.seconds, self.source_errors_)
        self.robot_ = robot  # predictions are of the target from here on

    @property
    def curves_(self) -> dict[str, FloatArray]:
        """The pre-training's curve."""
        return {"pre-training": self.history_.points}

    @property
    def hidden_activation(self) -> Activation:
        """The option's activation, or the recipe's."""
        by_recipe = self.activation == "auto" and self.recipe == "best"
        return "gelu" if by_recipe else super().hidden_activation

    def _pretraining_plan(self) -> TrainingPlan:
        plan = PRETRAINING[self.recipe]
        return plan if self.pretrain_steps is None else replace(plan, steps=self.pretrain_steps)


def divided(domain: SourceDomain, seed: int) -> tuple[SourceDomain, SourceDomain]:
    """Return a random 70 % of a source domain, to learn from, and the rest, to test on."""
    order = np.random.default_rng(seed).permutation(len(domain))
    n_train = round(SOURCE_TRAIN_SHARE * len(domain))
    return domain.take(order[:n_train]), domain.take(order[n_train:])


def source_errors(model: FittedModel, learn: SourceDomain, test: SourceDomain) -> FloatArray:
    """Return a fitted model's (7,) errors on the source, m; `SOURCE_ERRORS` names them.

    Those without an axis are over the samples and axes together, as in the source paper's Tables
    6 and 7. Of the training part, no more samples are predicted than the test part has.
    """
    learn = learn.take(np.arange(min(len(learn), len(test))))
    learned, tested = (
        np.abs(model.predict(part.q, part.wrench) - part.deflection) for part in (learn, test)
    )
    together = [value for errors in (learned, tested) for value in (errors.mean(), errors.std())]
    return np.array([*tested.mean(axis=0), *together])


def source_report(n_samples: int, seconds: float, errors: FloatArray) -> dict[str, float]:
    """Return the diagnostics of a pre-training, from its wall time and (7,) errors, m."""
    return {
        "source samples": float(n_samples),
        "pre-training time, also of a cached one [s]": seconds,
    } | {
        f"source {name} [mm]": float(error) * 1000.0
        for name, error in zip(SOURCE_ERRORS, errors, strict=True)
    }
