"""Expected outcome of every model with each hazard of `made_hazards`.

An outcome is "works", or a warning or error: a regular expression from the message's start.
"""

from __future__ import annotations

from typing import Any

from stiff_models.model_catalog import MODELS

VARIANTS: dict[str, tuple[str, dict[str, Any]]] = {
    **{info.key: (info.key, {}) for info in MODELS},
    "ft-mlp, paper": ("ft-mlp", {"preset": "paper"}),
    "vjm-multisegment, search": ("vjm-multisegment", {"breakpoints": "search"}),
    "vjm-full, ridge": ("vjm-full", {"solver": "ridge"}),
    "curve-springs, student": ("curve-springs", {"weights": "student"}),
    "dt-cnn, coral": ("dt-cnn", {"alignment": "coral"}),
    "dt-cnn, udtl": ("dt-cnn", {"preset": "udtl"}),
    "forest": ("sklearn:ensemble.RandomForestRegressor", {}),
    "ridge": ("sklearn:linear_model.Ridge", {}),
    "pls": ("sklearn:cross_decomposition.PLSRegression", {}),
    "sklearn mlp": ("sklearn:neural_network.MLPRegressor", {"max_iter": 20}),
    "vjm + neighbours": ("vjm+sklearn:neighbors.KNeighborsRegressor", {}),
}

SEGMENTS = {"vjm-multisegment", "vjm-multisegment, search"}
RESIDUAL = {"residual-mlp", "vjm-gp", "vjm-boosting", "vjm + neighbours"}
CNN = {"dt-cnn", "dt-cnn, coral", "dt-cnn, udtl"}
PRETRAINED = {
    *("mlp-pretrained", "ft-mlp", "ft-mlp, paper", "adann-2r", "compliance-net", "deep-ensemble"),
    *CNN,
}
ANCHORED = {"ft-mlp", "deep-ensemble"}
SPRINGS = {"vjm"} | RESIDUAL | PRETRAINED  # one linear spring per joint
FULL = {"vjm-full", "vjm-full, ridge"}
RIDGE = {"vjm-full, ridge", "curve-springs", "curve-springs, student"}
CURVES = {"curve-springs", "curve-springs, student"}
BAYES = {"bayes-springs"}
IDENTIFY = SPRINGS | SEGMENTS | FULL | CURVES | BAYES | {"fourier-springs"}

SLOPES = "warns: joint stiffness not identifiable from the training samples"
FEW_NEIGHBOURS = [
    ({"knn"}, "fails: neighbours is 5, but there are only "),
    ({"vjm + neighbours"}, "fails: .*n_neighbors = 5, n_samples_fit = "),
]
OTHER_LOADS = [({"ft-mlp, paper"}, "warns: .*pre-training forces are .* N, measured forces")]
NO_MASSES = [(SEGMENTS | CURVES | BAYES, "warns: robot 'chain' has no masses")]
# their teacher may have segments; rounding decides
MAY_HAVE_SEGMENTS = [*NO_MASSES, (ANCHORED, "(works|warns: robot 'chain' has no masses)")]
NOT_BOTH = [({"residual-mlp", "mlp"}, "(works|warns: .*none of 3 epochs was better)")]

Outcomes = list[tuple[set[str], str]]
"""Groups of models and their outcome; the first group with a model counts."""


def unidentifiable(joints: str, rank: int, slopes: str = SLOPES) -> Outcomes:
    springs = f"not identifiable from .*: {joints} .regressor rank {rank} of 6"
    return [(SEGMENTS, slopes), (SPRINGS, f"warns: joint stiffness {springs}")]


def few(n: int) -> Outcomes:
    return [(FULL | RIDGE, f"warns: {n} training samples give {3 * n} equations for 18 springs")]


