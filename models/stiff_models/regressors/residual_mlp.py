"""`residual-mlp`: the virtual joint model, and a network of what it leaves."""

from __future__ import annotations

from dataclasses import dataclass

import torch

from stiff_models.networks.mlp import Mlp
from stiff_models.networks.torch_parts import SumOf, physics_module
from stiff_models.regressors.on_physics import OnPhysics


@dataclass(kw_only=True, eq=False, repr=False)
class ResidualMlp(OnPhysics, Mlp):
    """Physics plus a network from scratch on the residuals."""

    def _torch_module(self) -> torch.nn.Module:
        return SumOf([physics_module(self.physics_), super()._torch_module()])
