"""Whitened Muon: orthogonalise each layer's momentum for white inputs before each step.

K. Jordan et al., "Muon: an optimizer for hidden layers in neural networks" (2024), bounds the
change of a layer's outputs by a step W -> W - lr D equally for inputs of any direction. Inputs of a
hidden layer are far from white. With A = E[x x^T] = L L^T we orthogonalise the gradient G L^-T for
the white inputs L^-1 x, and use D = orth(G L^-T) L^-1. For the curvature of the loss only in A, see
F. Benzing, "Gradient descent on neurons" (ICML 2022).
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from contextlib import contextmanager

import torch

MOMENTUM = 0.95
EVERY = 3  # each matrix moves in every third step: orthogonalising costs as much as a batch
ITERATIONS = 3
_QUINTIC = (3.4445, -4.7750, 2.0315)
"""Newton-Schulz polynomial of the reference: drives all singular values towards 1."""

WHITENED_EVERY = 50  # steps between two estimates of A
WHITENED_ROWS = 1024  # rows of an estimate of A
DAMPING = 0.1  # added to A's eigenvalues, in units of their mean


class Muon(torch.optim.Optimizer):
    """Muon for the weights of hidden layers.

    Args:
        network: network in training.
        layers: layers of the network whose weights move.
        inputs: (n, n_inputs) inputs of the training rows, to estimate A.
        lr: step length: root of the mean square of a weight's change, times the root of the width.
        low_precision: orthogonalise in bfloat16; it affects only the step's direction.
    """

    def __init__(
        self,
        network: torch.nn.Module,
        layers: Sequence[torch.nn.Linear],
        inputs: torch.Tensor,
        *,
        lr: float,
        low_precision: bool,
    ) -> None:
        """Store what the steps need."""
        super().__init__([layer.weight for layer in layers], {"lr": lr})
        self._network, self._layers = network, layers
        self._sample = inputs[:: max(1, len(inputs) // WHITENED_ROWS)][:WHITENED_ROWS]
        self._dtype = torch.bfloat16 if low_precision else torch.float32
        self._steps = 0

    @torch.no_grad()
    def step(self, closure: None = None) -> None:  # type: ignore[override]
        """Update every average gradient, and move every third weight matrix."""
        if self._steps % WHITENED_EVERY == 0:
            inputs = layer_inputs(self._network, self._layers, self._sample)
            self._whitening = [whitening(layer_input).to(self._dtype) for layer_input in inputs]
        (group,) = self.param_groups
        for number, (weight, white) in enumerate(
            zip(group["params"], self._whitening, strict=True)
        ):
            direction = self._averaged_gradient(weight).to(self._dtype)
            if number % EVERY == self._steps % EVERY:
                direction = (orthogonalised(direction @ white.T) @ white).to(weight.dtype)
                length = group["lr"] * len(weight) ** 0.5
                weight.sub_(direction * (length / direction.norm().clamp_min(1e-12)))
        self._steps += 1

    def _averaged_gradient(self, weight: torch.Tensor) -> torch.Tensor:
        """Return Nesterov's average."""
        assert weight.grad is not None  # for the type checker; every layer is part of the loss
        average = self.state[weight].setdefault("average", torch.zeros_like(weight))
        average.lerp_(weight.grad, 1.0 - MOMENTUM)
        return weight.grad.lerp(average, MOMENTUM)


def layer_inputs(
    network: torch.nn.Module, layers: Sequence[torch.nn.Module], inputs: torch.Tensor
) -> list[torch.Tensor]:
    """Return the input of each layer for the network's `inputs`."""
    input_by_layer: dict[torch.nn.Module, torch.Tensor] = {}

    def record_input(layer: torch.nn.Module, arguments: tuple[torch.Tensor, ...]) -> None:
        input_by_layer[layer] = arguments[0]

    handles = [layer.register_forward_pre_hook(record_input) for layer in layers]
    network(inputs)
    for handle in handles:
        handle.remove()
    return [input_by_layer[layer] for layer in layers]


def whitening(inputs: torch.Tensor) -> torch.Tensor:
    """Return L^-1, (n, n), of the damped second moment L L^T of (k, n) inputs."""
    moment = inputs.T @ inputs / len(inputs)
    n = len(moment)
    moment.diagonal().add_(DAMPING * moment.trace() / n + 1e-12)
    eye = torch.eye(n, dtype=moment.dtype, device=moment.device)
    with _one_thread():  # LAPACK's rounding depends on the number of threads
        factor = torch.linalg.cholesky_ex(moment).L  # NaN gives NaN, which the loss will show
        white: torch.Tensor = torch.linalg.solve_triangular(factor, eye, upper=False)
    return white


@contextmanager
def _one_thread() -> Iterator[None]:
    threads = torch.get_num_threads()
    torch.set_num_threads(1)
    try:
        yield
    finally:
        torch.set_num_threads(threads)


def orthogonalised(matrix: torch.Tensor) -> torch.Tensor:
    """Return a more nearly orthogonal (n, n) matrix with the same singular vectors."""
    a, b, c = _QUINTIC
    x: torch.Tensor = matrix / matrix.norm().clamp_min(1e-12)
    for _ in range(ITERATIONS):
        gram = x @ x.T
        x = torch.addmm(x, torch.addmm(gram, gram, gram, beta=b, alpha=c), x, beta=a)
    return x
