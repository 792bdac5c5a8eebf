"""Stored results, sorted for comparisons: who met whom on the same data and the same splits.

A contest is one data set under one protocol and condition. Results of different data never meet in
one, even where the data sets' names are the same; results of different splits are different slots
of it, and a model that lacks a slot is incomplete there.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from stiff_bench.choice import OPTION_MARK, split_word
from stiff_bench.store import read_results
from stiff_protocols.errors import ConfigError, StoreError, unknown_name
from stiff_protocols.record import CellResult, Presentation

Slot = tuple[int, str]
"""A split: its number and the hash of its rows."""


@dataclass(frozen=True, order=True)
class ContestName:
    """What makes results comparable.

    Attributes:
        dataset, protocol, condition: as shown.
        seed: of the run's splits.
        data_sha256: hash of the data set's numbers.
        source_sha256: of the other robot's data that source domains come from; "" for none.
    """

    dataset: str
    protocol: str
    condition: str
    seed: int
    data_sha256: str
    source_sha256: str = ""

    @property
    def text(self) -> str:
        """Data set, protocol and condition for people."""
        return " | ".join(filter(None, (self.dataset, self.protocol, self.condition)))


@dataclass(eq=False)
class Competitor:
    """One model, with its options, in one contest.

    Attributes:
        shown: what must stand beside its numbers.
        done: its results by slot.
        reasons: slot -> why it failed there or was skipped.
    """

    shown: Presentation
    done: dict[Slot, CellResult] = field(default_factory=dict)
    reasons: dict[Slot, str] = field(default_factory=dict)

    @property
    def name(self) -> str:
        """Key with the options that differ from their defaults."""
        return self.shown.model


@dataclass(eq=False)
class Contest:
    """All competitors on one data set under one protocol and condition.

    Attributes:
        name: what they share.
        slots: the splits that any of them was run on, in order.
        competitors: by name, in the order of their names.
    """

    name: ContestName
    slots: tuple[Slot, ...]
    competitors: dict[str, Competitor]

    @property
    def n_results(self) -> int:
        """How many results and failures it holds."""
        return sum(len(found.done) + len(found.reasons) for found in self.competitors.values())

    @property
    def newest_run(self) -> str:
        """The latest of the runs that made its results; a run's name begins with its time."""
        return max(
            (done.run_id for found in self.competitors.values() for done in found.done.values()),
            default="",
        )

    def options(self, kind: str) -> Mapping[str, Any]:
        """Return every option of its "dataset" or "protocol", defaults too; none without results.

        They are the same in all results of one name and one data hash.
        """
        for found in self.competitors.values():
            for result in found.done.values():
                options: Mapping[str, Any] = getattr(result.cell, f"{kind}_params")
                return options
        return {}

    def is_complete(self, competitor: str) -> bool:
        """Say whether the model has a result on every split that others have."""
        found = self.competitors.get(competitor)
        return found is not None and len(found.done) == len(self.slots)

    def results(self, competitor: str, slots: Sequence[Slot] | None = None) -> list[CellResult]:
        """Return a model's results on these slots (default: all that it has), in order."""
        done = self.competitors[competitor].done
        wanted = self.slots if slots is None else slots
        return [done[slot] for slot in wanted if slot in done]

    def shared_slots(self, competitors: Iterable[str]) -> list[Slot]:
        """Return the splits on which all of these models have a result, in order."""
        each = [self.competitors[name].done for name in competitors]
        return [slot for slot in self.slots if all(slot in done for done in each)]


def collect(folder: Path) -> list[Contest]:
    """Read every result of a folder and sort them into contests.

    Raises:
        StoreError: the folder holds no results, one is damaged, or one name stands for models
            with different options (results of different versions).
    """
    by_name: dict[ContestName, list[CellResult]] = {}
    for result in read_results(folder):
        cell, shown = result.cell, result.shown
        name = ContestName(
            shown.dataset,
            shown.protocol,
            cell.condition,
            cell.seed,
            cell.data_sha256,
            cell.source_sha256,
        )
        by_name.setdefault(name, []).append(result)
    if not by_name:
        raise StoreError(f"--results {folder}: holds no results; `bench run --output` makes them")
    return [_contest(name, results) for name, results in by_name.items()]


