"""The scores of every model in every contest, one line each. Here SI becomes mm."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

from stiff_bench.collected import Competitor, Contest, asked_for
from stiff_bench.contest_choice import caveats_of, presentation
from stiff_bench.contest_name import ContestName, labels
from stiff_bench.fit_notes import model_notes
from stiff_bench.natural_order import natural_key
from stiff_bench.render import TextTable, value_text
from stiff_bench.report.content import Block, Fold, PageTable
from stiff_bench.report.sorting import MOST_ROWS, page_table
from stiff_bench.tables import Row, build_tables, mark_of
from stiff_bench.units import PRINTED
from stiff_bench.words import counted, marked
from stiff_protocols.metrics import METRICS, Metric
from stiff_protocols.plugin import kind_label

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
    n_asked = max(competitor.n_asked, len(competitor.done) + len(competitor.reasons))
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
