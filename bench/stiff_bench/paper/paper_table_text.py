"""A table of the paper beside ours -> text: github, latex, csv, html or json."""

from __future__ import annotations

import csv
import html
import io
import json
import math
import re
from collections.abc import Callable
from typing import Any

from stiff_bench.messages import one_line
from stiff_bench.paper.paper_latex import latex
from stiff_bench.paper.paper_table import Entry, Group, Labels, PaperTable, Part
from stiff_bench.render import TextTable, csv_cells, render_texts

_ABOUT_COLUMN = ("group", "column", "source", "data", "protocol", "seed")
_NUMBER_STYLE = "text-align: right; padding: 0 0.5em"
_NUMBERS = ("value", "std", "n", "mark", "unit")


def render_paper_table(table: PaperTable, fmt: str, command: str) -> str:
    """Return the table as "github", "latex", "csv", "html" or "json".

    Args:
        table: the table.
        fmt: the format; csv and json hold full precision.
        command: that makes it.
    """
    renderers: dict[str, Callable[[PaperTable, str], str]] = {
        "github": _github,
        "latex": latex,
        "csv": lambda table, _: _csv(table),
        "html": _html,
        "json": _json,
    }
    return renderers[fmt](table, command)


def _github(table: PaperTable, command: str) -> str:
    texts = [
        TextTable(
            title=table.title_of(part),
            header=[
                *part.row_headings,
                *(f"{group.label}: {column}" for group, column in part.columns),
            ],
            rows=[[*row, *_texts(part, row)] for row in part.rows],
            notes=part.notes,
        )
        for part in table.parts
    ]
    return render_texts(texts, "github", command)


def _texts(part: Part, row: Labels) -> list[str]:
    return [
        entry_text(part.entry(row, group, column), group.decimals) for group, column in part.columns
    ]


def entry_text(entry: Entry | None, decimals: int) -> str:
    """Return a number for people, a dash where there is none."""
    if entry is None:
        return "-"
    text = f"{entry.mean:.{decimals}f}"
    return text if math.isnan(entry.std) else f"{text} ± {entry.std:.{decimals}f}"


def _csv(table: PaperTable) -> str:
    """Return one line a number, at full precision; one that is missing is blank."""
    out = io.StringIO()
    writer = csv.writer(out, lineterminator="\n")
    headings = table.parts[0].row_headings
    writer.writerow(["table", *headings, *_ABOUT_COLUMN, *_NUMBERS])
    for part in table.parts:
        for row in part.rows:
            for group, column in part.columns:
                numbers = _csv_numbers(part.entry(row, group, column))
                about = [
                    *(group.label, column, group.source, group.data, group.protocol),
                    "" if group.seed is None else group.seed,
                ]
                writer.writerow(csv_cells([table.number, *row, *about, *numbers, part.unit]))
    return out.getvalue().rstrip("\n")


def _csv_numbers(entry: Entry | None) -> list[str]:
    """Return mean, deviation, count and mark."""
    if entry is None:
        return ["", "", "0", ""]
    std = "" if math.isnan(entry.std) else repr(entry.std)
    return [repr(entry.mean), std, str(entry.n), entry.mark]


def _json(table: PaperTable, command: str) -> str:
    parts = [
        {
            "caption": part.caption,
            "unit": part.unit,
            "notes": list(part.notes),
            "rows": [
                {
                    "labels": dict(zip(part.row_headings, row, strict=True)),
                    "values": [_plain(part, row, *place) for place in part.columns],
                }
                for row in part.rows
            ],
        }
        for part in table.parts
    ]
    plain = {"command": command, "table": table.number, "title": table.title, "parts": parts}
    return json.dumps(plain, indent=2)


def _plain(part: Part, row: Labels, group: Group, column: str) -> dict[str, Any]:
    entry = part.entry(row, group, column)
    return {
        "group": group.label,
        "column": column,
        "source": group.source,
        "data": group.data,
        "protocol": group.protocol,
        "seed": group.seed,
        "value": None if entry is None else entry.mean,
        "std": None if entry is None or math.isnan(entry.std) else entry.std,
        "n": 0 if entry is None else entry.n,
        "mark": "" if entry is None else entry.mark,
        "unit": part.unit,
    }


def _html(table: PaperTable, command: str) -> str:
    parts = "\n".join(_html_part(table, part) for part in table.parts)
    made = html.escape(one_line(command))
    return f"<section>\n{parts}\n<p>made by: <code>{made}</code></p>\n</section>"


def _html_part(table: PaperTable, part: Part) -> str:
    """Return a table with a header of two rows, and its notes."""
    title = _html_text(table.title_of(part))
    over = "".join(
        f'<th scope="colgroup" colspan="{len(group.columns)}">{_html_text(group.label)}</th>'
        for group in part.groups
    )
    names = "".join(
        f'<th scope="col" rowspan="2">{_html_text(heading)}</th>' for heading in part.row_headings
    )
    columns = "".join(f'<th scope="col">{_html_text(column)}</th>' for _, column in part.columns)
    rows = "\n".join(
        "<tr>"
        + "".join(f'<th scope="row">{_html_text(label)}</th>' for label in row)
        + "".join(f'<td style="{_NUMBER_STYLE}">{text}</td>' for text in _texts(part, row))
        + "</tr>"
        for row in part.rows
    )
    notes = "".join(f"<li>{_html_text(note)}</li>" for note in part.notes)
    return "\n".join(
        [
            "<table>",
            f"<caption>{title}</caption>",
            f"<thead>\n<tr>{names}{over}</tr>\n<tr>{columns}</tr>\n</thead>",
            f"<tbody>\n{rows}\n</tbody>",
            "</table>",
            f"<ul>{notes}</ul>",
        ]
    )


def _html_text(text: str) -> str:
    """Escape a text; what stands between backticks is code."""
    escaped = html.escape(one_line(text)).replace("10^3", "10<sup>3</sup>")
    return re.sub(r"`([^`]+)`", r"<code>\1</code>", escaped)
