"""What the captions of all figures say alike: splits, and what must be read with the numbers."""

from __future__ import annotations

from collections.abc import Collection, Iterable, Sequence

from stiff_bench.collected import Contest
from stiff_bench.contest_choice import presentation
from stiff_bench.grouped import grouped
from stiff_bench.tables import mark_of
from stiff_bench.words import counted
from stiff_protocols.plugin import kind_label
from stiff_protocols.record import Presentation

_FEW = 3  # models that a caption names; of more it names the others


def between(counts: Collection[int], thing: str) -> str:
    """Return "5 splits", or "1 to 5 splits" where not all are equal."""
    least, most = min(counts), max(counts)
    return counted(most, thing) if least == most else f"{least} to {counted(most, thing)}"


def marks(shown: Iterable[Presentation]) -> str:
    """Return a sentence for each mark that stands beside models elsewhere; "" for none."""
    shown = list(shown)
    everyone = list(dict.fromkeys(one.model for one in shown))
    marked = grouped(
        dict.fromkeys((mark_of(one), one.model) for one in shown), lambda pair: pair[0]
    )
    return "".join(
        f" {_which([model for _, model in pairs], everyone)}: {mark}."
        for mark, pairs in marked.items()
        if mark
    )


def marks_in(contests: Iterable[Contest], models: Collection[str]) -> str:
    """Return `marks` of the models of some contests."""
    return marks(
        found.shown
        for contest in contests
        for name, found in contest.competitors.items()
        if name in models
    )


def setting(contest: Contest, models: Collection[str], n_splits: Collection[int]) -> str:
    """Return data, protocol, splits and seed in a sentence, and what must be read with them.

    Args:
        contest: the results.
        models: that are shown.
        n_splits: of which these numbers of splits are shown.
    """
    shown = presentation(contest)
    data = f"{contest.name.dataset} ({kind_label(shown.kind, shown.task)})"
    protocol = " | ".join(filter(None, (contest.name.protocol, contest.name.condition)))
    said = marks_in([contest], models)
    return f"{data}, {protocol}, {between(n_splits, 'split')}, seed {contest.name.seed}.{said}"


def _which(models: Sequence[str], everyone: Sequence[str]) -> str:
    others = [name for name in everyone if name not in models]
    if not others and len(models) > 1:
        return "All models shown"
    if len(models) > _FEW and len(others) <= _FEW:
        return f"All models shown but {', '.join(others)}"
    return ", ".join(models)
