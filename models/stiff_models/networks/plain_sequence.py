"""Forward and backward pass of linear layers and activations in turn, without autograd.

On the few rows of a fine-tuning, autograd's bookkeeping takes a tenth of the time: it visits every
layer, rounds frozen weights anew in each pass, and walks back through validation rows that nothing
is learned from.
"""

from __future__ import annotations

import itertools
from collections.abc import Callable, Collection, Iterator
from typing import NamedTuple, Self

import torch


class _Activation(NamedTuple):
    """How an activation is applied and differentiated, in place wherever possible."""

    apply: Callable[[torch.Tensor], torch.Tensor]
    differentiate: Callable[..., torch.Tensor]  # of (slope, values[, further], grad_input=)
    of_outputs: bool  # those values are the activation's outputs, else its inputs
    further: tuple[float, ...] = ()


_ATEN = torch.ops.aten
_ACTIVATIONS = {
    repr(torch.nn.ReLU()): _Activation(
        torch.relu_, _ATEN.threshold_backward.grad_input, of_outputs=True, further=(0.0,)
    ),
    repr(torch.nn.GELU()): _Activation(
        torch.nn.functional.gelu, _ATEN.gelu_backward.grad_input, of_outputs=False
    ),
    repr(torch.nn.Tanh()): _Activation(
        torch.tanh_, _ATEN.tanh_backward.grad_input, of_outputs=True
    ),
    repr(torch.nn.Sigmoid()): _Activation(
        torch.sigmoid_, _ATEN.sigmoid_backward.grad_input, of_outputs=True
    ),
}
"""By the module with its settings, as it prints."""


class PlainSequence:
    """Passes through such a network; `backward` follows `outputs`.

    `activations` stand between the `layers`; the loss's slope is wanted for `moving` parameters.
    """

    def __init__(
        self,
        layers: list[torch.nn.Linear],
        activations: list[torch.nn.Module],
        moving: Collection[torch.Tensor],
    ) -> None:
        """Store the layers."""
        self._layers = layers
        self._activations = [_ACTIVATIONS[repr(activation)] for activation in activations]
        self._moving = [(layer.weight in moving, layer.bias in moving) for layer in layers]
        self._first = next(i for i, either in enumerate(self._moving) if any(either))
        self._low: list[tuple[torch.Tensor, torch.Tensor]] = []
        self._kept: list[torch.Tensor] = []  # what each activation's derivative needs
        self._inputs: list[torch.Tensor] = []  # of each layer

    @classmethod
    def of(cls, network: torch.nn.Module, moving: Collection[torch.Tensor]) -> Self | None:
        """Return the passes of a network; None: it has other parts, or nothing in it moves."""
        if type(network) is not torch.nn.Sequential or len(network) % 2 == 0:
            return None
        layers, activations = list(network)[::2], list(network)[1::2]
        plain = all(
            type(layer) is torch.nn.Linear and layer.bias is not None for layer in layers
        ) and all(repr(activation) in _ACTIVATIONS for activation in activations)
        if not plain or not any(parameter in moving for parameter in network.parameters()):
            return None
        return cls(layers, activations, moving)  # type: ignore[arg-type]

    @torch.no_grad()
    def outputs(self, inputs: torch.Tensor, *, bfloat16: bool) -> torch.Tensor:
        """Return the (n, n_outputs) outputs in float32 of (n, n_inputs) inputs."""
        x = inputs.bfloat16() if bfloat16 else inputs
        self._kept, self._inputs = [], []
        for (weight, bias), activation in itertools.zip_longest(
            self._parameters(bfloat16), self._activations
        ):
            self._inputs.append(x)
            x = torch.addmm(bias, x, weight.T)
            if activation is not None:
                before, x = x, activation.apply(x)
                self._kept.append(x if activation.of_outputs else before)
        return x.float()

    @torch.no_grad()
    def backward(self, slope: torch.Tensor) -> None:
        """Set the gradient of every moving parameter.

        Args:
            slope: (k, n_outputs) of the loss at the outputs of the first k rows; those of the
                others are 0.
        """
        k = len(slope)
        bfloat16 = self._inputs[0].dtype == torch.bfloat16
        slope = slope.to(self._inputs[0].dtype)
        parameters = self._low if bfloat16 else [*self._parameters(bfloat16=False)]
        for i in reversed(range(self._first, len(self._layers))):
            if i < len(self._activations):
                activation, values = self._activations[i], self._kept[i][:k]
                activation.differentiate(slope, values, *activation.further, grad_input=slope)
            layer, (weight_moves, bias_moves) = self._layers[i], self._moving[i]
            if weight_moves:
                layer.weight.grad = (slope.T @ self._inputs[i][:k]).float()
            if bias_moves:
                layer.bias.grad = slope.sum(dim=0, dtype=torch.float32)
            if i > self._first:
                slope = slope @ parameters[i][0]

    def _parameters(self, bfloat16: bool) -> Iterator[tuple[torch.Tensor, torch.Tensor]]:
        """Yield weight and bias of each layer; in bfloat16, those that moved are rounded anew."""
        exact = [(layer.weight, layer.bias) for layer in self._layers]
        if not bfloat16:
            return iter(exact)
        if not self._low:
            self._low = [(weight.bfloat16(), bias.bfloat16()) for weight, bias in exact]
        for both, rounded, moves in zip(exact, self._low, self._moving, strict=True):
            for value, low, moving in zip(both, rounded, moves, strict=True):
                if moving:
                    low.copy_(value)
        return iter(self._low)
