"""The scores of every model in every contest, one line each. Here SI becomes mm."""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence
from itertools import islice

from stiff_bench.analysis.collected import Competitor, Contest, asked_for
from stiff_bench.analysis.leaderboard import Leaderboard, Section, caveats_of, presentation
from stiff_bench.analysis.leaderboard_tables import section_tables
from stiff_bench.report.content import Block, Cell, Fold, Kind, PageTable
from stiff_bench.store.names import ContestName, labels, natural_key
from stiff_bench.tables.fit_notes import model_notes
from stiff_bench.tables.render import TextTable, value_text
from stiff_bench.tables.table import Row, build_tables, mark_of
from stiff_bench.tables.units import PRINTED, counted, marked
from stiff_protocols.contract.plugin import kind_label
from stiff_protocols.scoring.metrics import METRICS, Metric

MOST_ROWS = 2000
"""So many rows of a table are embedded; the page says where there are more."""
_NUMBER = re.compile(
    r"[<>]?\s*([+-]?\d[\d,]*(?:\.\d+)?(?:e[+-]?\d+)?)(?:\s(us|ms|s)\b)?"
    r"(?=$|/\d|\s(?:±|\*|≈|to\b|of\b|MiB\b|\(|:))"
)
"""How a cell begins that is sorted by a number; a date, a commit and a version are none."""
_MISSING = re.compile(r"-?|FAILED.*|SKIPPED.*", re.DOTALL)
_SECONDS = {"us": 1e-6, "ms": 1e-3, "s": 1.0, None: 1.0}
_DIGITS = re.compile(r"\d+")
_LONGEST_ORDER = 60  # characters of a text that it is sorted by
_LONG = 40  # characters of a text that needs room


def page_table(table: TextTable, *, command: str = "", widget: bool = True) -> PageTable:
    """Return a table of texts as one of the page, cut to `MOST_ROWS`."""
    rows = [*islice(table.rows, MOST_ROWS)]
    columns = [[row[column] for row in rows] for column in range(len(table.header))]
    kinds = tuple(_kind(column) if number else "text" for number, column in enumerate(columns))
    notes = [*table.notes]
    if len(rows) < len(table.rows):
        notes.append(
            f"The first {len(rows)} of {len(table.rows)} rows are shown; name fewer models, data "
            "sets or protocols for the others."
        )
    return PageTable(
        caption=table.title,
        header=tuple(table.header),
        kinds=kinds,
        rows=tuple(
            tuple(_cell(text, kind) for text, kind in zip(row, kinds, strict=True)) for row in rows
        ),
        notes=tuple(notes),
        command=command,
        widget=widget,
    )


def number_in(text: str) -> float | None:
    """Return the number that a text begins with, times in s; None where it begins with none.

    >>> number_in("1.5 ms (1.2 to 2)"), number_in("12,300"), number_in("< 0.001"), number_in("-")
    (0.0015, 12300.0, 0.001, None)
    """
    found = _NUMBER.match(text)
    if found is None:
        return None
    return float(found[1].replace(",", "")) * _SECONDS[found[2]]


def natural_order(text: str) -> str:
    """Return a text that sorts as people count: "n = 5" stands before "n = 10".

    >>> sorted(["n = 10", "n = 5"], key=natural_order)
    ['n = 5', 'n = 10']
    """
    return _DIGITS.sub(lambda found: found[0].zfill(6), text.lower())[:_LONGEST_ORDER]


def _kind(texts: Sequence[str]) -> Kind:
    present = [text for text in texts if not _MISSING.fullmatch(text)]
    if present and all(number_in(text) is not None for text in present):
        return "number"
    return "long" if any(len(text) > _LONG for text in present) else "text"


def _cell(text: str, kind: Kind) -> Cell:
    if kind != "number":
        return Cell(text, natural_order(text))
    number = number_in(text)
    return Cell(text, "" if number is None else f"{number:.12g}")


def board_block(section: Section, board: Leaderboard, *, heading: str, command: str) -> Block:
    """Return ranks, scores by protocol, critical differences and costs of one section."""
    first, *others = section_tables(section, board, ())
    return Block(
        heading,
        tables=[page_table(first, command=command), *(page_table(text) for text in others)],
    )


MOST_NOTES = 200
"""So many notes on fits are embedded."""
_ALWAYS = ("norm", "mae", "stde", "me")


