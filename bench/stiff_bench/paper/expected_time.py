"""How long a cell of a study takes, for a forecast before any has been measured.

Seconds of one thread of the machine that made the committed results (results/README.md); another
machine differs, and corrects the forecast as soon as its own cells tell.
"""

from __future__ import annotations

from stiff_bench.option_word import split_word
from stiff_bench.paper.model_words import BASE_LAYERS, BASE_WIDTH

STEP_S = 0.0025
"""Of a step of pre-training, whatever the network and the batch."""
PRODUCTS_S = 25.0
"""Of 1,000 steps of 1,024 samples of 4 x 380 nodes, beside it: it grows with the batch, and with
layers times width squared."""
RECIPES = {"fast": (1000, 1024), "best": (4000, 1024), "paper": (100_000, 256)}
"""Recipe -> steps and batch of a pre-training."""
SOURCE_S = 1.5
"""The simulated source domain, and the errors on it."""
FINE_TUNING_S = 4.0
_OF_KEY = {
    "mlp": 6.0,
    "residual-mlp": 6.0,
    "compliance-net": 8.0,
    "mf-gp": 5.0,
    "vjm-boosting": 2.0,
    "gp": 1.0,
    "vjm-gp": 1.0,
    "realmlp": 20.0,
    "tabm": 40.0,
    "tabpfn": 20.0,
}
_DT_CNN_S, DT_CNN_STEPS = 95.0, 3000
_OTHERS_S = 0.1


def expected_s(model: str) -> float:
    """Return the expected time of a cell, s.

    Args:
        model: name with options. What `ft-mlp` goes on from is trained by an earlier cell of the
            paper's study; with a number of steps of its own, as in the leaderboard's, it is
            trained by a cell that runs at the same time, and so by both.
    """
    key, settings = split_word(model)
    options = dict(setting.split("=", 1) for setting in settings)
    steps, batch = RECIPES.get(options.get("recipe", "fast"), RECIPES["fast"])
    steps = int(options.get("pretrain_steps", steps))
    layers = float(options.get("layers", BASE_LAYERS)) / BASE_LAYERS
    width = float(options.get("width", BASE_WIDTH)) / BASE_WIDTH
    products_s = PRODUCTS_S * steps / 1000 * batch / 1024 * layers * width**2
    pretraining = SOURCE_S + STEP_S * steps + products_s
    if key == "mlp-pretrained":
        return pretraining
    if key == "ft-mlp":
        own = {"source_poses", "pretrain_steps"} & options.keys()
        return (pretraining if own else SOURCE_S) + FINE_TUNING_S
    if key == "dt-cnn":
        steps = int(options.get("pretrain_steps", DT_CNN_STEPS))
        return SOURCE_S + _DT_CNN_S * steps / DT_CNN_STEPS
    if key == "deep-ensemble":
        return float(options.get("members", 5)) * (pretraining + FINE_TUNING_S)
    return _OF_KEY.get(key, _OTHERS_S)
