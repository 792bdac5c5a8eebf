"""The scores of every model in every contest, one line each. Here SI becomes mm."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

from stiff_bench.analysis.collected import Competitor, Contest, asked_for
from stiff_bench.analysis.leaderboard import Leaderboard, Section, caveats_of, presentation
from stiff_bench.analysis.leaderboard_tables import section_tables
from stiff_bench.report.content import Block, Fold
from stiff_bench.report.page import MOST_ROWS
from stiff_bench.store.names import ContestName, labels, natural_key
from stiff_bench.tables.fit_notes import model_notes
from stiff_bench.tables.metric_table import mark_of, metric_cells, metric_columns, metric_values
from stiff_bench.tables.table import Cell, Column, Name, Quantity, Table
from stiff_bench.tables.units import counted
from stiff_protocols.contract.plugin import kind_label
from stiff_protocols.scoring.metrics import METRICS, Metric


def board_block(section: Section, board: Leaderboard, *, heading: str, command: str) -> Block:
    """Return ranks, scores by protocol, critical differences and costs of one section."""
    return Block(heading, tables=section_tables(section, board, ()), command=command)


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
    lines: list[list[Cell]] = []
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
    table = Table("Data sets", [Column(name, "text") for name in header], rows)
    return Block("Data sets", tables=[table])


def _order(contest: Contest) -> tuple[object, ...]:
    name = contest.name
    return (*map(natural_key, (name.protocol, name.condition, name.dataset)), _rest(name))


def _rest(name: ContestName) -> tuple[int, str, str]:
    return name.seed, name.data_sha256, name.source_sha256


def _line(
    contest: Contest, competitor: Competitor, metrics: Sequence[Metric]
) -> tuple[list[Cell], list[str]]:
    """Return the cells of a model in a contest, and what its fits reported."""
    shown, name = competitor.shown, contest.name
    results = contest.results(competitor.name)
    n_asked = max(competitor.n_asked, len(competitor.done) + len(competitor.failures))
    values = metric_values(results, metrics) if results else {}
    cells: list[Cell] = [
        Name(shown.model, mark_of(shown)),
        *(name.dataset, name.protocol, name.condition or "-", name.seed),
        Quantity(share=(len(results), n_asked)),
        *(cell for metric in metrics for cell in metric_cells(values, [metric])),
    ]
    return cells, model_notes(results) if results else []


def _table(lines: Sequence[list[Cell]], n_all: int, metrics: Sequence[Metric]) -> Table:
    texts = ("model", "data set", "protocol", "condition")
    notes = ["splits: with a result, of those that were asked for."]
    if len(lines) < n_all:
        notes.append(
            f"The first {len(lines)} of {n_all} rows are shown; --dataset, --protocol and --model "
            "name fewer; `bench leaderboard --format csv` prints all."
        )
    return Table(
        "Scores",
        [
            *(Column(name, "text") for name in texts),
            *(Column("seed"), Column("splits")),
            *(column for metric in metrics for column in metric_columns([metric])),
        ],
        lines,
        notes,
    )


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
