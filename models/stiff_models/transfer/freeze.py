"""Freeze strategies of fine-tuning: which layers move, when, and how fast.

Written as in ``freeze=layers:1,2``. Hidden layers count from 1; ``out`` is the output layer.

========================  ========================================================================
``layers:1,2``            hidden layers 1 and 2 alone (the source paper's); any set, also ``out``
``full``                  every layer
``head``                  the output layer alone
``first:k``, ``last:k``   the first or last k layers; the output layer counts as the last
``gradual``               from the output layer down, one more layer every `unfreeze_every` epochs
``discriminative``        every layer; the rate falls by 2.6 a layer downwards (Howard and Ruder)
``l2sp``                  every layer, with the penalty alpha/2 |w - w0|^2 (Li et al. 2018)
``lp-ft``                 the output layer for half of the epochs, then every layer
``bias``                  the biases of every layer
``lora:r``                an update of rank r of every hidden layer's weights (Hu et al. 2021)
========================  ========================================================================
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

from stiff_protocols.contract.errors import ConfigError

DISCRIMINATIVE_FACTOR = 2.6
VALID = (
    "layers:1,2 (hidden layers from 1, out), first:k, last:k, lora:r, full, head, gradual, "
    "discriminative, l2sp, lp-ft, bias"
)


@dataclass(frozen=True)
class Stage:
    """A stretch of epochs in which the same layers move.

    Attributes:
        epochs: its length.
        rates: layer number from 0 (the last is the output layer) -> factor on the learning rate.
        biases_only: the weights stay.
        pull: alpha of the l2sp penalty; 0: none.
        rank: of an update of the weights, which alone moves; 0: the weights themselves move.
    """

    epochs: int
    rates: dict[int, float]
    biases_only: bool = False
    pull: float = 0.0
    rank: int = 0


def stages(
    freeze: str, *, hidden_layers: int, epochs: int, unfreeze_every: int, l2sp_alpha: float
) -> tuple[Stage, ...]:
    """Return the stages of a strategy, see above; ConfigError for no such strategy or layer.

    `epochs` are those of all stages together, `unfreeze_every` is of `gradual`, `l2sp_alpha` of
    `l2sp`.
    """
    out = hidden_layers
    everything = dict.fromkeys(range(out + 1), 1.0)
    name, _, argument = freeze.partition(":")
    if name in ("layers", "first", "last") and argument:
        chosen = _layers(freeze, name, argument, hidden_layers)
        return (Stage(epochs, dict.fromkeys(chosen, 1.0)),)
    if name == "lora" and argument.isdecimal() and int(argument) > 0:
        return (Stage(epochs, dict.fromkeys(range(out), 1.0), rank=int(argument)),)
    falling = {layer: DISCRIMINATIVE_FACTOR ** (layer - out) for layer in everything}
    plain = {
        "full": (Stage(epochs, everything),),
        "head": (Stage(epochs, {out: 1.0}),),
        "bias": (Stage(epochs, everything, biases_only=True),),
        "l2sp": (Stage(epochs, everything, pull=l2sp_alpha),),
        "discriminative": (Stage(epochs, falling),),
        "lp-ft": (Stage(epochs // 2, {out: 1.0}), Stage(epochs - epochs // 2, everything)),
        "gradual": tuple(_gradual(out, epochs, unfreeze_every)),
    }
    if argument or freeze not in plain:
        raise ConfigError(f"freeze={freeze!r}: no such strategy (valid: {VALID})")
    return plain[freeze]


def named_layers(freeze: str) -> tuple[str, ...]:
    """Return the layers that a strategy ``layers:...`` names, as written; () for another one."""
    name, _, argument = freeze.partition(":")
    return tuple(argument.split(",")) if name == "layers" and argument else ()


def _gradual(out: int, epochs: int, unfreeze_every: int) -> Iterator[Stage]:
    for lowest in range(out, -1, -1):
        length = epochs if lowest == 0 else min(unfreeze_every, epochs)
        yield Stage(length, dict.fromkeys(range(lowest, out + 1), 1.0))
        epochs -= length


def _layers(freeze: str, name: str, argument: str, hidden_layers: int) -> list[int]:
    if name != "layers":
        count = _number(freeze, argument, hidden_layers + 1)
        everything = list(range(hidden_layers + 1))
        return everything[:count] if name == "first" else everything[-count:]
    chosen = {
        hidden_layers if word == "out" else _number(freeze, word, hidden_layers) - 1
        for word in named_layers(freeze)
    }
    return sorted(chosen)


def _number(freeze: str, text: str, largest: int) -> int:
    if not text.isdecimal() or not 1 <= int(text) <= largest:
        raise ConfigError(
            f"freeze={freeze!r}: {text!r} is no layer of a network with these layers "
            f"(valid here: 1..{largest}{', out' if freeze.startswith('layers') else ''})"
        )
    return int(text)
