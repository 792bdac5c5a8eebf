"""Tables -> text: github, latex (booktabs), csv, html or json."""

from __future__ import annotations

import csv
import html
import io
import json
import math
import re
from collections.abc import Iterable, Sequence
from dataclasses import dataclass, replace
from typing import Any

from tabulate import tabulate

from stiff_bench.console import one_line
from stiff_bench.tables.published import NOTE
from stiff_bench.tables.table import Row, Table, Value
from stiff_bench.tables.units import PRINTED
from stiff_protocols.contract.types import AXES
from stiff_protocols.scoring.metrics import WHOLE, Metric

_CSV_ABOUT_TABLE = ("dataset", "kind", "protocol", "condition", "splits", "seed")
_CSV_ABOUT_ROW = ("model", "source", "mark", "note")
DECIMALS = {"mm": 4, "%": 1, "": 3, "ms": 3, "MiB": 1, "1/s": 0}
"""Of mm: as in the source paper's Table 10."""


@dataclass(frozen=True)
class TextTable:
    """A table whose cells are ready to print.

    Attributes:
        title: above it.
        header: of each column.
        rows: cells, one a column; the first column stands left, the others right.
        notes: beneath it.
    """

    title: str
    header: Sequence[str]
    rows: Sequence[Sequence[str]]
    notes: Sequence[str]


def render(tables: Sequence[Table], fmt: str, command: str) -> str:
    """Return the tables as text of the given format, with the command that makes them."""
    if fmt == "csv":
        return _csv(tables)
    if fmt == "json":
        return json.dumps(
            {"command": command, "tables": [_plain(table) for table in tables]}, indent=2
        )
    texts = [
        TextTable(
            table.title, _header(table), [_cells(table, row) for row in table.rows], table.notes
        )
        for table in tables
    ]
    return render_texts(texts, fmt, command)


def render_texts(tables: Sequence[TextTable], fmt: str, command: str) -> str:
    """Return the tables as "github", "latex" or "html", with the command that makes them."""
    parts = {"github": _github, "latex": _latex, "html": _html}[fmt]
    return "\n\n".join(parts(_in_one_line(table), one_line(command)) for table in tables)


def _in_one_line(table: TextTable) -> TextTable:
    """Return the table with each of its texts in one line: another would be another row."""
    return replace(
        table,
        title=one_line(table.title),
        header=[one_line(cell) for cell in table.header],
        rows=[[one_line(cell) for cell in row] for row in table.rows],
        notes=[one_line(note) for note in table.notes],
    )


def _header(table: Table) -> list[str]:
    return ["model", *(f"{axis.upper()} {_heading(m)}".strip() for m, axis in _columns(table))]


def _columns(table: Table) -> list[tuple[Metric, str]]:
    """Return the columns: all metrics of an axis stand together, those without axes come last."""
    return [(m, axis) for axis in (*AXES, *WHOLE) for m in table.metrics if axis in m.axes]


def _heading(metric: Metric) -> str:
    """Return the label; the title names the unit of the others."""
    unit, _ = PRINTED[metric.unit]
    return metric.label if unit in ("mm", "") else f"{metric.label} [{unit}]"


def _cells(table: Table, row: Row) -> list[str]:
    values = [row.values.get((metric.key, axis)) for metric, axis in _columns(table)]
    return [row.label, *(value_text(value) for value in values)]


_MARKDOWN_SIGNS = re.compile(r"<(?=[A-Za-z/!?])|(?<=\])\(")


def markdown_text(text: str) -> str:
    """Escape what markdown would read as HTML, a link or a picture."""
    return _MARKDOWN_SIGNS.sub(r"\\\g<0>", text)


def _markdown_cell(text: str) -> str:
    """Escape what would begin a new cell, too."""
    return markdown_text(text).replace("|", r"\|")


def markdown_code(text: str) -> str:
    """Return a text as code; more backticks than it holds together stand around it."""
    longest = max(map(len, re.findall("`+", text)), default=0)
    return f"`{text}`" if longest == 0 else f"{'`' * (longest + 1)} {text} {'`' * (longest + 1)}"


def value_text(value: Value | None) -> str:
    """Return a value for people, a dash where there is none."""
    if value is None:
        return "-"
    decimals = DECIMALS[value.unit]
    text = f"{value.mean:.{decimals}f}"
    return text if math.isnan(value.std) else f"{text} ± {value.std:.{decimals}f}"


def _body(table: TextTable, fmt: str) -> str:
    rows = [list(table.header), *table.rows]
    if fmt == "github":
        rows = [[_markdown_cell(cell) for cell in row] for row in rows]
    align = ["left", *["right"] * (len(table.header) - 1)]
    return tabulate(rows[1:], headers=rows[0], tablefmt=fmt, colalign=align, disable_numparse=True)


