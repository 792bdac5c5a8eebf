"""Write a leaderboard as tables: a board over robots, or a table per data set, in mm.

To add a column of costs, add an entry to `COSTS`. The columns and marks are explained in
docs/definitions.md.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import astuple, dataclass, fields, replace
from functools import partial
from typing import NamedTuple

import numpy as np

from stiff_bench.analysis.answer import FEWEST_ROBOTS, Answer
from stiff_bench.analysis.board import Board
from stiff_bench.analysis.board_tables import (
    VERDICT_MARKS,
    board_headline,
    board_sentences,
    board_tables,
)
from stiff_bench.analysis.collected import caveats_of
from stiff_bench.analysis.leaderboard import Leaderboard, Section, and_more
from stiff_bench.analysis.scored_case import ScoredCase, correction_text
from stiff_bench.analysis.sort_key import SortKey
from stiff_bench.analysis.verdict import Estimate
from stiff_bench.store.names import CaseName, grouped, labels
from stiff_bench.tables.metric_table import SELECTION_MARK, number_format
from stiff_bench.tables.table import WRITTEN, Column, Entry, Name, Quantity, Table, text_columns
from stiff_bench.tables.units import PRINTED, counted, first_few, percent
from stiff_models.model_catalog import REFERENCE_MODEL
from stiff_protocols.contract.record import Cost
from stiff_protocols.scoring.metrics import METRICS
from stiff_protocols.scoring.paired import LEVEL

BEST, LIKE_BEST = "*", "≈"


def leaderboard_tables(board: Leaderboard) -> list[Table]:
    """Return the tables of all sections; json also has all scores of all cases."""
    return [
        table
        for section in board.sections
        for table in (*section_tables(section, board), _scores(section, board))
    ]


def section_tables(section: Section, board: Leaderboard) -> list[Table]:
    """Return the tables of a section per protocol and condition, and its costs."""
    tables = [table for plan in section.plans for table in _plan_tables(section, plan)]
    if tables:
        tables[0] = replace(tables[0], notes=[*_section_notes(section, board), *tables[0].notes])
        tables[-1] = replace(tables[-1], notes=[*tables[-1].notes, *board.provenance])
    costs = replace(_costs(section), formats=WRITTEN)
    return [table for table in (*tables, costs) if table.rows]


def _plan_tables(section: Section, plan: tuple[str, str]) -> Iterator[Table]:
    """Yield the board of a protocol and condition, or a table per data set."""
    if plan in section.boards:
        yield from plan_board(section.boards[plan], plan)
        return
    yield from _of_datasets(section, section.plans[plan])


def dataset_tables(section: Section) -> list[Table]:
    """Return a table per data set, protocol and condition."""
    return [table for answer in section.plans.values() for table in _of_datasets(section, answer)]


def _of_datasets(section: Section, answer: Answer) -> Iterator[Table]:
    for cases in grouped(answer.cases, lambda case: case.name.dataset).values():
        yield _dataset_table(section, answer.over(cases))


def plan_board(
    board: Board, plan: tuple[str, str], controls: Mapping[str, str] | None = None
) -> list[Table]:
    """Return the tables of a board, the first with headline and sentences."""
    first, *further = board_tables(board, controls or {})
    texts = [f"{sentence.label}: {sentence.text}" for sentence in board_sentences(board)]
    caveats = caveats_of(case.case for case in board.answer.cases)
    title = f"{board_headline(board)} | {' | '.join(filter(None, plan))}"
    tables = [replace(first, title=title, notes=[*texts, *first.notes, *caveats]), *further]
    about = dict(zip(("protocol", "condition"), plan, strict=True))
    return [replace(table, about={**table.about, **about}) for table in tables]


@dataclass(frozen=True)
class _ModelInCase:
    """A row of a data set's table."""

    name: Name
    case: ScoredCase
    answer: Answer
    like_best: frozenset[str] | None

    @property
    def _estimates(self) -> Sequence[Estimate]:
        is_reference = self.name.text == REFERENCE_MODEL
        return [] if is_reference else self.answer.estimates(self.name.text, self.case)

    def score(self) -> Quantity:
        """Return mean and standard deviation over splits, with the mark of the best."""
        _, factor = PRINTED[self.answer.key.metric.unit]
        if self.name.text not in self.case.scores:
            return Quantity(status=self.case.failed(self.name.text))
        values = factor * self.case.scores[self.name.text]
        spread = float(values.std(ddof=1)) if len(values) > 1 else None
        mark = ""
        if self.name.text == self.answer.best(self.case):
            mark = BEST
        elif self.like_best is not None and self.name.text in self.like_best:
            mark = LIKE_BEST
        return Quantity(float(values.mean()), spread, n=len(values), mark=mark)

    def change(self) -> float | None:
        """Return the change of the error against the VJM's, in %."""
        ratio = self.answer.ratio(self.name.text, self.case)
        return None if ratio is None else 100.0 * (ratio - 1.0)

    def over(self, number: int) -> Quantity | None:
        """Return the interval of the difference from the VJM: 0 over splits, 1 over poses."""
        of_both: list[Estimate | None] = [*self._estimates]
        if len(of_both) == 1:
            of_poses = self.case.errors.of_splits is None
            of_both = [None, *of_both] if of_poses else [*of_both, None]
        estimate = of_both[number] if number < len(of_both) else None
        if estimate is None:
            return None
        _, factor = PRINTED[self.answer.key.metric.unit]
        return Quantity(low=factor * estimate.low, high=factor * estimate.high)

    def verdict(self) -> str | None:
        """Return the verdict against the VJM."""
        if self.name.text == REFERENCE_MODEL:
            return "baseline"
        verdict = self.answer.verdict(self.name.text, self.case)
        return None if verdict is None else VERDICT_MARKS[verdict]


