"""How long a cell of a study takes, for a forecast before any has been measured.

Seconds of one thread of the machine that made the committed results (results/README.md); another
machine differs, and corrects the forecast as soon as its own cells tell.
"""

from __future__ import annotations

from stiff_bench.option_word import split_word
from stiff_bench.paper.model_words import BASE_LAYERS, BASE_WIDTH

PRETRAINING_S = 28.0
"""Of 4 x 380 nodes over the recipe's 1,000 steps; it grows with layers times width squared."""
RECIPE_STEPS = 1000
SOURCE_S = 4.0
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
_DT_CNN_S = 75.0
_OTHERS_S = 0.1


def expected_s(model: str) -> float:
    """Return the expected time of a cell, s.

    Args:
        model: name with options. What `ft-mlp` goes on from is trained by another cell of a study.
    """
    key, settings = split_word(model)
    options = dict(setting.split("=", 1) for setting in settings)
    steps = float(options.get("pretrain_steps", RECIPE_STEPS)) / RECIPE_STEPS
    layers = float(options.get("layers", BASE_LAYERS)) / BASE_LAYERS
    width = float(options.get("width", BASE_WIDTH)) / BASE_WIDTH
    pretraining = SOURCE_S + PRETRAINING_S * steps * layers * width**2
    if key == "mlp-pretrained":
        return pretraining
    if key == "ft-mlp":
        own = pretraining if "source_poses" in options else SOURCE_S
        return own + FINE_TUNING_S
    if key == "dt-cnn":
        return SOURCE_S + _DT_CNN_S * steps
    if key == "deep-ensemble":
        return float(options.get("members", 5)) * (pretraining + FINE_TUNING_S)
    return _OF_KEY.get(key, _OTHERS_S)