def _contest(name: ContestName, results: Sequence[CellResult]) -> Contest:
    competitors: dict[str, Competitor] = {}
    for result in results:
        found = competitors.setdefault(result.shown.model, Competitor(result.shown))
        slot = (result.cell.split_index, result.cell.split_sha256)
        if result.status == "ok":
            _refuse_other_options(found, result)
            found.done[slot] = result
        else:
            found.reasons[slot] = f"{result.status}: {result.failure}"
    for found in competitors.values():  # a failure that was mended is none
        found.reasons = {slot: why for slot, why in found.reasons.items() if slot not in found.done}
    slots = {slot for found in competitors.values() for slot in (*found.done, *found.reasons)}
    return Contest(name, tuple(sorted(slots)), dict(sorted(competitors.items())))


def _refuse_other_options(found: Competitor, result: CellResult) -> None:
    for other in found.done.values():
        if other.cell.model_params != result.cell.model_params:
            differing = sorted(
                option
                for option in {*other.cell.model_params, *result.cell.model_params}
                if other.cell.model_params.get(option) != result.cell.model_params.get(option)
            )
            raise StoreError(
                f"{found.name!r}: stored results differ in {', '.join(differing)}, so they are of "
                "different versions of stiffbench; give each version a folder of its own"
            )
        return


def competitor_names(contests: Iterable[Contest]) -> list[str]:
    """Return the names of all models that have a result or a failure anywhere."""
    return sorted({name for contest in contests for name in contest.competitors})


def chosen_contests(
    contests: Sequence[Contest],
    *,
    datasets: Sequence[str],
    protocols: Sequence[str],
) -> list[Contest]:
    """Return the contests of these data sets and protocols; none named means all.

    A key without options stands for all its variants: "kr10-twin" for every specimen,
    "kr10-twin@specimen=0" for the one that is shown as "kr10-twin".

    Raises:
        ConfigError: a name has no results.
    """
    chosen = list(contests)
    for kind, asked in (("dataset", datasets), ("protocol", protocols)):
        for word in asked:
            if not any(_stands_for_its(kind, word, contest) for contest in contests):
                names = {getattr(contest.name, kind) for contest in contests}
                meant = unknown_name(f"{kind} with results", word, names)
                raise ConfigError(f"--{kind}: {meant}")
        chosen = [
            contest
            for contest in chosen
            if not asked or any(_stands_for_its(kind, word, contest) for word in asked)
        ]
    return chosen


def stands_for(word: str, name: str) -> bool:
    """Say whether a word is a name, or the key of a name with options."""
    return name == word or name.startswith(f"{word}{OPTION_MARK}")


def _stands_for_its(kind: str, word: str, contest: Contest) -> bool:
    """Say whether a word stands for a contest's data set or protocol; defaults may be spelled."""
    name: str = getattr(contest.name, kind)
    if stands_for(word, name):
        return True
    key, settings = split_word(word)
    options = contest.options(kind)
    said = [setting.partition("=") for setting in settings]
    return (
        bool(said)
        and key == split_word(name)[0]
        and all(str(options.get(option)) == value for option, _, value in said)
    )


def same_name_other_data(contests: Sequence[Contest]) -> Iterator[str]:
    """Yield a line for each data set whose name stands for different numbers in the folder."""
    hashes: dict[str, set[str]] = {}
    for contest in contests:
        hashes.setdefault(contest.name.dataset, set()).add(contest.name.data_sha256)
    for dataset, found in hashes.items():
        if len(found) > 1:
            short = ", ".join(sorted(text[:8] for text in found))
            yield f"{dataset} stands for different data here ({short}); they are never compared."