def _dataset_table(section: Section, answer: Answer) -> Table:
    """Return the models on a data set, best first, with intervals."""
    key = answer.key
    unit, _ = PRINTED[key.metric.unit]
    apart = f" | {SELECTION_MARK}s: not a fair comparison" if section.selects_on_test else ""
    names = [name for case in answer.cases for name in case.case.competitors]
    rows = []
    for case in answer.cases:
        like = case.like_best(case.models) if case.scores and not key.is_cost else None
        present = [name for name in dict.fromkeys(names) if name in section.models]
        present.sort(key=lambda name: (name not in case.scores, _signed(key, case, name), name))
        rows += [
            _ModelInCase(
                Name(name, section.answer.mark(name, case.name.protocol)),
                *(case, answer, None if like is None else frozenset(like)),
            )
            for name in present
        ]
    first = answer.cases[0]
    case_labels = labels(case.name for case in answer.cases)
    several = [] if len(answer.cases) == 1 else text_columns("seed")
    title = case_labels[first.name] if not several else first.name.text
    intervals = [
        Column(
            f"over {name}",
            *("number", unit, number_format(key.metric), "difference from the VJM"),
            value=partial(_interval_over, number),
        )
        for number, name in enumerate(("splits", "poses"))
        if any(row.over(number) for row in rows)
    ]
    columns = [
        Column("model", "text", value=lambda row: row.name),
        *(Column("seed", "text", value=lambda row: str(row.case.name.seed)) for _ in several),
        Column(
            key.text,
            unit=unit,
            format=number_format(key.metric),
            about={"metric": key.metric.key, "axis": key.axis},
            value=lambda row: row.score(),
        ),
        Column("vs VJM", unit="%", format="+.0f", by_sign=-1, value=lambda row: row.change()),
        *intervals,
        Column("verdict", "text", value=lambda row: row.verdict()),
    ]
    kind = first.case.presentation.kind
    return Table.of(
        f"{title} ({kind}), {counted(len(first.slots), 'split')}{apart}",
        columns,
        rows,
        [*_marks(answer, key), *caveats_of(case.case for case in answer.cases)],
        unit=unit,
        about={
            **{"table": "data set", "dataset": first.name.dataset, "kind": kind},
            **{"protocol": first.name.protocol, "condition": first.name.condition},
        },
        best_first=True,
    )