ALL_JOINTS = "A1, A2, A3, A4, A5, A6"
PYTABKIT = ({"realmlp", "tabm"}, "fails: .*need at least 3 training samples")
ONE_ROW = [
    *FEW_NEIGHBOURS,
    PYTABKIT,
    ({"deep-ensemble"}, "fails: .*requires samples of two poses"),
    ({"dt-cnn, coral"}, "fails: alignment 'coral' .* 2 samples or more"),
    ({"pls"}, "fails: .*Found array with 1 sample"),
    *unidentifiable(ALL_JOINTS, 3),
    *few(1),
]
TWO_ROWS = [
    *FEW_NEIGHBOURS,
    PYTABKIT,
    ({"pls"}, "warns: y residual is constant"),
    ({"mlp"}, "(works|warns: none of 3 epochs was better on the validation rows)"),
    *unidentifiable(ALL_JOINTS, 3),
    *few(2),
]

OUTCOMES: dict[str, Outcomes] = {
    "wrist singular": unidentifiable(
        "(A3, )?A4, A6", 4, f"{SLOPES}: .*A4 segment 1, A4 segment 2, .*A6 segment 1"
    ),
    "1 row": ONE_ROW,
    "1 row, 1 validation": ONE_ROW,
    "2 rows": TWO_ROWS,
    "5 rows": [*unidentifiable("A4, A6", 5), *few(5), *NOT_BOTH],
    "one pose": [
        ({"deep-ensemble"}, "fails: all 32 training samples have the same pose"),
        *unidentifiable("A1, A2, A3, A4(, A6)?", 3),
    ],
    "one load": unidentifiable("A6", 5),
    "no load": [(IDENTIFY, "fails: .*no wrench turns any joint")],
    "force only along z": [
        *unidentifiable("A1, A4, A5, A6", 2),
        (IDENTIFY, "warns: no load turns A1, A4: add a horizontal pull"),
    ],
    "deflection only along z": unidentifiable("A1, A4, A6", 3),
    "rows contradict": unidentifiable("A1, A3, A4, A5, A6", 1),
    "no deflection": [
        (PRETRAINED, "fails: no pre-training data can be simulated .*every deflection is zero"),
        ({"pls"}, "warns: y residual is constant"),
        (IDENTIFY, "warns: every deflection is zero in all 32 samples"),
    ],
    "wrenches of wrong sign": [
        (PRETRAINED, "fails: no pre-training data can be simulated .*the sign .*may be wrong"),
        (RIDGE, "works"),  # their compliances may be negative
        (IDENTIFY, "warns: no joint spring explains .*the sign .*may be wrong"),
    ],
    "loads x 1e6": OTHER_LOADS,
    "loads x 1e-6": OTHER_LOADS,
    "slides and turns": MAY_HAVE_SEGMENTS,
    "slides only": [
        *MAY_HAVE_SEGMENTS,
        # a flat likelihood: rounding decides
        ({"gp"}, "(works|warns: .*likelihood search stopped)"),
    ],
    "7 joints": [*NO_MASSES, *NOT_BOTH],
}

ALWAYS = {
    "sklearn mlp": "warns: Stochastic Optimizer: Maximum iterations .20. reached",
    "vjm-multisegment, search": f"(works|{SLOPES})",  # few torques exceed a breakpoint
}

ROWS = {
    "1 row": "training samples: 1, too few",
    "2 rows": "training samples: 2, too few",
    "one pose": "all 32 training samples are of one pose",
    "one load": "all 32 training samples have one load",
    "no load": "the wrench is zero in all 32 training samples",
    "no deflection": "the deflection is zero in all 32 training samples",
    "loads x 1e6": "forces are of 5.2e.07 N .*expected 0.01 to 100000.: is the unit right",
    "loads x 1e-6": "forces are of 5.2e-05 N .*is the unit right",
    "deflections x 1e6": "deflections are of [0-9.]+e.0[23] m .*is the unit right",
}
"""Hazard -> the engine's note on its training rows, the same for every model."""


def expected(hazard: str, variant: str) -> str:
    for models, outcome in OUTCOMES.get(hazard, []):
        if variant in models:
            return outcome
    return ALWAYS.get(variant, "works")
