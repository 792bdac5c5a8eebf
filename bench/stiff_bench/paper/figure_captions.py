"""What the captions of the paper's figures have in common."""

from __future__ import annotations

from stiff_bench.paper.study import DATASET, PAPER_PROTOCOL, SEED
from stiff_bench.words import counted

DATA = f"{DATASET}, simulated: the paper's measurements are not public"


def setting(n_splits: int, protocol: str = PAPER_PROTOCOL) -> str:
    """Return data, protocol, splits and seed in a sentence."""
    picked = ", whose test part picks the epoch as in the paper" * (protocol == PAPER_PROTOCOL)
    return f"Data: {DATA}; protocol: {protocol}{picked}; {counted(n_splits, 'split')}, seed {SEED}."
