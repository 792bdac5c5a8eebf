"""What has to be run for the paper's tables and figures, and for the committed leaderboard.

All parts of a study are one run: each cell once, one progress display, one manifest.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import combinations, pairwise
from pathlib import Path
from typing import Any, Literal

from stiff_bench.plan.cells import cell_tasks
from stiff_bench.plan.options import Choice, Chosen
from stiff_bench.plan.registry import Registry
from stiff_bench.plan.request import RunPlan, plan_run
from stiff_bench.store.database import stored_statuses
from stiff_bench.store.names import Variant

DATASET = "kr10-twin"
"""What stands for the paper's robot."""
TWIN = Variant(DATASET)
PAPER_PROTOCOL, FAIR_PROTOCOL = "paper-holdout", "holdout"
"""The paper's division, whose test part picks the epoch; and the one in which it does not."""
SEED = 0
METRICS = ("mae", "stde", "me")

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
    given = {"activation": activation, "layers": layers, "width": width}
    usual = {"activation": "relu", "layers": BASE_LAYERS, "width": BASE_WIDTH}
    changed = {name: value for name, value in given.items() if value != usual[name]}
    early = {"pretrain_steps": EARLY_STEPS, "recipe": "paper"} if stopped_early else {}
    return Variant(MLP_PRETRAINED, dict(sorted((changed | early).items())))


def unfrozen(layers: Sequence[str]) -> Variant:
    """Return the fine-tuned network whose `layers` move, such as ("1", "2", "out")."""
    freeze = f"layers:{','.join(layers)}"
    return Variant(FT_MLP, {} if freeze == BEST_PAIR else {"freeze": freeze})


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
    """A part of a study: every model on every data set under every protocol.

    Attributes:
        models, datasets: with their options.
        protocols: keys.
        splits: how many; None: the protocol's own.
    """

    models: tuple[Variant, ...]
    datasets: tuple[Variant, ...]
    protocols: tuple[str, ...]
    splits: int | None

    def chosen(self, registry: Registry) -> Chosen:
        """Return the same with their catalogue lines.

        Raises:
            ConfigError: a key is unknown.
        """
        return Chosen(
            [Choice.of(registry.model(one.key), one.options) for one in self.models],
            [Choice.of(registry.datasets[one.key], one.options) for one in self.datasets],
            [Choice.of(registry.protocols[key]) for key in self.protocols],
        )


def paper_study(*, full: bool) -> tuple[StudyRun, ...]:
    """Return what the paper's tables and figures need.

    Args:
        full: five splits, every width, every pair of layers; otherwise one split, and a coarse
            choice of both.
    """
    splits = 5 if full else 1
    widths = WIDTHS if full else QUICK_WIDTHS
    layers = (*ALL_SINGLES, *ALL_PAIRS) if full else (*SINGLE_LAYERS, *ADJACENT_PAIRS)

    def run(models: Sequence[Variant], protocol: str = PAPER_PROTOCOL) -> StudyRun:
        return StudyRun(tuple(models), (TWIN,), (protocol,), splits)

    vjm, multi_segment, ft_mlp, dt_cnn = map(Variant, (VJM, MULTI_SEGMENT, FT_MLP, DT_CNN))
    return (
        # first what others go on from: pre-trainings are kept, by their content
        run([pretrained(activation=activation) for activation in ACTIVATIONS]),
        run([vjm, ft_mlp, FT_MLP_LAST_EPOCH, *map(unfrozen, layers), dt_cnn, FT_MLP_OWN_SOURCE]),
        run([vjm, multi_segment, ft_mlp, dt_cnn, FT_MLP_OWN_SOURCE], FAIR_PROTOCOL),
        run([pretrained(layers=depth, width=DEPTH_WIDTH) for depth in DEPTHS]),
        run(
            [pretrained(layers=d, width=DEPTH_WIDTH, stopped_early=True) for d in DEPTHS]
            + [pretrained(activation=one, stopped_early=True) for one in ACTIVATIONS]
        ),
        run([pretrained(layers=d, width=w) for w in widths for d in WIDTH_DEPTHS]),
    )


NETWORK_STEPS = 300
"""Of the pre-trainings behind the committed leaderboard; what that changes stands on its page."""
_SHORTENED = {
    "mlp-pretrained": {"pretrain_steps": NETWORK_STEPS},
    "ft-mlp": {"pretrain_steps": NETWORK_STEPS},
    "dt-cnn": {"pretrain_steps": NETWORK_STEPS},
    "deep-ensemble": {"members": 2, "pretrain_steps": NETWORK_STEPS},
}
TWINS = (
    TWIN,
    *(Variant(DATASET, {"specimen": number}) for number in range(1, 5)),
    Variant("kr10-twin-omni"),
)
MEASURED = Variant("fanuc-r2000ic")


def leaderboard_study(keys: Sequence[str]) -> tuple[StudyRun, ...]:
    """Return what the committed leaderboard needs.

    Args:
        keys: of all models that are shipped; the costly networks among them are shortened.
    """
    models = tuple(Variant(key, _SHORTENED.get(key, {})) for key in keys)
    return (
        StudyRun(models, (*TWINS, MEASURED), ("holdout",), 5),
        # the measured data are of one group of poses: there is no other space to go to
        StudyRun(models, TWINS, ("space-transfer",), None),
        StudyRun(models, (*TWINS, MEASURED), ("sample-efficiency",), None),
    )


EFFECTS_FOLDER = "effects"
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
    *map(Variant, (VJM, MULTI_SEGMENT, "vjm-full", "gp", "vjm-gp", "compliance-net")),
    *(Variant("residual-mlp"), Variant(FT_MLP), FT_MLP_OWN_SOURCE),
)


def effects_study() -> tuple[StudyRun, ...]:
    """Return what shows whether the order of the models outlasts other physics of the twin."""
    twins = (*EFFECT_STEPS.values(), BEAM)
    return (
        StudyRun(EFFECT_MODELS, twins, (FAIR_PROTOCOL,), 3),
        StudyRun(EFFECT_MODELS, ARMS, (FAIR_PROTOCOL,), 1),
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


def n_missing(plans: Sequence[RunPlan]) -> int:
    """Return how many cells have neither a result nor a failure in the plans' folder.

    Raises:
        StiffBenchError: a data set cannot be loaded or divided.
    """
    stored = stored_statuses(plans[0].output)
    return sum(task.cell.key not in stored for task in cell_tasks(*plans))
