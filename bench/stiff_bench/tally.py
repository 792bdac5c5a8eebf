"""What became of the cells of a run, in one line."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterable, Set

from stiff_bench.isolate import OUT_OF_MEMORY, TIMED_OUT
from stiff_protocols.record import CellResult

_OWN_WORDS = (TIMED_OUT, OUT_OF_MEMORY)
"""Causes that are counted by themselves."""


def tally(results: Iterable[CellResult], cached: Set[str]) -> str:
    """Return e.g. "18 ok, 1 failed (SIGKILL), 1 timed out, 3 cached".

    Args:
        results: of the run.
        cached: keys of the results that were there before.
    """
    counts: Counter[str] = Counter()
    causes: Counter[str] = Counter()
    for result in results:
        if result.status == "failed":
            own = result.cause in _OWN_WORDS
            counts[result.cause if own else "failed"] += 1
            causes.update([] if own else [result.cause or "error"])
        else:
            counts["cached" if result.cell.key in cached else result.status] += 1
    words = [f"{counts['ok']} ok"]
    for status in ("failed", *_OWN_WORDS, "skipped", "cached"):
        if counts[status]:
            why = f" ({_in_words(causes)})" if status == "failed" else ""
            words.append(f"{counts[status]} {status}{why}")
    return ", ".join(words)


def _in_words(causes: Counter[str]) -> str:
    """Return causes with their numbers, a single one by its name alone."""
    if causes.total() == 1 or len(causes) == 1:
        return next(iter(causes))
    return ", ".join(f"{number} {cause}" for cause, number in causes.most_common())
