"""What has to be run for the paper's tables and figures, and for the committed leaderboard.

All parts of a study are one run: each cell once, one progress display, one manifest.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from itertools import combinations, pairwise
from pathlib import Path
from typing import Any, Literal

from stiff_bench.plan.options import Choice, Chosen
from stiff_bench.plan.registry import Registry
from stiff_bench.plan.request import RunPlan, plan_run
from stiff_bench.store.names import Variant

DATASET = "kr10-twin"
"""What stands for the paper's robot."""
TWIN = Variant(DATASET)
PAPER_PROTOCOL, FAIR_PROTOCOL = Variant("paper-holdout"), Variant("holdout")
"""The paper's division, whose test part picks the epoch; and the one in which it does not."""
READ_ON_ALL = Variant("paper-holdout", {"read_on": "all"})
"""The paper's division, its fits read on all samples: most likely what the paper's Table 10 is."""
SEED = 0
METRICS = ("mae", "stde", "me")

# every option on which a number of these pages depends is named, default or not
PAPER_SOURCE: Mapping[str, Any] = {"preset": "paper"}
"""Of the pre-training: the poses and wrenches of the paper's Tables 4 and 5; without it, poses and
loads in the training samples' ranges."""
PAPER_RECIPE: Mapping[str, Any] = {"recipe": "paper"}
"""100,000 iterations of pre-training, then 50,000 of fine-tuning."""

VJM = Variant("vjm")
MULTI_SEGMENT = Variant("vjm-multisegment")
"""Not in the paper: joints whose springs change their slope, as the gears' catalogue has them."""
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
"""Of the paper's network, and of ours by default."""
SWEEP_STEPS = 1000
"""Of the networks that are compared by size and activation: half of the usual, for time."""
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
    """Return a network that learns the source domain alone, of some hidden layers.

    One stopped early is trained as the paper's recipe says (plain Adam, mean squared error), but
    for `EARLY_STEPS` alone, after which the MAEs of Table 6 are near the paper's.
    """
    given = {"activation": activation, "layers": layers, "width": width}
    usual = {"activation": "relu", "layers": BASE_LAYERS, "width": BASE_WIDTH}
    changed = {name: value for name, value in given.items() if value != usual[name]}
    early = {"pretrain_steps": EARLY_STEPS, **PAPER_RECIPE}
    training = early if stopped_early else {"pretrain_steps": SWEEP_STEPS}
    return Variant("mlp-pretrained", {**PAPER_SOURCE, **changed, **training})


def unfrozen(layers: Sequence[str]) -> Variant:
    """Return the fine-tuned network whose `layers` move, such as ("1", "2", "out")."""
    freeze = f"layers:{','.join(layers)}"
    options = {**FT_MLP.options, "freeze": freeze}
    return Variant("ft-mlp", options) if freeze != BEST_PAIR else FT_MLP


HIDDEN_LAYERS = tuple(str(number) for number in range(1, BASE_LAYERS + 1))
SINGLE_LAYERS = tuple((layer,) for layer in HIDDEN_LAYERS)
ADJACENT_PAIRS = tuple(pairwise(HIDDEN_LAYERS))
ALL_SINGLES = (*SINGLE_LAYERS, ("out",))
ALL_PAIRS = tuple(combinations((*HIDDEN_LAYERS, "out"), 2))

DEPTHS = (2, 3, 4, 5, 6)
DEPTH_WIDTH = 100
"""Table 6: hidden layers of 100 nodes."""
WIDTHS, WIDTH_DEPTHS = tuple(range(40, 401, 20)), (3, 4, 5)
"""Figure 5a and b."""
QUICK_WIDTHS = (40, 160, 280, 400)