def _interval_over(number: int, row: _ModelInCase) -> Quantity | None:
    return row.over(number)


def _signed(key: SortKey, case: ScoredCase, name: str) -> float:
    return key.sign * case.mean(name) if name in case.scores else math.inf


def _marks(answer: Answer, key: SortKey) -> Iterator[str]:
    """Yield explanations of the marks, and a note if there are few splits."""
    like = (
        ""
        if key.is_cost
        else f"; {LIKE_BEST} no significant difference from it, {correction_text(answer.cases)}"
    )
    yield f"{BEST} best mean{like}."
    if not key.is_cost:
        yield (
            f"difference: {percent(1.0 - LEVEL)} intervals; over poses the fitted models are held "
            "fixed."
        )
    yield from _few_splits(answer.cases)


FEW_SPLITS = 5
"""Number of splits below which only very large differences are significant."""


def _few_splits(scored: Sequence[ScoredCase]) -> Iterator[str]:
    fewest = min(len(case.slots) for case in scored)
    if scored[0].key.is_cost or not 1 < fewest < FEW_SPLITS or scored[0].case.presentation.pooled:
        return
    yield f"{fewest} splits show only very large differences; --splits {FEW_SPLITS} shows more."


def _section_notes(section: Section, board: Leaderboard) -> Iterator[str]:
    """Yield notes on all tables, most important first."""
    yield from dict.fromkeys(
        scored.case.presentation.warning
        for scored in section.cases
        if scored.case.presentation.warning
    )
    answer = section.answer
    if not section.boards and not answer.key.is_cost:
        number = counted(len(answer.robots), "robot")
        yield (
            f"{number}: too few for a claim about other robots; a board over robots needs at "
            f"least {FEWEST_ROBOTS} simulated or {FEWEST_ROBOTS} measured ones."
        )
    case_labels = labels(scored.case.name for scored in section.cases)
    if section.missing and section.boards.keys() != section.plans.keys():
        yield f"Scores are missing: {_missing_text(section.missing, case_labels)}."
    cut = [scored for scored in section.cases if scored.left_out]
    if cut:
        yield f"{case_labels[cut[0].name]}{and_more(cut)}: {cut[0].left_out}."
    if board.notes:
        yield f"{board.notes[0].removesuffix('.')}{and_more(board.notes)}."


MOST_LISTED = 4
"""Largest number of missing results that are listed individually."""


def _missing_text(
    missing: Mapping[str, Mapping[CaseName, str]], case_labels: Mapping[CaseName, str]
) -> str:
    """Return the missing results of each model with reasons, or their numbers."""
    every = sum(map(len, missing.values())) <= MOST_LISTED
    parts = []
    for model, of_model in missing.items():
        reasons = grouped(of_model, of_model.__getitem__).items()
        places = [
            f"{', '.join(map(case_labels.__getitem__, cases))}: {reason}"
            for reason, cases in reasons
        ]
        named = f" ({'; '.join(places)})" if every else ""
        parts.append(f"{len(of_model)} of {len(case_labels)} results of {model}{named}")
    if every:
        return ", ".join(parts)
    return f"{first_few(parts)}; `--format json` lists them with reasons"


class Model(NamedTuple):
    """A row of the costs."""

    section: Section
    name: str

    @property
    def marked(self) -> Name:
        """Return the name with its mark."""
        return Name(self.name, self.section.answer.mark(self.name))

    @property
    def costs(self) -> list[Cost]:
        """Return the recorded costs of the scored fits."""
        cases = [case for case in self.section.cases if self.name in case.scores]
        costs = (result.cost for case in cases for result in case.results[self.name])
        return [cost for cost in costs if cost is not None]


