"""Freeze strategies of fine-tuning: the layers that move in each stage.

Written as in ``freeze=layers:1,2``. Hidden layers count from 1; ``out`` is the output layer.

========================  ========================================================================
``layers:1,2``            only hidden layers 1 and 2 (the source paper's); any set, also ``out``
``full``                  every layer
``head``                  only the output layer
``first:k``, ``last:k``   the first or last k layers; the output layer counts as the last
``lp-ft``                 the output layer for half of the epochs, then every layer
========================  ========================================================================
"""

from __future__ import annotations

from dataclasses import dataclass

from stiff_protocols.contract.errors import ConfigError

VALID = "layers:1,2 (hidden layers from 1, out), first:k, last:k, full, head, lp-ft"


@dataclass(frozen=True)
class Stage:
    """Epochs in which the same layers move; layers count from 0, the last is the output layer."""

    epochs: int
    layers: tuple[int, ...]


def stages(freeze: str, *, hidden_layers: int, epochs: int) -> tuple[Stage, ...]:
    """Return the stages of a strategy, see above; `epochs` is the total of all stages.

    Raises:
        ConfigError: the strategy or the layer does not exist.
    """
    every = tuple(range(hidden_layers + 1))
    head = every[-1:]
    name, _, argument = freeze.partition(":")
    if freeze == "lp-ft":
        return Stage(epochs // 2, head), Stage(epochs - epochs // 2, every)
    if freeze in ("full", "head"):
        return (Stage(epochs, every if freeze == "full" else head),)
    if name in ("first", "last") and argument:
        count = _number(freeze, argument, len(every))
        return (Stage(epochs, every[:count] if name == "first" else every[-count:]),)
    if named := named_layers(freeze):
        numbers = {
            hidden_layers if word == "out" else _number(freeze, word, hidden_layers) - 1
            for word in named
        }
        return (Stage(epochs, tuple(sorted(numbers))),)
    raise ConfigError(f"freeze={freeze!r}: unknown strategy (valid: {VALID})")


def named_layers(freeze: str) -> tuple[str, ...]:
    """Return the layers of a strategy ``layers:...``, as written; () for other strategies."""
    name, _, argument = freeze.partition(":")
    return tuple(argument.split(",")) if name == "layers" and argument else ()


def _number(freeze: str, text: str, largest: int) -> int:
    if not text.isdecimal() or not 1 <= int(text) <= largest:
        raise ConfigError(
            f"freeze={freeze!r}: the network does not have the layer {text!r} "
            f"(valid here: 1..{largest}{', out' if freeze.startswith('layers') else ''})"
        )
    return int(text)
