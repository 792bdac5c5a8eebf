"""A comparison as tables, between its sentence above and beneath. Here SI becomes mm."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

from stiff_bench.analysis.compare import Across, Report
from stiff_bench.analysis.comparison import NORM, Row
from stiff_bench.analysis.comparison_words import (
    SELECTS_ON_TEST,
    chance_text,
    contest_marks,
    error_label,
    name_with_mark,
    notes,
    sentence,
)
from stiff_bench.analysis.verdict import Estimate, Verdict, decide
from stiff_bench.analysis.where import Place
from stiff_bench.store.names import label_parts
from stiff_bench.tables.metric_table import mark_of
from stiff_bench.tables.render import DETAILED, render
from stiff_bench.tables.table import Cell, Column, Name, Quantity, Table
from stiff_bench.tables.units import MM, PRINTED, percent
from stiff_protocols.contract.plugin import kind_label

VERDICTS: dict[Verdict, str] = {
    "a": "A better",
    "b": "B better",
    "equivalent": "equivalent",
    "open": "not told apart",
}


def verdict_text(verdict: Verdict, *, of_fits: bool) -> str:
    """Return a verdict for people.

    Args:
        verdict: which.
        of_fits: it is of the fitted models alone, not of how they are trained.
    """
    text = VERDICTS[verdict]
    return f"{text} (these fits)" if of_fits and verdict != "open" else text


def place_text(place: Place) -> str:
    """Return which place it is, with unit."""
    if place.low is None or place.high is None:
        return f"{place.factor}: {place.label}"
    unit, scale = PRINTED["m"] if place.unit == "m" else (place.unit, 1.0)
    decimals = 0 if abs(scale * place.high) >= 100.0 else 1
    low, high = (f"{scale * value:.{decimals}f}" for value in (place.low, place.high))
    return f"{place.factor} {low} to {high} {unit}"


def render_report(report: Report, fmt: str) -> str:
    """Return the report as text of the given format: the sentence, the tables, the sentence."""
    about: dict[str, object] = {"a": report.a, "b": report.b}
    asked = {"rope_mm": MM * report.question.rope, "confidence": report.question.confidence}
    named = _tables(report)
    if fmt in DETAILED:
        named["estimates"] = _estimates(report)
    tables = [replace(one, about=about | {"table": name}) for name, one in named.items()]
    return render(tables, fmt, report.command, text=sentence(report), about=about | asked)


def _tables(report: Report) -> dict[str, Table]:
    """Return name -> table; the last one has the notes."""
    places = report.where.places if report.where is not None else ()
    if len(report.comparisons) > 1:
        tables = {"contests": _contests(report)}
        tables |= {"over datasets": _over_datasets(report)} if report.across else {}
    else:
        tables = {"errors": _errors(report)}
        tables |= {"where": _places(report, places)} if places else {}
    *_, last = tables
    return tables | {last: replace(tables[last], notes=notes(report))}


def _estimates(report: Report) -> Table:
    """Return what each method says of each error in each contest."""
    texts = (
        *("dataset", "protocol", "condition", "seed", "splits", "data_sha256", "source_sha256"),
        *("selects_on_test", "mark_a", "mark_b", "task", "n_train", "n_test", "n_poses"),
        *("error", "method", "verdict"),
    )
    rows: list[list[Cell]] = []
    for one in report.comparisons:
        name, sizes = one.name, one.sizes
        about: list[Cell] = [
            *(name.dataset, name.protocol, name.condition, name.seed, one.n_splits),
            *(name.data_sha256, name.source_sha256, one.selects_on_test),
            *(mark_of(one.a), mark_of(one.b), one.a.task),
            *(sizes.n_train, sizes.n_test, one.n_poses),
        ]
        for row in one.rows:
            verdict = verdict_text(row.verdict, of_fits=row.over_splits is None)
            over = [("over splits", row.over_splits), ("over poses", row.over_poses)]
            rows += [
                [*about, row.error, method, verdict, *_numbers(row, found), *_chances(found)]
                for method, found in over
                if found is not None
            ]
    return Table(
        title="Estimates by each method | mean error, mm",
        columns=[
            *(Column(text, "text") for text in texts),
            *(*_number_columns(report), *_CHANCES),
        ],
        rows=rows,
        unit=_UNIT,
    )


def _title(report: Report) -> str:
    if len(report.comparisons) > 1:
        sides = f"A = {report.a}, B = {report.b}"
        return f"{sides} | {len(report.comparisons)} contests | mean 3-D error, mm"
    first = report.comparisons[0]
    sides = f"A = {name_with_mark(first.a)}, B = {name_with_mark(first.b)}"
    kind = kind_label(first.a.kind, first.a.task)
    setting = " | ".join(filter(None, (first.name.protocol, first.name.condition)))
    return (
        f"{sides} | {first.name.dataset} ({kind}) | {setting}, {first.splits_text}, seed "
        f"{first.name.seed} | mean error, mm"
    )


_UNIT, _LENGTH, _DIFFERENCE = PRINTED["m"][0], ".4f", "+.4f"


def _p_text(found: Quantity) -> str:
    p_value = found.value or 0.0
    return "< 0.001" if p_value < 0.001 else f"{p_value:.3f}"


def _number_columns(report: Report) -> list[Column]:
    level = percent(report.question.confidence)
    return [
        Column("A", unit=_UNIT, format=_LENGTH),
        Column("B", unit=_UNIT, format=_LENGTH),
        Column("A - B", unit=_UNIT, format=_DIFFERENCE),
        Column(f"{level} interval", unit=_UNIT, format=_DIFFERENCE),
        Column("p", format=_p_text),
    ]


_CHANCES = [
    Column(f"P({outcome})", format=lambda found: chance_text(found.value or 0.0))
    for outcome in ("A better", "equivalent", "B better")
]


def _errors(report: Report) -> Table:
    (found,) = report.comparisons
    over_poses = Column("interval over poses", unit=_UNIT, format=_DIFFERENCE)
    return Table(
        _title(report),
        [
            *(Column("mean error", "text"), *_number_columns(report), *_CHANCES),
            *([over_poses] if found.over_splits else []),
            Column("verdict", "text"),
        ],
        [
            [
                *(error_label(row.error), *_numbers(row, row.main), *_chances(row.main)),
                *([_interval(row.over_poses)] if found.over_splits else []),
                _verdict(row, report),
            ]
            for row in found.rows
        ],
        unit=_UNIT,
    )


def _contests(report: Report) -> Table:
    called = label_parts(one.name for one in report.comparisons)
    rows = [(one, one.row(NORM)) for one in report.comparisons]
    return Table(
        _title(report),
        [
            *(Column("contest", "text"), Column("splits")),
            *(*_number_columns(report), *_CHANCES, Column("verdict", "text")),
        ],
        [
            [
                *(Name(_joined(*called[one.name]), contest_marks(one)), one.n_splits),
                *(*_numbers(row, row.main), *_chances(row.main), _verdict(row, report)),
            ]
            for one, row in rows
        ],
        unit=_UNIT,
    )


def _joined(*parts: str) -> str:
    return ", ".join(filter(None, parts))


def _verdict(row: Row, report: Report) -> str:
    """Return the verdict; where splits found a winner and the poses did not, that too."""
    text = verdict_text(row.verdict, of_fits=row.over_splits is None)
    if row.over_splits is None or row.verdict != "open":
        return text
    of_splits = decide([row.over_splits], report.question.confidence).verdict
    return f"{text} (poses)" if of_splits in ("a", "b") else text


def _over_datasets(report: Report) -> Table:
    return Table(
        "Over data sets | mean 3-D error, mm",
        [
            Column("over data sets of one robot type", "text"),
            *(Column(name) for name in ("data sets", *VERDICTS.values())),
            Column("mean A - B", unit=_UNIT, format=_DIFFERENCE),
            Column("p over data sets", format=_p_text),
        ],
        [
            [
                *(_across_name(one, report.across), len(one.verdicts)),
                *(one.verdicts.count(verdict) for verdict in VERDICTS),
                *(MM * one.mean_difference, one.p_value),
            ]
            for one in report.across
        ],
        unit=_UNIT,
    )


def _across_name(one: Across, among: Sequence[Across]) -> Name:
    alike = [(other.family, other.protocol, other.condition) for other in among]
    repeated = alike.count((one.family, one.protocol, one.condition)) > 1
    seed = f"seed {one.seed}" if repeated else ""
    fits = "these fits" if one.of_fits else ""
    text = _joined(one.family, one.protocol, one.condition, seed, fits)
    return Name(text, SELECTS_ON_TEST if one.selects_on_test else "")


def _places(report: Report, places: Sequence[Place]) -> Table:
    return Table(
        "Where each is better | mean 3-D error, mm",
        [
            *(Column("where", "text"), Column("kind", "text", hidden=True)),
            *(Column("samples"), Column("poses"), *_number_columns(report)),
            *(replace(column, hidden=True) for column in _CHANCES),
            Column("verdict", "text"),
        ],
        [
            [
                *(place_text(place), place.kind, place.n_samples, place.n_poses),
                *(*_numbers(place, place.estimate), *_chances(place.estimate)),
                verdict_text(place.verdict, of_fits=True),
            ]
            for place in places
        ],
        unit=_UNIT,
    )


def _numbers(row: Row | Place, estimate: Estimate) -> list[Cell]:
    lengths = (row.mean_a, row.mean_b, row.difference)
    return [*(MM * length for length in lengths), _interval(estimate), estimate.p_value]


def _chances(estimate: Estimate) -> list[Cell]:
    posterior = estimate.posterior
    return [posterior.a_better, posterior.equivalent, posterior.b_better]


def _interval(estimate: Estimate) -> Quantity:
    return Quantity(low=MM * estimate.low, high=MM * estimate.high)
