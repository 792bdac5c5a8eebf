"""Fine-tuning: epochs a second beside the textbook loop in plain torch, and how many are needed."""

from __future__ import annotations

import copy
from dataclasses import dataclass, replace

import numpy as np
import pytest
import torch
from joblib import Parallel, delayed, parallel_config

from perf_case import figure, ours, peer
from stiff_datasets.kr10_twin import Kr10Twin
from stiff_models.freeze import Stage, stages
from stiff_models.ft_mlp import FINE_TUNING, FtMlp, fine_tune
from stiff_models.networks import has_fast_bfloat16, linear_layers
from stiff_models.training import Rows
from stiff_models.training_plan import TrainingPlan
from stiff_protocols.protocol import Holdout, PaperHoldout

EPOCHS = 100
PLAIN = "plain eager torch"
PAPER_LAYERS = "layers:1,2"
UPPER_LAYERS = "layers:3,4,out"  # the features below can be computed once

SAME_LOSS = 2e-3
"""Relative difference of two loss curves that are the same up to the rounding of float32 sums."""
NEAR_LOSS = 5e-2
"""The same where the products are in bfloat16, which has 8 bits."""


@dataclass(frozen=True, eq=False)
class Work:
    """A fine-tuning: a pre-trained network, 121 rows to learn from and 30 to choose the epoch."""

    network: torch.nn.Module
    rows: Rows
    held_out: Rows
    freeze: str = PAPER_LAYERS

    def plan(self, *, bfloat16: bool = False, epochs: int = EPOCHS) -> TrainingPlan:
        fast = FINE_TUNING["fast"]
        return replace(fast, steps=epochs, mixed_precision=bfloat16, keep_best=True)

    def arguments(self, plan: TrainingPlan) -> tuple[torch.nn.Module, Rows, TrainingPlan, object]:
        """A new copy of the network each time, because it is trained in place."""
        return copy.deepcopy(self.network), self.rows, plan, self.stages(plan.steps)

    def stages(self, epochs: int) -> tuple[Stage, ...]:
        return stages(self.freeze, hidden_layers=4, epochs=epochs, unfreeze_every=1, l2sp_alpha=0.0)
