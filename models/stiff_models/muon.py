"""Muon: momentum whose matrices are orthogonalised before each step.

K. Jordan et al., "Muon: an optimizer for hidden layers in neural networks" (2024). It needs far
fewer steps than Adam on the hidden layers here. torch has its own since 2.9; this one serves
older releases too, and works on all equally shaped matrices in one batched product.
"""

from __future__ import annotations

from collections.abc import Iterable

import torch

MOMENTUM = 0.95
ITERATIONS = 5
_QUINTIC = (3.4445, -4.7750, 2.0315)
"""Newton-Schulz polynomial of the reference: drives all singular values towards 1."""


class Muon(torch.optim.Optimizer):
    """Muon for square matrices of one shape.

    Args:
        parameters: the hidden layers' weights, each (width, width).
        lr: step length; every step has this size times an orthogonal matrix.
        low_precision: orthogonalise in bfloat16 (accurate enough: the step's direction alone
            depends on it).
    """

    def __init__(
        self, parameters: Iterable[torch.Tensor], *, lr: float, low_precision: bool
    ) -> None:
        """Store the step length."""
        super().__init__(list(parameters), {"lr": lr})
        self._dtype = torch.bfloat16 if low_precision else torch.float32

    @torch.no_grad()
    def step(self, closure: None = None) -> None:  # type: ignore[override]
        """Move every weight by one orthogonalised, Nesterov-averaged gradient."""
        for group in self.param_groups:
            weights = [weight for weight in group["params"] if weight.grad is not None]
            if not weights:
                continue
            directions = torch.stack([self._averaged_gradient(weight) for weight in weights])
            for weight, direction in zip(
                weights, orthogonalised(directions.to(self._dtype)), strict=True
            ):
                weight.add_(direction.to(weight.dtype), alpha=-group["lr"])

    def _averaged_gradient(self, weight: torch.Tensor) -> torch.Tensor:
        assert weight.grad is not None  # for the type checker; `step` has filtered
        average = self.state[weight].setdefault("average", torch.zeros_like(weight))
        average.lerp_(weight.grad, 1.0 - MOMENTUM)
        return weight.grad.lerp(average, MOMENTUM)


def orthogonalised(matrices: torch.Tensor) -> torch.Tensor:
    """Return, for (k, n, n) matrices, nearly orthogonal ones with the same singular vectors."""
    a, b, c = _QUINTIC
    size = matrices.flatten(1).norm(dim=1).clamp_min(1e-7)
    x: torch.Tensor = matrices / size[:, None, None]
    for _ in range(ITERATIONS):
        gram = x @ x.mT
        x = torch.baddbmm(x, torch.baddbmm(gram, gram, gram, beta=b, alpha=c), x, beta=a)
    return x