@dataclass(frozen=True)
class StudyRun:
    """Every model on every data set under every protocol; `splits` None: the protocol's own."""

    models: tuple[Variant, ...]
    datasets: tuple[Variant, ...]
    protocols: tuple[Variant, ...]
    splits: int | None

    def chosen(self, registry: Registry) -> Chosen:
        """Return the same with their catalogue lines.

        Raises:
            ConfigError: a key is unknown.
        """
        return Chosen(
            [Choice.of(registry.model(one.key), one.options) for one in self.models],
            [Choice.of(registry.datasets[one.key], one.options) for one in self.datasets],
            [Choice.of(registry.protocols[one.key], one.options) for one in self.protocols],
        )


def paper_study(*, full: bool) -> tuple[StudyRun, ...]:
    """Return what the paper's tables and figures need.

    Full: five splits, every width, every pair of layers; else one split, and some of both.
    """
    splits, widths = (5, WIDTHS) if full else (1, QUICK_WIDTHS)
    layers = (*ALL_SINGLES, *ALL_PAIRS) if full else (*SINGLE_LAYERS, *ADJACENT_PAIRS)

    def run(models: Sequence[Variant], *protocols: Variant) -> StudyRun:
        return StudyRun(tuple(models), (TWIN,), protocols or (PAPER_PROTOCOL,), splits)

    methods = [VJM, FT_MLP, FT_MLP_OWN_SOURCE, DT_CNN]
    return (
        # first what others go on from: pre-trainings are kept, by their content
        run([pretrained(activation=activation) for activation in ACTIVATIONS]),
        run([*methods, FT_MLP_LAST_EPOCH], PAPER_PROTOCOL, READ_ON_ALL),
        run([*map(unfrozen, layers)]),
        run([*methods, MULTI_SEGMENT], FAIR_PROTOCOL),
        run([pretrained(layers=depth, width=DEPTH_WIDTH) for depth in DEPTHS]),
        run(
            [pretrained(layers=d, width=DEPTH_WIDTH, stopped_early=True) for d in DEPTHS]
            + [pretrained(activation=one, stopped_early=True) for one in ACTIVATIONS]
        ),
        run([pretrained(layers=d, width=w) for w in widths for d in WIDTH_DEPTHS]),
    )


def paper_recipe_study() -> tuple[StudyRun, ...]:
    """Return what Tables 9 and 10 show of the paper's own recipe, on the first split."""
    models = (FT_MLP_PAPER_RECIPE, FT_MLP_PAPER_RECIPE_LAST_EPOCH)
    return (StudyRun(models, (TWIN,), (PAPER_PROTOCOL, READ_ON_ALL), 1),)


NETWORK_STEPS = 300
"""Of the pre-trainings behind the committed leaderboard; what that changes stands on its page."""
_FEW_STEPS = {"pretrain_steps": NETWORK_STEPS}
_SHORTENED: Mapping[str, Mapping[str, Any]] = {
    **dict.fromkeys(("mlp-pretrained", "ft-mlp", "dt-cnn"), _FEW_STEPS),
    "deep-ensemble": {"members": 2, **_FEW_STEPS},
}


def five_specimens(key: str) -> tuple[Variant, ...]:
    """Return a twin's specimens 0 to 4, each another robot of the same kind."""
    return (Variant(key), *(Variant(key, {"specimen": number}) for number in range(1, 5)))


TWINS = (*five_specimens(DATASET), Variant("kr10-twin-omni"))
MEASURED = Variant("fanuc-r2000ic")


def leaderboard_study(keys: Sequence[str]) -> tuple[StudyRun, ...]:
    """Return what the committed leaderboard needs: all models that are shipped.

    The costly networks among these keys are shortened.
    """
    models = tuple(Variant(key, _SHORTENED.get(key, {})) for key in keys)
    return (
        StudyRun(models, (*TWINS, MEASURED), (FAIR_PROTOCOL,), 5),
        # the measured data are of one group of poses: there is no other space to go to
        StudyRun(models, TWINS, (Variant("space-transfer"),), None),
        StudyRun(models, (*TWINS, MEASURED), (Variant("sample-efficiency"),), None),
    )


