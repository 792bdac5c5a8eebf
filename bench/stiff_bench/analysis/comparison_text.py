"""A comparison -> text: github, latex (booktabs), csv, html or json. Here SI becomes mm."""

from __future__ import annotations

import csv
import html
import io
import json
from collections.abc import Sequence
from dataclasses import replace
from typing import Any

from stiff_bench.analysis.compare import Across, Report
from stiff_bench.analysis.comparison import NORM, Comparison, Row
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
from stiff_bench.console import one_line
from stiff_bench.store.names import label_parts
from stiff_bench.tables.render import TextTable, csv_cells, latex_text, markdown_text, render_texts
from stiff_bench.tables.table import mark_of
from stiff_bench.tables.units import MM, PRINTED, marked, percent
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


_CONTEST = (
    *("dataset", "protocol", "condition", "seed", "splits"),
    *("data_sha256", "source_sha256", "selects_on_test", "mark_a", "mark_b"),
)
_VALUES = (
    *("mean_a_mm", "mean_b_mm", "difference_mm", "low_mm", "high_mm", "p_value"),
    *("p_a_better", "p_equivalent", "p_b_better", "verdict"),
)


def as_csv(report: Report) -> str:
    """Return one line a contest, error and method or place, at full precision."""
    out = io.StringIO()
    writer = csv.DictWriter(
        out,
        ["a", "b", *_CONTEST, "error", "method", "place", *_VALUES],
        restval="",
        lineterminator="\n",
    )
    writer.writeheader()

    def write(row: dict[str, Any]) -> None:
        writer.writerow(dict(zip(row, csv_cells(row.values()), strict=True)))

    names = {"a": report.a, "b": report.b}
    for one in report.comparisons:
        about = names | _about(one)
        for row in one.rows:
            for method, estimate in _methods(row):
                values = _plain_values(row, estimate)
                write(about | {"error": row.error, "method": method} | values)
    for place in report.where.places if report.where is not None else ():
        about = names | _about(report.comparisons[0]) | {"error": NORM, "method": "over poses"}
        write(about | {"place": place_text(place)} | _plain_values(place, place.estimate))
    return out.getvalue().rstrip("\n")


def _about(one: Comparison) -> dict[str, Any]:
    name = one.name
    return dict(
        zip(
            _CONTEST,
            (
                *(name.dataset, name.protocol, name.condition, name.seed, one.n_splits),
                *(name.data_sha256, name.source_sha256, one.selects_on_test),
                *(mark_of(one.a), mark_of(one.b)),
            ),
            strict=True,
        )
    )


def _methods(row: Row) -> list[tuple[str, Estimate]]:
    over_splits = [] if row.over_splits is None else [("over splits", row.over_splits)]
    return [*over_splits, ("over poses", row.over_poses)]


def _plain_values(row: Row | Place, estimate: Estimate) -> dict[str, Any]:
    posterior = estimate.posterior
    of_fits = isinstance(row, Place) or row.over_splits is None
    lengths = (row.mean_a, row.mean_b, row.difference, estimate.low, estimate.high)
    return dict(
        zip(
            _VALUES,
            (
                *(MM * length for length in lengths),
                estimate.p_value,
                posterior.a_better,
                posterior.equivalent,
                posterior.b_better,
                verdict_text(row.verdict, of_fits=of_fits),
            ),
            strict=True,
        )
    )


def as_json(report: Report) -> str:
    """Return everything as JSON, lengths in mm."""
    return json.dumps(_plain(report), indent=2)


def _plain(report: Report) -> dict[str, Any]:
    return {
        "command": report.command,
        "a": report.a,
        "b": report.b,
        "rope_mm": MM * report.question.rope,
        "confidence": report.question.confidence,
        "sentence": sentence(report),
        "contests": [_plain_contest(one) for one in report.comparisons],
        "over_datasets": [_plain_across(one) for one in report.across],
        "where": [
            {"kind": place.kind, "place": place_text(place), "poses": place.n_poses}
            | _plain_values(place, place.estimate)
            for place in (report.where.places if report.where is not None else ())
        ],
        "notes": notes(report),
    }


def _plain_contest(one: Comparison) -> dict[str, Any]:
    return _about(one) | {
        "task": one.a.task,
        "n_train": one.sizes.n_train,
        "n_test": one.sizes.n_test,
        "n_poses": one.n_poses,
        "errors": [
            {"error": row.error, "method": method} | _plain_values(row, estimate)
            for row in one.rows
            for method, estimate in _methods(row)
        ],
    }


def _plain_across(one: Across) -> dict[str, Any]:
    return {
        "family": one.family,
        "protocol": one.protocol,
        "condition": one.condition,
        "seed": one.seed,
        "selects_on_test": one.selects_on_test,
        "verdicts": [verdict_text(verdict, of_fits=one.of_fits) for verdict in one.verdicts],
        "mean_difference_mm": MM * one.mean_difference,
        "p_value": one.p_value,
    }


