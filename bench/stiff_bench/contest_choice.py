"""Which contests and models a leaderboard shows, and what it leaves out."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass, replace
from typing import Any

from stiff_bench.collected import (
    Contest,
    asked_for,
    competitor_names,
    left_out_notes,
    same_name_other_data,
    stands_for,
)
from stiff_bench.contest_name import ContestName, labels
from stiff_bench.natural_order import natural_key
from stiff_protocols.errors import ConfigError, unknown_name
from stiff_protocols.plugin import STIFFNESS, kind_label
from stiff_protocols.record import Presentation

FEWEST_RANKED = 2


@dataclass(frozen=True)
class ShownContests:
    """What a leaderboard shows.

    Attributes:
        contests: of stiffness, in which at least two of the models were run; by protocol,
            condition and data set.
        models: that were run in one of them, by name.
        notes: what is left out, and why.
    """

    contests: tuple[Contest, ...]
    models: tuple[str, ...]
    notes: tuple[str, ...]


def shown_contests(contests: Sequence[Contest], words: Sequence[str]) -> ShownContests:
    """Return the contests in which models can be ranked.

    Args:
        contests: of one folder.
        words: models' names, or keys that stand for all their variants; none means all.

    Raises:
        ConfigError: a model has no results, or there is nothing to rank.
    """
    usable = [c for c in of_newest_data(contests) if presentation(c).task == STIFFNESS]
    names = _named(usable, words)
    ranked = [c for c in usable if _n_run(c, names) >= FEWEST_RANKED]
    if not ranked:
        why = "".join(f"; {note.removesuffix('.')}" for note in _data_notes(contests))
        raise ConfigError(
            "there is nothing to rank: no two models have results on the same stiffness data, "
            f"protocol and condition (models with results: {', '.join(names) or 'none'}){why}"
        )
    lonely = sorted((c for c in usable if _n_run(c, names) == 1), key=_order)
    called = labels(contest.name for contest in usable)
    return ShownContests(
        contests=tuple(sorted(ranked, key=_order)),
        models=tuple(name for name in names if any(name in c.competitors for c in ranked)),
        notes=(
            *_data_notes(contests),
            *(
                f"{called[c.name]} is left out: none of the other models was run there."
                for c in lonely
            ),
        ),
    )


def presentation(contest: Contest) -> Presentation:
    """Return what stands beside a contest's numbers; what is said of the model is any model's."""
    return next(iter(contest.competitors.values())).shown


def caveats_of(contests: Iterable[Contest]) -> tuple[str, ...]:
    """Return what must be read with the data sets and the protocols of contests, each once."""
    shown = [presentation(contest) for contest in contests]
    said = [caveat for one in shown for caveat in (*one.caveats, one.warning)]
    return tuple(filter(None, dict.fromkeys(said)))


def _n_run(contest: Contest, names: Sequence[str]) -> int:
    return sum(name in contest.competitors for name in names)


def of_newest_data(contests: Sequence[Contest]) -> list[Contest]:
    """Return the contests of the data that each data set's newest run was on.

    Of those that differ in the data of the source domain alone, the newest stay.
    """
    in_order = sorted(contests, key=lambda one: (one.newest_run, one.name))  # the last ones stay
    newest_data = {one.name.dataset: one.name.data_sha256 for one in in_order}
    current = [c for c in in_order if c.name.data_sha256 == newest_data[c.name.dataset]]
    newest_source = {_without_source(one): one for one in current}
    return list(newest_source.values())


def _without_source(contest: Contest) -> ContestName:
    return replace(contest.name, source_sha256="")


def _named(contests: Sequence[Contest], words: Sequence[str]) -> list[str]:
    known = competitor_names(contests)
    for word in words:
        if not any(stands_for(word, name) for name in known):
            raise ConfigError(f"--model: {unknown_name('model with results', word, known)}")
    return [name for name in known if asked_for(name, words)]


def _data_notes(contests: Sequence[Contest]) -> Iterator[str]:
    for line in same_name_other_data(contests):
        yield f"{line.removesuffix('.')}, those of the newest run count, the others are left out."
    yield from left_out_notes(contests)
    others = {
        c.name.dataset: presentation(c) for c in contests if presentation(c).task != STIFFNESS
    }
    for dataset, shown in sorted(others.items()):
        yield f"{dataset} is left out: it is {kind_label(shown.kind, shown.task)}."


def _order(contest: Contest) -> tuple[Any, ...]:
    """Return a sort key: "n = 5" stands before "n = 10"."""
    name = contest.name
    return (*map(natural_key, (name.protocol, name.condition, name.dataset)), name.seed)