def _costs(section: Section) -> Table:
    """Return the costs of models; models without recorded costs are omitted."""
    models = [Model(section, name) for name in section.models]
    n_fits = sum(len(model.costs) for model in models)
    return Table.of(
        f"Costs of {counted(n_fits, 'fit')} | median (lowest to highest)",
        COSTS,
        [model for model in models if model.costs],
        ["wall times depend on the machine; a cached pre-training costs nothing."],
        about=_about(section, "costs"),
    )


def _about(section: Section, table: str) -> dict[str, object]:
    return {"table": table, "selects_on_test": section.selects_on_test}


def _spread(key: str, model: Model) -> Quantity | None:
    """Return median and range of a cost over the fits that recorded it."""
    metric = METRICS[key]
    assert metric.of_cost is not None
    _, factor = PRINTED[metric.unit]
    values = [factor * value for value in map(metric.of_cost, model.costs) if value is not None]
    return Quantity(float(np.median(values)), low=min(values), high=max(values)) if values else None


def _range(cost: Quantity, unit: str, number: Callable[[float], str]) -> str:
    """Return "2 ms (1 to 3)", or "2 ms" if all are equal."""
    median, low, high = (number(value or 0.0) for value in (cost.value, cost.low, cost.high))
    text = f"{median} {unit}".rstrip()
    return text if low == high else f"{text} ({low} to {high})"


def _time(cost: Quantity) -> str:
    """Return a time [ms] in a suitable unit."""
    units = (("us", 1e3), ("ms", 1.0), ("s", 1e-3))
    median = cost.value or 0.0
    unit, factor = next((size for size in units if median * size[1] < 999.5), units[-1])
    return _range(cost, unit, lambda value: _three_digits(value * factor))


def _three_digits(value: float) -> str:
    """Format a positive number with three significant digits: 0.0123, 1.23, 12,300."""
    decimals = 2 - math.floor(math.log10(value)) if value > 0.0 else 0
    return f"{round(value, decimals):,.15g}"


def _cost_column(key: str, name: str, written: Callable[[Quantity], str]) -> Column:
    unit, _ = PRINTED[METRICS[key].unit]
    return Column(
        name, unit=unit, format=written, about={"metric": key}, value=partial(_spread, key)
    )


COSTS = (
    Column("model", "text", value=lambda model: model.marked),
    _cost_column("fit-time", "fit time", _time),
    _cost_column("throughput", "predictions/s", lambda cost: _range(cost, "", _three_digits)),
    _cost_column("latency", "latency of one", _time),
    _cost_column("memory", "memory [MiB]", lambda cost: _range(cost, "", "{:.1f}".format)),
    Column("fits", value=lambda model: len(model.costs)),
)
"""Columns of the costs; each value comes from a `Model`."""


def _scores(section: Section, board: Leaderboard) -> Table:
    """Return the scores of all models in all cases, or the reasons for missing ones."""
    unit, factor = PRINTED[board.key.metric.unit]
    rows: list[list[Entry]] = [
        [
            Name(model, section.answer.mark(model, case.name.protocol)),
            *astuple(case.name),
            *(len(case.slots), case.left_out),
            factor * case.mean(model)
            if model in case.scores
            else Quantity(status=case.missing.get(model, "")),
        ]
        for case in section.cases
        for model in section.models
    ]
    return Table(
        f"Scores | {board.key.text}",
        [
            *text_columns(
                "model", *(field.name for field in fields(CaseName)), "splits", "splits left out"
            ),
            Column(board.key.text, unit=unit, format=number_format(board.key.metric)),
        ],
        rows,
        board.notes,
        about=_about(section, "scores"),
        formats=("json",),
    )
