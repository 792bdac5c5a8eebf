"""The closed form of a serial chain in torch, for export and for learning.

It is `stiff_models.physics.chain`'s, on tensors; gradients flow through it.
"""

from __future__ import annotations

from collections.abc import Sequence

import torch

from stiff_models.physics.chain import Chain, Component
from stiff_protocols.contract.types import Robot


class TorchJacobian(torch.nn.Module):
    """Geometric Jacobian at the TCP, base frame, differentiable, in the dtype of its input."""

    def __init__(self, robot: Robot) -> None:
        """Take the constants of `robot`."""
        super().__init__()
        self.chain = Chain.of(robot)

    def forward(self, q: torch.Tensor) -> torch.Tensor:
        """Return the Jacobian.

        Args:
            q: (n, n_joints) joint positions, rad or m, of any floating dtype.

        Returns:
            (n, 6, n_joints): rows 0..2 translation [m/rad or m/m], rows 3..5 rotation.
        """
        columns = self.chain.columns(q.unbind(dim=1), cos_sin)
        return torch.stack([stacked([*move, *turn], q) for move, turn in columns], dim=2)


def cos_sin(angle: torch.Tensor) -> tuple[torch.Tensor, torch.Tensor]:
    """Return the cosine and the sine of an angle [rad]."""
    return torch.cos(angle), torch.sin(angle)


def stacked(components: Sequence[Component], q: torch.Tensor) -> torch.Tensor:
    """Return components, of which some may be plain numbers, as (n, n_components)."""
    # a sum, not `expand`: a stride of zero makes torch.export take n for a constant
    zero = torch.zeros_like(q[:, 0])
    return torch.stack([zero + component for component in components], dim=1)