def score_block(contests: Sequence[Contest], models: Sequence[str], metric: str) -> Block:
    """Return the scores of models in contests, whether or not they can be ranked.

    Args:
        contests: to show.
        models: words of the command line; none named means all.
        metric: that is ranked by; it stands first.
    """
    metrics = [METRICS[key] for key in dict.fromkeys((metric, *_ALWAYS))]
    lines: list[list[str]] = []
    notes: dict[str, list[str]] = {}
    n_all = 0
    called = labels(contest.name for contest in contests)
    for contest in sorted(contests, key=_order):
        for name, competitor in contest.competitors.items():
            if not asked_for(name, models):
                continue
            n_all += 1
            if len(lines) < MOST_ROWS:
                line, said = _line(contest, competitor, metrics)
                lines.append(line)
                for note in said:
                    notes.setdefault(note, []).append(called[contest.name])
    return Block(
        "Scores in each contest",
        ["Mean ± standard deviation over the splits that a model has a result on."],
        [_table(lines, n_all, metrics)],
        folds=_fit_notes(notes),
        notes=caveats_of(contests),
    )


def data_block(contests: Sequence[Contest]) -> Block:
    """Return which data the contests are of."""
    of_data = {contest.name.data_sha256: contest for contest in contests}
    rows = [
        [
            contest.name.dataset,
            kind_label(presentation(contest).kind, presentation(contest).task),
            sha256,
            "; ".join(presentation(contest).caveats) or "-",
        ]
        for sha256, contest in sorted(
            of_data.items(), key=lambda item: (natural_key(item[1].name.dataset), item[0])
        )
    ]
    header = ("data set", "kind", "sha256 of its numbers", "what must be read with it")
    return Block("Data sets", tables=[page_table(TextTable("Data sets", header, rows, ()))])


def _order(contest: Contest) -> tuple[object, ...]:
    name = contest.name
    return (*map(natural_key, (name.protocol, name.condition, name.dataset)), _rest(name))


def _rest(name: ContestName) -> tuple[int, str, str]:
    return name.seed, name.data_sha256, name.source_sha256


def _line(
    contest: Contest, competitor: Competitor, metrics: Sequence[Metric]
) -> tuple[list[str], list[str]]:
    """Return the cells of a model in a contest, and what its fits reported."""
    shown, name = competitor.shown, contest.name
    results = contest.results(competitor.name)
    n_asked = max(competitor.n_asked, len(competitor.done) + len(competitor.failures))
    about = [
        marked(shown.model, mark_of(shown)),
        *(name.dataset, name.protocol, name.condition or "-", str(name.seed)),
        f"{len(results)}/{n_asked}",
    ]
    if not results:
        return [*about, *["-" for metric in metrics for _ in metric.axes]], []
    (table,) = build_tables(results, metrics)
    return [*about, *_values(table.rows[0], metrics)], model_notes(results)


def _values(row: Row, metrics: Sequence[Metric]) -> list[str]:
    return [
        value_text(row.values.get((metric.key, axis))) for metric in metrics for axis in metric.axes
    ]


def _table(lines: Sequence[list[str]], n_all: int, metrics: Sequence[Metric]) -> PageTable:
    headings = [_heading(metric, axis) for metric in metrics for axis in metric.axes]
    header = ("model", "data set", "protocol", "condition", "seed", "splits", *headings)
    notes = ["splits: with a result, of those that were asked for."]
    if len(lines) < n_all:
        notes.append(
            f"The first {len(lines)} of {n_all} rows are shown; --dataset, --protocol and --model "
            "name fewer; `bench leaderboard --format csv` prints all."
        )
    return page_table(TextTable("Scores", header, lines, notes))


def _heading(metric: Metric, axis: str) -> str:
    unit, _ = PRINTED[metric.unit]
    words = [
        axis.upper() if len(metric.axes) > 1 else "",
        metric.label,
        f"[{unit}]" if unit else "",
    ]
    return " ".join(filter(None, words))


def _fit_notes(notes: Mapping[str, Sequence[str]]) -> list[Fold]:
    """Return what fits reported, in a fold; nothing where they reported nothing."""
    if not notes:
        return []
    lines = [
        f"{places[0]}{f' and {len(places) - 1} more' if len(places) > 1 else ''}: {note}"
        for note, places in notes.items()
    ]
    more = f"; the first {MOST_NOTES} are shown" if len(lines) > MOST_NOTES else ""
    summary = f"What the fits reported: {counted(len(lines), 'note')}{more}"
    return [Fold(summary, "\n".join(lines[:MOST_NOTES]))]
