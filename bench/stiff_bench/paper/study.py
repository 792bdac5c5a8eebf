"""What has to be run for the paper's tables and figures, and for the committed leaderboard."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

from stiff_bench.paper.names import (
    ACTIVATIONS,
    ADJACENT_PAIRS,
    ALL_PAIRS,
    ALL_SINGLES,
    DT_CNN,
    FT_MLP,
    FT_MLP_LAST_EPOCH,
    FT_MLP_OWN_SOURCE,
    MULTI_SEGMENT,
    SINGLE_LAYERS,
    VJM,
    pretrained,
    unfrozen,
)

DATASET = "kr10-twin"
"""What stands for the paper's robot."""
PAPER_PROTOCOL, FAIR_PROTOCOL = "paper-holdout", "holdout"
"""The paper's division, whose test part picks the epoch; and the one in which it does not."""
SEED = 0

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
        models, datasets, protocols: words of `bench run`.
        splits: as --splits; None: the protocol's own.
    """

    models: tuple[str, ...]
    datasets: tuple[str, ...]
    protocols: tuple[str, ...]
    splits: int | None


def paper_study(*, full: bool) -> tuple[StudyRun, ...]:
    """Return what the paper's tables and figures need.

    Args:
        full: five splits, every width, every pair of layers; otherwise one split, and a coarse
            choice of both.
    """
    splits = 5 if full else 1
    widths = WIDTHS if full else QUICK_WIDTHS
    layers = (*ALL_SINGLES, *ALL_PAIRS) if full else (*SINGLE_LAYERS, *ADJACENT_PAIRS)

    def run(models: Sequence[str], protocol: str = PAPER_PROTOCOL) -> StudyRun:
        return StudyRun(tuple(dict.fromkeys(models)), (DATASET,), (protocol,), splits)

    return (
        # first what others go on from: pre-trainings are kept, by their content
        run([pretrained(activation=activation) for activation in ACTIVATIONS]),
        run([VJM, FT_MLP, FT_MLP_LAST_EPOCH, *map(unfrozen, layers), DT_CNN, FT_MLP_OWN_SOURCE]),
        run([VJM, MULTI_SEGMENT, FT_MLP, DT_CNN, FT_MLP_OWN_SOURCE], FAIR_PROTOCOL),
        run([pretrained(layers=depth, width=DEPTH_WIDTH) for depth in DEPTHS]),
        run(
            [pretrained(layers=d, width=DEPTH_WIDTH, stopped_early=True) for d in DEPTHS]
            + [pretrained(activation=one, stopped_early=True) for one in ACTIVATIONS]
        ),
        run([pretrained(layers=d, width=w) for w in widths for d in WIDTH_DEPTHS]),
    )


NETWORK_STEPS = 300
"""Of the pre-trainings behind the committed leaderboard; what that changes stands on its page."""
_SHORTENED = (
    f"mlp-pretrained@pretrain_steps={NETWORK_STEPS}",
    f"ft-mlp@pretrain_steps={NETWORK_STEPS}",
    f"dt-cnn@pretrain_steps={NETWORK_STEPS}",
    f"deep-ensemble@members=2@pretrain_steps={NETWORK_STEPS}",
)
TWINS = (DATASET, *(f"{DATASET}@specimen={number}" for number in range(1, 5)), "kr10-twin-omni")
MEASURED = "fanuc-r2000ic"


def leaderboard_study(models: Sequence[str]) -> tuple[StudyRun, ...]:
    """Return what the committed leaderboard needs.

    Args:
        models: keys of all that are shipped; the costly networks among them are shortened.
    """
    shortened = {word.partition("@")[0]: word for word in _SHORTENED}
    words = tuple(shortened.get(key, key) for key in models)
    return (
        StudyRun(words, (*TWINS, MEASURED), ("holdout",), 5),
        # the measured data are of one group of poses: there is no other space to go to
        StudyRun(words, TWINS, ("space-transfer",), None),
        StudyRun(words, (*TWINS, MEASURED), ("sample-efficiency",), None),
    )