def _github(table: TextTable, command: str) -> str:
    notes = [*map(markdown_text, table.notes), f"made by: {markdown_code(command)}"]
    listed = [f"- {note}" for note in notes]
    return "\n".join([f"**{markdown_text(table.title)}**", "", _body(table, "github"), "", *listed])


def _latex(table: TextTable, command: str) -> str:
    """Return a table environment; the notes are printed beneath, not hidden in comments."""
    body = _body(table, "latex_booktabs")
    for sign, written in _LATEX_SIGNS.items():
        body = body.replace(sign, written)
    body = _BRACKET_AT_START.sub(r"\1{}[", body)
    notes = (*table.notes, f"made by: {command}")
    return "\n".join(
        [
            r"\begin{table}",
            r"\centering",
            rf"\caption{{{latex_text(table.title)}}}",
            body,
            *(rf"\par\footnotesize {latex_text(note)}" for note in notes),
            r"\end{table}",
        ]
    )


_BRACKET_AT_START = re.compile(r"^(\s*)\[", re.MULTILINE)
"""After the end of a row, LaTeX would take it for the row's options."""
_LATEX_SIGNS = {"±": r"$\pm$", "≈": r"$\approx$"}
_LATEX_ESCAPES = str.maketrans(
    {character: rf"\{character}" for character in "&%$#_{}"}
    | {"\\": r"\textbackslash{}", "~": r"\textasciitilde{}", "^": r"\textasciicircum{}"}
    | {"|": r"\textbar{}", "<": r"\textless{}", ">": r"\textgreater{}"}
    | _LATEX_SIGNS
)


def latex_text(text: str) -> str:
    """Escape what LaTeX would read as commands."""
    return text.translate(_LATEX_ESCAPES)


def _html(table: TextTable, command: str) -> str:
    notes = "".join(f"<li>{html.escape(note)}</li>" for note in table.notes)
    return "\n".join(
        [
            "<section>",
            f"<h2>{html.escape(table.title)}</h2>",
            _body(table, "html"),
            f"<ul>{notes}<li>made by: <code>{html.escape(command)}</code></li></ul>",
            "</section>",
        ]
    )


def _csv(tables: Sequence[Table]) -> str:
    """Return one line a row and metric and axis, at full precision.

    A published row has the paper's own data, protocol and split, so ours are left blank there.
    """
    out = io.StringIO()
    writer = csv.writer(out, lineterminator="\n")
    writer.writerow([*_CSV_ABOUT_TABLE, *_CSV_ABOUT_ROW, "axis", "metric", "unit", "value", "std"])
    for table in tables:
        ours = [
            table.dataset,
            table.kind,
            table.protocol,
            table.condition,
            table.n_splits,
            table.seed,
        ]
        for row in table.rows:
            about = ours if row.source == "ours" else [""] * len(_CSV_ABOUT_TABLE)
            note = " ".join(table.notes) if row.source == "ours" else NOTE
            for metric, axis in _columns(table):
                value = row.values.get((metric.key, axis))
                about_value = [row.name, row.source, row.mark, note, axis, metric.key]
                writer.writerow(csv_cells([*about, *about_value, *_csv_numbers(value)]))
    return out.getvalue().rstrip("\n")


_FORMULA = re.compile(r"[=+\-@\t\r](?![\d.]+(e[+-]?\d+)?$|inf$)")
"""How a text begins that a spreadsheet would compute; no number does."""


def csv_cells(values: Iterable[object]) -> list[object]:
    """Return the cells of a CSV row; a quote before a text says that it is no formula."""
    return [
        f"'{value}" if isinstance(value, str) and _FORMULA.match(value) else value
        for value in values
    ]


def _csv_numbers(value: Value | None) -> list[str]:
    """Return unit, mean and deviation; blank where there is none."""
    if value is None:
        return ["", "", ""]
    std = "" if math.isnan(value.std) else repr(value.std)
    return [value.unit, repr(value.mean), std]


def _plain(table: Table) -> dict[str, Any]:
    return {
        "title": table.title,
        "dataset": table.dataset,
        "kind": table.kind,
        "protocol": table.protocol,
        "condition": table.condition,
        "splits": table.n_splits,
        "pooled": table.pooled,
        "seed": table.seed,
        "nominal_coverage": table.coverage,
        "notes": list(table.notes),
        "rows": [
            {
                "model": row.name,
                "source": row.source,
                "mark": row.mark,
                "values": [
                    {
                        "axis": axis,
                        "metric": metric,
                        "unit": value.unit,
                        "value": value.mean,
                        "std": None if math.isnan(value.std) else value.std,
                    }
                    for (metric, axis), value in row.values.items()
                ],
            }
            for row in table.rows
        ],
    }