ROUGH, BEAM, ARM = "kr10-twin-rough", Variant("kr10-twin-beam"), "arm-family"
EFFECT_STEPS = {
    "default": Variant(ROUGH, {"effects": "none"}),
    "+ hysteresis": Variant(ROUGH, {"effects": "hysteresis"}),
    "+ links": Variant(ROUGH, {"effects": "hysteresis,links"}),
    "+ kinematics": Variant(ROUGH, {"effects": "hysteresis,links,kinematics"}),
    "+ sensor": Variant(ROUGH),
}
"""What each step adds to the one before -> the rough twin with these effects; the last has all."""
ARMS = (Variant(ARM), *(Variant(ARM, {"robot": number}) for number in range(1, 10)))
EFFECT_MODELS = (
    *(VJM, MULTI_SEGMENT),
    *map(Variant, ("vjm-full", "gp", "vjm-gp", "compliance-net", "residual-mlp", "ft-mlp")),
    Variant("ft-mlp", PAPER_SOURCE),
)


def effects_study() -> tuple[StudyRun, ...]:
    """Return what shows whether the order of the models outlasts other physics of the twin."""
    twins = (*EFFECT_STEPS.values(), BEAM)
    return (
        StudyRun(EFFECT_MODELS, twins, (FAIR_PROTOCOL,), 3),
        StudyRun(EFFECT_MODELS, ARMS, (FAIR_PROTOCOL,), 1),
    )


TRANSFER_DATA = {
    "default": five_specimens(DATASET),
    "omni": five_specimens("kr10-twin-omni"),
    "rough": five_specimens(ROUGH),
    "beam": five_specimens(BEAM.key),
    "ur5": (Variant("ur5-twin"),),
    "arms": ARMS[:5],
    "FANUC": (MEASURED,),
}
"""Column -> its data sets."""
# with two jobs, neighbours start together: what shares a pre-training stands apart, so that the
# second one finds it made
_OWN_WAYS = (
    *(VJM, Variant("mlp-pretrained"), Variant("dt-cnn")),
    *map(Variant, ("ft-mlp", "vjm-gp", "compliance-net", "tradaboost")),
    *(Variant("ft-mlp", {"anchor": "none"}), Variant("dt-cnn", {"supervision": "fine-tune"})),
)
_OTHER_WAYS = (
    *(Variant("adann-2r", options) for options in ({}, {"supervision": "labels"})),
    Variant("deep-ensemble", {"members": 2}),
    *(
        Variant("ft-mlp", {"anchor": "none", "source_teacher": f"vjm-{name}"})
        for name in ("multisegment", "full")
    ),
    Variant("dt-cnn", {"alignment": "mk-mmd"}),
)
_OF_THE_KR10 = (Variant("ft-mlp", PAPER_SOURCE), Variant("dt-cnn", PAPER_SOURCE))


def transfer_study() -> tuple[StudyRun, ...]:
    """Return what compares ways to carry simulated data over to measurements."""
    simulated = tuple(one for of in TRANSFER_DATA.values() for one in of if one != MEASURED)
    kr10 = tuple(one for one in simulated if one.key.startswith(DATASET))
    return (
        StudyRun(_OWN_WAYS, simulated, (FAIR_PROTOCOL,), 1),
        StudyRun(_OWN_WAYS, (MEASURED,), (FAIR_PROTOCOL,), 5),
        StudyRun(_OF_THE_KR10, kr10, (FAIR_PROTOCOL,), 1),
        StudyRun(_OTHER_WAYS, simulated, (FAIR_PROTOCOL,), 1),
        StudyRun(_OTHER_WAYS, (MEASURED,), (FAIR_PROTOCOL,), 5),
    )


def study_plans(
    runs: Sequence[StudyRun], *, output: Path, command: str, registry: Registry
) -> tuple[RunPlan, ...]:
    """Check the parts of a study, all of which are stored in one folder.

    Raises:
        ConfigError: one of the models is unknown here.
    """
    common: dict[str, Any] = {"metrics": METRICS, "seed": SEED, "output": output}
    return tuple(
        plan_run(run.chosen(registry), registry, splits=run.splits, command=command, **common)
        for run in runs
    )
