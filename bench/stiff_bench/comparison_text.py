"""A comparison -> text: github, latex (booktabs), csv, html or json. Here SI becomes mm."""

from __future__ import annotations

import html
from collections.abc import Sequence
from dataclasses import replace

from stiff_bench.across import Across
from stiff_bench.compare import Report
from stiff_bench.comparison import NORM, Row
from stiff_bench.comparison_data import VERDICTS, as_csv, as_json, place_text, verdict_text
from stiff_bench.comparison_notes import notes
from stiff_bench.comparison_words import (
    SELECTS_ON_TEST,
    chance_text,
    contest_marks,
    error_label,
    name_with_mark,
    sentence,
)
from stiff_bench.contest_name import label_parts
from stiff_bench.estimates import Estimate, decide
from stiff_bench.messages import one_line
from stiff_bench.render import TextTable, latex_text, markdown_text, render_texts
from stiff_bench.units import MM, percent
from stiff_bench.where import Place
from stiff_bench.words import marked
from stiff_protocols.plugin import kind_label


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
    of_splits = decide([row.over_splits], report.question.confidence)
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