def render_report(report: Report, fmt: str) -> str:
    """Return the report as text of the given format: the sentence, the tables, the sentence."""
    if fmt == "json":
        return as_json(report)
    if fmt == "csv":
        return as_csv(report)
    said = _said(one_line(sentence(report)), fmt)
    return "\n\n".join([said, render_texts(_tables(report), fmt, report.command), said])


def _said(text: str, fmt: str) -> str:
    """Return a sentence as a paragraph of the format."""
    if fmt == "html":
        return f"<p>{html.escape(text)}</p>"
    return latex_text(text) if fmt == "latex" else markdown_text(text)


def _tables(report: Report) -> list[TextTable]:
    if len(report.comparisons) > 1:
        tables = [_contests(report), *([_over_datasets(report.across)] if report.across else [])]
    else:
        places = report.where.places if report.where is not None else ()
        tables = [_errors(report), *([_places(report, places)] if places else [])]
    return [*tables[:-1], replace(tables[-1], notes=notes(report))]


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


def _number_heads(report: Report) -> list[str]:
    level = percent(report.question.confidence)
    return ["A", "B", "A - B", f"{level} interval", "p"]


def _chance_heads() -> list[str]:
    return ["P(A better)", "P(equivalent)", "P(B better)"]


def _errors(report: Report) -> TextTable:
    (found,) = report.comparisons
    header = ["mean error", *_number_heads(report), *_chance_heads()]
    second = ["interval over poses"] if found.over_splits else []
    rows = [
        [
            error_label(row.error),
            *_numbers(row, row.main),
            *_chances(row.main),
            *([_interval(row.over_poses)] if found.over_splits else []),
            _verdict(row, report),
        ]
        for row in found.rows
    ]
    return TextTable(_title(report), [*header, *second, "verdict"], rows, ())


def _contests(report: Report) -> TextTable:
    header = ["contest", "splits", *_number_heads(report), *_chance_heads(), "verdict"]
    called = label_parts(one.name for one in report.comparisons)
    rows = []
    for one in report.comparisons:
        row = one.row(NORM)
        rows.append(
            [
                marked(_joined(*called[one.name]), contest_marks(one)),
                str(one.n_splits),
                *_numbers(row, row.main),
                *_chances(row.main),
                _verdict(row, report),
            ]
        )
    return TextTable(_title(report), header, rows, ())


def _joined(*parts: str) -> str:
    return ", ".join(filter(None, parts))


def _verdict(row: Row, report: Report) -> str:
    """Return the verdict; where splits found a winner and the poses did not, that too."""
    text = verdict_text(row.verdict, of_fits=row.over_splits is None)
    if row.over_splits is None or row.verdict != "open":
        return text
    of_splits = decide([row.over_splits], report.question.confidence).verdict
    return f"{text} (poses)" if of_splits in ("a", "b") else text


def _over_datasets(across: Sequence[Across]) -> TextTable:
    header = ["over data sets of one robot type", "data sets", *VERDICTS.values()]
    rows = [
        [
            _across_text(one, across),
            str(len(one.verdicts)),
            *(str(one.verdicts.count(verdict)) for verdict in VERDICTS),
            f"{MM * one.mean_difference:+.4f}",
            "-" if one.p_value is None else _p(one.p_value),
        ]
        for one in across
    ]
    header += ["mean A - B", "p over data sets"]
    return TextTable("Over data sets | mean 3-D error, mm", header, rows, ())


def _across_text(one: Across, among: Sequence[Across]) -> str:
    alike = [(other.family, other.protocol, other.condition) for other in among]
    repeated = alike.count((one.family, one.protocol, one.condition)) > 1
    seed = f"seed {one.seed}" if repeated else ""
    fits = "these fits" if one.of_fits else ""
    text = _joined(one.family, one.protocol, one.condition, seed, fits)
    return marked(text, SELECTS_ON_TEST if one.selects_on_test else "")


def _places(report: Report, places: Sequence[Place]) -> TextTable:
    rows = [
        [
            place_text(place),
            str(place.n_samples),
            str(place.n_poses),
            *_numbers(place, place.estimate),
            verdict_text(place.verdict, of_fits=True),
        ]
        for place in places
    ]
    header = ["where", "samples", "poses", *_number_heads(report), "verdict"]
    return TextTable("Where each is better | mean 3-D error, mm", header, rows, ())


def _numbers(row: Row | Place, estimate: Estimate) -> list[str]:
    return [
        f"{MM * row.mean_a:.4f}",
        f"{MM * row.mean_b:.4f}",
        f"{MM * row.difference:+.4f}",
        _interval(estimate),
        _p(estimate.p_value),
    ]


def _chances(estimate: Estimate) -> list[str]:
    posterior = estimate.posterior
    chances = (posterior.a_better, posterior.equivalent, posterior.b_better)
    return [chance_text(chance) for chance in chances]


def _interval(estimate: Estimate) -> str:
    return f"{MM * estimate.low:+.4f} to {MM * estimate.high:+.4f}"


def _p(p_value: float) -> str:
    return "< 0.001" if p_value < 0.001 else f"{p_value:.3f}"
