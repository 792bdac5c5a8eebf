"""Build leaderboards: models over robots if there are enough, else per data set; no ranks.

`leaderboard_tables` prints a leaderboard; `board` has the statistics over robots.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property

from stiff_bench.analysis.answer import Answer
from stiff_bench.analysis.board import Board
from stiff_bench.analysis.collected import (
    Case,
    StoredResults,
    in_order,
    left_out_notes,
    of_newest_data,
    same_name_other_data,
)
from stiff_bench.analysis.scored_case import ScoredCase, scored_case, with_reference
from stiff_bench.analysis.selection import EVERYTHING, Selection
from stiff_bench.analysis.sort_key import SortKey
from stiff_bench.store.names import CaseName, grouped, labels
from stiff_bench.store.samples import StoredData
from stiff_bench.store.versions import sources
from stiff_bench.tables.metric_table import TRAINING_MARK
from stiff_protocols.contract.errors import ConfigError


@dataclass(frozen=True, eq=False)
class Section:
    """The comparisons of one table.

    Attributes:
        selects_on_test: True if their protocols let models pick the epoch on the test part.
        answer: scores of all comparisons.
        missing: reasons for missing scores, by model and comparison.
    """

    selects_on_test: bool
    answer: Answer
    missing: Mapping[str, Mapping[CaseName, str]]

    @property
    def cases(self) -> tuple[ScoredCase, ...]:
        """Return all comparisons."""
        return self.answer.cases

    @cached_property
    def plans(self) -> dict[tuple[str, str], Answer]:
        """Return comparisons by protocol and condition."""
        plans = grouped(self.cases, lambda case: (case.name.protocol, case.name.condition))
        return {name: self.answer.over(cases) for name, cases in plans.items()}

    @cached_property
    def boards(self) -> dict[tuple[str, str], Board]:
        """Return boards by protocol and condition, for plans with enough robots."""
        is_error = self.answer.key.sign > 0.0 and not self.answer.key.is_cost
        return {
            name: board
            for name, answer in self.plans.items()
            if is_error and answer.claim_robots and (board := Board(answer)).rows
        }

    @cached_property
    def models(self) -> tuple[str, ...]:
        """Return all models: complete ones first, best first."""
        with_scores = [model.name for model in self.answer.models]
        return tuple(dict.fromkeys([*with_scores, *self.missing]))


@dataclass(frozen=True)
class Leaderboard:
    """One or more sections, fair protocols first.

    Attributes:
        key: metric that sorts the models.
        notes: left-out results with reasons.
        provenance: versions of stiffbench that made the results.
    """

    key: SortKey
    sections: tuple[Section, ...]
    notes: tuple[str, ...]
    provenance: tuple[str, ...]


def build_leaderboard(
    stored: StoredResults,
    key: SortKey,
    selection: Selection = EVERYTHING,
    *,
    seed: int = 0,
) -> Leaderboard:
    """Return the leaderboard of stored results; `seed` is the seed of pose draws.

    Raises:
        ConfigError: a name has no results, or no two models can be compared.
        StoreError: samples are corrupt, or two models share no split.
    """
    cases = selection.cases_of(stored.cases)
    data_of = stored.data_of
    newest = sorted(of_newest_data(cases), key=in_order)
    usable = [case for case in newest if not case.presentation.reports_training]
    names = selection.models_of(usable)
    n_run = {case: sum(name in case.competitors for name in names) for case in usable}
    comparable = [case for case in usable if n_run[case] > 1]
    lonely = [case for case in usable if n_run[case] == 1]
    notes = list(_data_notes(cases, data_of))
    if lonely:
        first = labels(case.name for case in usable)[lonely[0].name] + and_more(lonely)
        notes.append(f"{first} is left out: none of the other models was run there.")
    if not comparable:
        reasons = "".join(f"; {note.removesuffix('.')}" for note in notes)
        raise ConfigError(
            "there is nothing to compare: no two models have results on the same data, "
            f"protocol and condition (models with results: {', '.join(names) or 'none'}){reasons}"
        )
    names = [name for name in names if any(name in c.competitors for c in comparable)]
    sections = tuple(
        _section(part, names, key, data_of, seed)
        for selects in (False, True)
        if (part := [case for case in comparable if case.presentation.selects_on_test == selects])
    )
    run_ids = Counter(
        result.run_id
        for section in sections
        for case in section.cases
        for model in case.scores
        for result in case.results[model]
    )
    made_by = (sources(stored.folder, stored.runs, run_ids),)
    return Leaderboard(key, sections, tuple(notes), made_by)


def _section(
    cases: Sequence[Case],
    names: Sequence[str],
    key: SortKey,
    data_of: Callable[[str], StoredData],
    seed: int,
) -> Section:
    scored = [
        with_reference(scored_case(case, names, key, data_of(case.name.data_sha256), seed))
        for case in cases
    ]
    missing = {
        name: reasons
        for name in names
        if any(name in case.case.competitors for case in scored)
        and (reasons := {case.name: case.missing[name] for case in scored if name in case.missing})
    }
    measured_first = sorted(scored, key=lambda case: case.case.presentation.kind != "measured")
    model_names = dict.fromkeys(name for case in scored for name in case.scores)
    answer = Answer(key, tuple(measured_first), tuple(model_names), {}, seed)
    return section_of(answer, missing)


def section_of(
    answer: Answer, missing: Mapping[str, Mapping[CaseName, str]] | None = None
) -> Section:
    """Return the section of an answer whose comparisons fit in one table."""
    return Section(answer.cases[0].case.presentation.selects_on_test, answer, missing or {})


def _data_notes(cases: Sequence[Case], data_of: Callable[[str], StoredData]) -> Iterator[str]:
    for line in same_name_other_data(cases, data_of):
        yield f"{line.removesuffix('.')}; only the data of the newest run count."
    yield from left_out_notes(cases)
    for protocol in sorted({c.name.protocol for c in cases if c.presentation.reports_training}):
        yield f"{protocol} is left out: {TRAINING_MARK}."


def and_more(things: Sequence[object]) -> str:
    """Return " (and 2 more)" for three things; "" for one."""
    return f" (and {len(things) - 1} more)" if len(things) > 1 else ""
