"""Define the models of the source paper, as in results/studies/paper.toml.

Every option that changes a number of the paper's tables and figures is named, also defaults.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from itertools import combinations, pairwise
from typing import Any

from stiff_bench.store.names import Variant

DATASET = "kr10-twin"
"""The simulation in place of the paper's robot."""
PAPER_PROTOCOL, FAIR_PROTOCOL = "paper-holdout", "holdout"
"""The paper's split, with the epoch picked on the test part; and the split without this."""
READ_ON_ALL = "paper-holdout@read_on=all"
"""The paper's split, tested on all samples; most likely the basis of the paper's Table 10."""
SEED = 0
METRICS = ("mae", "stde", "me")

PAPER_SOURCE: Mapping[str, Any] = {"preset": "paper"}
"""Pre-trained on the poses and wrenches of the paper's Tables 4 and 5; by default, on poses and
loads in the training samples' ranges."""
PAPER_RECIPE: Mapping[str, Any] = {"recipe": "paper"}
"""100,000 iterations of pre-training, then 50,000 of fine-tuning."""

VJM = Variant("vjm")
FT_MLP = Variant("ft-mlp", {**PAPER_SOURCE, "training": "best"})
"""At the epoch that is best on the validation rows: Table 9's "optimized"."""
FT_MLP_LAST_EPOCH = Variant("ft-mlp", {**PAPER_SOURCE, "training": "normal"})
"""Table 9's "normal"."""
FT_MLP_OWN_SOURCE = Variant("ft-mlp", {"anchor": "none", "training": "best"})
FT_MLP_PAPER_RECIPE = Variant("ft-mlp", {**FT_MLP.options, **PAPER_RECIPE})
FT_MLP_PAPER_RECIPE_LAST_EPOCH = Variant("ft-mlp", {**FT_MLP_LAST_EPOCH.options, **PAPER_RECIPE})
DT_CNN = Variant("dt-cnn", {"alignment": "none", "supervision": "none"})
"""The paper's section 5.3: "directly predicting the target domain after training in the source"."""

BASE_LAYERS, BASE_WIDTH = 4, 380
"""Size of the paper's network, and our default."""
SWEEP_STEPS = 1000
"""Steps of the networks compared by size and activation: half the default, to save time."""
EARLY_STEPS = 100
"""Steps of 256 samples, chosen afterwards: our networks then have about the MAEs of Table 6."""
DEPTH_WIDTH = 100
BY_DEPTH = {str(depth): {"layers": depth, "width": DEPTH_WIDTH} for depth in (2, 3, 4, 5, 6)}
"""Row of the paper's Table 6 -> options of `pretrained`."""
BY_ACTIVATION: dict[str, dict[str, Any]] = {
    **{kind: {"activation": kind} for kind in ("sigmoid", "tanh")},
    "relu": {},
}
"""Row of the paper's Table 7 -> options of `pretrained`, whose default is ReLU."""
WIDTHS, WIDTH_DEPTHS = tuple(range(40, 401, 20)), (3, 4, 5)
"""Figure 5a and b."""


def pretrained(*, stopped_early: bool = False, **options: Any) -> Variant:
    """Return a network trained only on the source domain, with options such as `layers=3`.

    With `stopped_early` it is trained by the paper's recipe (plain Adam, mean squared error), but
    only for `EARLY_STEPS`. After these steps the MAEs of Table 6 are near the paper's.
    """
    early = {"pretrain_steps": EARLY_STEPS, **PAPER_RECIPE}
    training = early if stopped_early else {"pretrain_steps": SWEEP_STEPS}
    return Variant("mlp-pretrained", {**PAPER_SOURCE, **options, **training})


def unfrozen(layers: Sequence[str]) -> Variant:
    """Return the fine-tuned network whose `layers` move, such as ("1", "2", "out")."""
    return Variant("ft-mlp", {**FT_MLP.options, "freeze": f"layers:{','.join(layers)}"})


HIDDEN_LAYERS = ("1", "2", "3", "4")
SINGLE_LAYERS = tuple((layer,) for layer in HIDDEN_LAYERS)
ADJACENT_PAIRS = tuple(pairwise(HIDDEN_LAYERS))
ALL_SINGLES = (*SINGLE_LAYERS, ("out",))
ALL_PAIRS = tuple(combinations((*HIDDEN_LAYERS, "out"), 2))
