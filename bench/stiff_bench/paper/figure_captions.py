"""What the captions of the paper's figures have in common."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

from stiff_bench.figures.caption_words import between, marks
from stiff_bench.paper.study import DATASET, PAPER_PROTOCOL, SEED
from stiff_protocols.record import CellResult

DATA = f"{DATASET}, simulated: the paper's measurements are not public"


def paper_setting(results: Mapping[str, Sequence[CellResult]], each: str = "") -> str:
    """Return data, protocol, splits and seed in a sentence, and what must be read with them.

    Args:
        results: model -> its results that are shown.
        each: of what there are so many splits, where the numbers may differ, such as "a network".
    """
    n_splits = " ".join(filter(None, (between(list(map(len, results.values())), "split"), each)))
    said = marks(found[0].shown for found in results.values())
    return f"Data: {DATA}; protocol: {PAPER_PROTOCOL}; {n_splits}, seed {SEED}.{said}"
