"""`residual-mlp`: the virtual joint model, and a network of what it leaves."""

from __future__ import annotations

from dataclasses import dataclass

import torch

from stiff_models.networks.mlp import Mlp
from stiff_models.networks.torch_parts import SumOf, VjmModule
from stiff_models.regressors.on_physics import OnPhysics
from stiff_protocols.contract.errors import ConfigError


@dataclass(kw_only=True, eq=False, repr=False)
class ResidualMlp(OnPhysics, Mlp):
    """Physics plus a network from scratch on the residuals."""

    def _torch_module(self) -> torch.nn.Module:
        if self.physics != "vjm":
            raise ConfigError(f"physics {self.physics!r} has no ONNX form (valid: vjm)")
        springs = VjmModule(self.robot_, self.physics_.springs_.compliance)
        return SumOf([springs, super()._torch_module()])
