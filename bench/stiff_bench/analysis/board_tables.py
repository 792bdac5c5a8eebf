"""Write a board as a headline, sentences and tables; errors are ratios without unit."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator, Mapping, Sequence
from functools import partial
from operator import attrgetter

from stiff_bench.analysis.answer_text import Sentence
from stiff_bench.analysis.board import Board, BoardRow, ControlRow
from stiff_bench.store.names import grouped
from stiff_bench.tables.table import Column, Entry, Name, Quantity, Table
from stiff_bench.tables.units import counted, duration, first_few, percent
from stiff_models.model_catalog import REFERENCE_MODEL
from stiff_protocols.scoring.over_robots import MARGIN, MeanRatio
from stiff_protocols.scoring.paired import LEVEL

RATIO_FORMAT = ".2f"
CLOSE_FORMAT = ".3f"
"""Format of two ratios that may be close."""
INTERVAL = f"{percent(1.0 - LEVEL)} interval"
EQUAL_TEXT = f"{percent(math.exp(MARGIN) - 1.0)}"
VERDICT_MARKS = {"a": "better", "b": "worse", "equivalent": "same", "open": "open", None: ""}


def board_headline(board: Board) -> str:
    """Return the answer in one line: the best model, its gain and uncertainty."""
    lead, scope = leader(board), board.answer.claim_scope
    if lead is None or lead.verdict != "better":
        return f"No model is reliably better than the VJM over {scope}"
    return (
        f"Use {lead.name}: {lead.mean.ratio:{RATIO_FORMAT}} times the VJM's error "
        f"({_bounds(lead.mean)}, {INTERVAL} over {scope})"
    )


def leader(board: Board) -> BoardRow | None:
    """Return the best model except the VJM; None: there is none."""
    return next((row for row in board.rows if row.name != REFERENCE_MODEL), None)


def board_sentences(board: Board) -> list[Sentence]:
    """Return the sentences after the headline: certainty, exceptions, measured robots."""
    lead = leader(board)
    if lead is None:
        return []
    lines = [Sentence("How sure", _how_sure(board, lead))]
    if exceptions := " ".join(_exceptions(board, lead)):
        lines.append(Sentence("But", exceptions))
    return [*lines, Sentence("Data", _data(board, lead))]


def _how_sure(board: Board, lead: BoardRow) -> str:
    low, high = lead.without_one
    rivals = [row.name for row in board.rows if row.name != lead.name and not row.p_best < LEVEL]
    rival_text = (
        f"Not significantly worse: {first_few(rivals)}."
        if rivals
        else "Every other model is significantly worse."
    )
    return (
        f"It has the smallest error on {lead.won} of {counted(lead.mean.n_robots, 'robot')}. "
        f"Without any one robot the ratio lies between {low:{RATIO_FORMAT}} and "
        f"{high:{RATIO_FORMAT}}. {rival_text}"
    )


def _exceptions(board: Board, lead: BoardRow) -> Iterator[str]:
    """Yield robots and groups of data sets with a clearly better model."""
    ahead = [
        f"{name} on {robot} ({board.robot_ratio(robot, name):{CLOSE_FORMAT}} against "
        f"{board.robot_ratio(robot, lead.name):{CLOSE_FORMAT}})"
        for robot, name in board.winners.items()
        if _is_ahead(board.robot_ratio(robot, name), board.robot_ratio(robot, lead.name))
    ]
    if ahead:
        yield f"Another model is more than {EQUAL_TEXT} better: {first_few(ahead, 2)}."
    for group in board.groups:
        scores = {row.name: row.groups[group] for row in board.rows if group in row.groups}
        best = min(scores, key=lambda name: scores[name], default=lead.name)
        if lead.name in scores and _is_ahead(scores[best], scores[lead.name]):
            yield (
                f"On the data sets {group!r} {best} is ahead ({scores[best]:{RATIO_FORMAT}} "
                f"against {scores[lead.name]:{RATIO_FORMAT}})."
            )
    yield f"Its worst robot is {lead.worst_robot} ({lead.worst:{RATIO_FORMAT}})."


def _is_ahead(ratio: float, of_leader: float) -> bool:
    """Return True if a ratio is smaller by more than the practical margin."""
    return math.log(of_leader / ratio) > MARGIN


def _data(board: Board, lead: BoardRow) -> str:
    """Return the number of measured robots, and the scores on them."""
    kinds = [cases[0].case.presentation.kind for cases in board.answer.robots.values()]
    n_measured, n_all = kinds.count("measured"), len(kinds)
    verb = "is" if n_measured == 1 else "are"
    text = f"{n_measured} of {counted(n_all, 'robot')} {verb} measured"
    for dataset, cases in board.measured.items():
        scores = {row.name: row.measured[dataset] for row in board.rows if dataset in row.measured}
        if lead.name not in scores:
            continue
        lead_score = scores[lead.name]
        best = min(scores, key=lambda name: scores[name].ratio)
        text += (
            f"; on {dataset} ({counted(len(cases[0].data.measured), 'sample')}) {lead.name} has "
            f"{lead_score.ratio:{RATIO_FORMAT}} times the VJM's error "
            f"({VERDICT_MARKS[lead_score.verdict] or 'not tested'})"
        )
        if best != lead.name:
            text += f"; smallest on the board: {best} ({scores[best].ratio:.2f})"
    return f"{text}."


MEASURED_NOTE = (
    "measured: p is corrected (Holm) for all pairs of models, so a verdict can be open although an "
    "interval excludes zero; same: equivalent."
)
"""Note on the columns of measured data."""


def board_tables(board: Board, controls: Mapping[str, str]) -> list[Table]:
    """Return the tables: ratios, further numbers, certainty, and controls."""
    rows = board.rows
    tables = [_ratios(board), _more(board), _certainty(board)]
    if control_rows := board.controls(controls):
        tables.append(_controls(control_rows))
    return [table for table in tables if len(table.columns) > 1 and rows]


def _ratios(board: Board) -> Table:
    scope = board.answer.claim_scope
    measured = [
        Column(
            f"{dataset} (measured)",
            format=RATIO_FORMAT,
            value=partial(_measured, dataset),
        )
        for dataset in board.measured
    ]
    table = Table.of(
        f"Error over the VJM's, geometric mean over {scope}",
        [
            *_model_columns(),
            Column("verdict", "text", value=_verdict_text),
            Column("won", value=_won),
            Column(
                "worst robot",
                format=RATIO_FORMAT,
                marks_shown=False,
                value=_worst,
            ),
            *measured,
            Column("fit", unit="s", format=_fit_text, value=lambda row: row.fit_s),
        ],
        board.rows,
        [
            f"{INTERVAL} over robots (Student's t of the logarithms); one vote per robot.",
            "verdict against the VJM: significant over robots (sign flips, Holm), or open; won: "
            "robots with the smallest error.",
            *([MEASURED_NOTE] if measured else []),
            *_split_notes(board),
        ],
        about={"table": "board"},
        best_first=True,
    )
    return table


def _model_columns() -> list[Column]:
    return [
        Column("model", "text", value=lambda row: Name(row.name, row.mark)),
        Column("error / VJM's", format=RATIO_FORMAT, value=lambda row: row.mean.ratio),
        Column(INTERVAL, format=RATIO_FORMAT, value=lambda row: _interval(row.mean)),
    ]


def _worst(row: BoardRow) -> Quantity | None:
    is_baseline = row.name == REFERENCE_MODEL
    return None if is_baseline else Quantity(row.worst, mark=row.worst_robot)


def _won(row: BoardRow) -> Quantity:
    return Quantity(share=(row.won, row.mean.n_robots))


def _fit_text(fit: Quantity) -> str:
    return duration(fit.value)


def _verdict_text(row: BoardRow) -> str:
    return "baseline" if row.name == REFERENCE_MODEL else row.verdict


def _measured(dataset: str, row: BoardRow) -> Entry:
    score = row.measured.get(dataset)
    if score is None:
        return None
    return Quantity(score.ratio, status=VERDICT_MARKS[score.verdict])


def _split_notes(board: Board) -> Iterator[str]:
    """Yield notes on models with fewer splits and on models without every score."""
    fewer = {name: counts for name, counts in board.n_splits.items() if counts[0] < counts[1]}
    for text, is_shown in (
        ("With fewer splits", True),
        ("Not on the board, without every score", False),
    ):
        groups = grouped(
            (name for name in fewer if (name in board.logs) == is_shown), lambda name: fewer[name]
        )
        of_counts = [
            f"{first_few(names)} ({there} of {n_all})" for (there, n_all), names in groups.items()
        ]
        if of_counts:
            yield f"{text}: {'; '.join(of_counts)}."


def _more(board: Board) -> Table:
    single = {"p95": "95th percentile", "path": "tool paths", "noise": "noise"}
    values: dict[str, Callable[[BoardRow], float | None]] = {
        heading: attrgetter(attribute)
        for attribute, heading in single.items()
        if any(getattr(row, attribute) is not None for row in board.rows)
    }
    values |= {name: partial(_of_few, name) for name in board.few}
    values |= {name: partial(_of_group, name) for name in board.groups}
    columns = [Column(name, format=RATIO_FORMAT, value=value) for name, value in values.items()]
    over_noise = "noise: over the error of the instrument's noise"
    meanings = {"path": "tool paths: error left after the correction", "noise": over_noise}
    notes = [f"{text}." for attribute, text in meanings.items() if single[attribute] in values]
    if len(values) > 1:
        notes.insert(0, f"All numbers{' except noise' * ('noise' in values)} are over the VJM's.")
    model = Column("model", "text", value=lambda row: row.name)
    return Table.of(
        "Other numbers of the same models, geometric means over robots",
        [model, *columns],
        board.rows,
        notes,
        about={"table": "more"},
    )


def _equal_text(row: BoardRow, best: str) -> str | None:
    return None if row.name == best else "yes" if row.like_best else "no"


def _of_few(name: str, row: BoardRow) -> float | None:
    return row.few.get(name)


def _of_group(name: str, row: BoardRow) -> float | None:
    return row.groups.get(name)


def _certainty(board: Board) -> Table:
    return Table.of(
        f"How sure, over {board.answer.claim_scope}",
        [
            Column("model", "text", value=lambda row: row.name),
            Column("p against the VJM", format=".2g", value=lambda row: _number(row.p_reference)),
            Column("p against the best", format=".2g", value=lambda row: _number(row.p_best)),
            Column(
                f"within {EQUAL_TEXT} of the best",
                "text",
                value=lambda row: _equal_text(row, board.best),
            ),
            Column(
                "without any one robot",
                format=RATIO_FORMAT,
                value=lambda row: Quantity(low=row.without_one[0], high=row.without_one[1]),
            ),
        ],
        board.rows,
        [
            "p: all choices of signs of the robots' differences, corrected (Holm) for all models.",
            f"within {EQUAL_TEXT}: shown by two one-sided t tests.",
        ],
        about={"table": "certainty"},
    )


def _controls(rows: Sequence[ControlRow]) -> Table:
    return Table.of(
        "Models against their physics model or teacher",
        [
            Column("model", "text", value=lambda row: row.name),
            Column("against", "text", value=lambda row: row.control),
            Column("error ratio", format=RATIO_FORMAT, value=lambda row: row.mean.ratio),
            Column(INTERVAL, format=RATIO_FORMAT, value=lambda row: _interval(row.mean)),
            Column("p", format=".2g", value=lambda row: row.p_value),
            Column("equal", "text", value=lambda row: "yes" if row.is_equal else "no"),
        ],
        rows,
        [f"equal: within {EQUAL_TEXT} (two one-sided t tests); p: sign flips over robots, Holm."],
        about={"table": "controls"},
    )


def _interval(mean: MeanRatio) -> Quantity:
    return Quantity(low=mean.low, high=mean.high)


def _number(value: float) -> float | None:
    return None if math.isnan(value) else value


def _bounds(mean: MeanRatio) -> str:
    return f"{mean.low:{RATIO_FORMAT}} to {mean.high:{RATIO_FORMAT}}"
