"""The models that the source paper's tables and figures compare, with their options."""

from __future__ import annotations

from collections.abc import Sequence
from itertools import combinations, pairwise
from pathlib import Path
from typing import Literal

from stiff_bench.store.names import Variant

VJM, FT_MLP, DT_CNN, MLP_PRETRAINED = "vjm", "ft-mlp", "dt-cnn", "mlp-pretrained"
MULTI_SEGMENT = "vjm-multisegment"
"""Not in the paper: joints whose springs change their slope, as the gears' catalogue has them."""
FT_MLP_LAST_EPOCH = Variant(FT_MLP, {"training": "normal"})
"""Table 9's "normal": the weights after the last epoch."""
FT_MLP_OWN_SOURCE = Variant(FT_MLP, {"source_poses": "data", "source_wrenches": "data"})
"""Pre-trained on poses and loads like the training samples' in place of the paper's Tables 4, 5."""

BASE_LAYERS, BASE_WIDTH = 4, 380
"""Of the paper's network, and of ours by default."""
EARLY_STEPS = 100
"""Of 256 samples each; chosen afterwards: our networks of Table 6 then have about its MAEs."""
BEST_PAIR = "layers:1,2"
"""What the paper unfreezes, and what ours does by default."""
Activation = Literal["sigmoid", "tanh", "relu"]
ACTIVATIONS: tuple[Activation, ...] = ("sigmoid", "tanh", "relu")
"""Of the source paper's Table 7; "relu" is the default."""


def pretrained(
    *,
    layers: int = BASE_LAYERS,
    width: int = BASE_WIDTH,
    activation: Activation = "relu",
    stopped_early: bool = False,
) -> Variant:
    """Return a network that learns the source domain alone.

    Args:
        layers: how many hidden ones.
        width: nodes a hidden layer.
        activation: of the hidden layers.
        stopped_early: it is trained as the paper's recipe says (plain Adam, mean squared error),
            but for `EARLY_STEPS` alone, after which the MAEs of Table 6 are near the paper's.
    """
    options = {
        "activation": (activation, "relu"),
        "layers": (layers, BASE_LAYERS),
        "pretrain_steps": (EARLY_STEPS if stopped_early else None, None),
        "recipe": ("paper" if stopped_early else "fast", "fast"),
        "width": (width, BASE_WIDTH),
    }
    changed = {name: value for name, (value, usual) in options.items() if value != usual}
    return Variant(MLP_PRETRAINED, changed)


def unfrozen(layers: Sequence[str]) -> Variant:
    """Return the fine-tuned network whose `layers` move, such as ("1", "2", "out")."""
    freeze = f"layers:{','.join(layers)}"
    return Variant(FT_MLP, {} if freeze == BEST_PAIR else {"freeze": freeze})


HIDDEN_LAYERS = tuple(str(number) for number in range(1, BASE_LAYERS + 1))
SINGLE_LAYERS = tuple((layer,) for layer in HIDDEN_LAYERS)
ADJACENT_PAIRS = tuple(pairwise(HIDDEN_LAYERS))
ALL_SINGLES = (*SINGLE_LAYERS, ("out",))
ALL_PAIRS = tuple(combinations((*HIDDEN_LAYERS, "out"), 2))

PAPER_RESULTS = Path("results/paper/runs")
