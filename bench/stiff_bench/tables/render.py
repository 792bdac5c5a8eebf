"""Tables -> text: github, latex (booktabs, siunitx), csv, html or json; for every command.

Each text of a table may be hostile: it stays within its cell, and no format runs it.
"""

from __future__ import annotations

import csv
import html
import io
import json
import math
import re
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from itertools import groupby
from typing import Any, TypeGuard

from tabulate import tabulate

from stiff_bench.console import one_line
from stiff_bench.tables.table import VALUE_FIELDS, Column, Entry, Quantity, Table, quantity


def render(
    tables: Sequence[Table],
    fmt: str,
    command: str,
    *,
    text: str = "",
    about: Mapping[str, object] | None = None,
) -> str:
    """Return tables as text.

    Args:
        tables: in this order.
        fmt: "github", "latex", "csv", "html" or "json".
        command: that makes them.
        text: a paragraph above; csv leaves it out.
        about: facts on all tables, for json.
    """
    if fmt == "csv":
        return _csv(tables)
    if fmt == "json":
        facts = {"command": command, **({"text": text} if text else {}), **(about or {})}
        content = _strict({**facts, "tables": [_plain(table) for table in tables]})
        return json.dumps(content, indent=2, allow_nan=False)
    one, paragraph = {
        "github": (_github, markdown_text),
        "latex": (_latex, latex_text),
        "html": (_html, lambda words: f"<p>{html_text(words)}</p>"),
    }[fmt]
    said = [paragraph(one_line(text))] if text else []
    parts = [one(table.shown(), one_line(command)) for table in tables]
    head = [LATEX_NEEDS] if fmt == "latex" else []
    return "\n\n".join([*head, *said, *parts])


def plain_text(table: Table, *, widths: Sequence[int | None] = ()) -> str:
    """Return headings and cells in columns for a terminal, without the title; then the notes.

    `widths` are those of columns that are broken into lines, characters.
    """
    body = _columns(table, "simple", str, maxcolwidths=[*widths] or None)
    return "\n".join([body, *table.notes])


def _columns(table: Table, fmt: str, escape: Callable[[str], str], **words: Any) -> str:
    """Return headings and cells in a format of tabulate's."""
    return tabulate(
        [[escape(cell) for cell in row] for row in table.texts()],
        headers=list(map(escape, table.headings())),
        tablefmt=fmt,
        colalign=["right" if column.kind == "number" else "left" for column in table.columns],
        disable_numparse=True,
        **words,
    )


_MARKDOWN_SIGNS = re.compile(r"<(?=[A-Za-z/!?])|(?<=\])\(")


def markdown_text(text: str) -> str:
    """Escape what markdown would read as HTML, a link or a picture."""
    return _MARKDOWN_SIGNS.sub(r"\\\g<0>", text)


def _markdown_cell(text: str) -> str:
    """Escape what would begin a new cell, too."""
    return markdown_text(one_line(text)).replace("|", r"\|")


def markdown_code(text: str) -> str:
    """Return a text as code; more backticks than it holds together stand around it."""
    longest = max(map(len, re.findall("`+", text)), default=0)
    return f"`{text}`" if longest == 0 else f"{'`' * (longest + 1)} {text} {'`' * (longest + 1)}"


def _github(table: Table, command: str) -> str:
    body = _columns(table, "github", _markdown_cell)
    notes = [markdown_text(one_line(note)) for note in table.notes]
    listed = [f"- {note}" for note in (*notes, f"made by: {markdown_code(command)}")]
    return "\n".join([f"**{markdown_text(one_line(table.title))}**", "", body, "", *listed])


LATEX_NEEDS = (
    r"% needs \usepackage{booktabs} \usepackage{graphicx} \usepackage{siunitx}; on a page of two "
    "columns, table* is easier to read"
)
_SIUNITX = (
    "group-digits=none, separate-uncertainty=true, retain-zero-uncertainty=true, "
    "table-align-uncertainty=false"
)
_NO_WIDER_THAN_THE_LINE = r"\resizebox{\ifdim\width>\linewidth\linewidth\else\width\fi}{!}{"
_SIDE_BY_SIDE = 6
"""More columns of numbers in groups than these would be too small to read."""
_LATEX_SIGNS = {"±": r"$\pm$", "≈": r"$\approx$"}
_LATEX_ESCAPES = str.maketrans(
    {character: rf"\{character}" for character in "&%$#_{}"}
    | {"\\": r"\textbackslash{}", "~": r"\textasciitilde{}", "^": r"\textasciicircum{}"}
    | {"|": r"\textbar{}", "<": r"\textless{}", ">": r"\textgreater{}"}
    | _LATEX_SIGNS
)


def latex_text(text: str) -> str:
    """Escape what LaTeX would read as commands; what stands between backticks is code."""
    escaped = one_line(text).translate(_LATEX_ESCAPES)
    escaped = re.sub(r"10\\textasciicircum\{\}(\d+)", r"$10^{\1}$", escaped)
    return re.sub(r"`([^`]+)`", r"\\texttt{\1}", escaped)


def _latex(table: Table, command: str) -> str:
    """Return a table environment; the notes are printed beneath, not hidden in comments."""
    every = range(len(table.columns))
    groups = [[*of] for name, of in groupby(every, lambda k: table.columns[k].group) if name]
    texts = [number for number in every if not table.columns[number].group]
    too_wide = sum(map(len, groups)) > _SIDE_BY_SIDE
    parts = [[*texts, *one] for one in groups] if too_wide else [[*every]]
    return "\n".join(
        [
            r"\begin{table}",
            r"\centering",
            rf"\caption{{{latex_text(table.title)}}}",
            r"\small",
            r"\setlength{\tabcolsep}{4pt}",
            rf"\sisetup{{{_SIUNITX}}}",
            "\n\\par\\medskip\n".join("\n".join(_tabular(table, part)) for part in parts),
            r"\par\medskip\raggedright\footnotesize",
            *(rf"{latex_text(note)}\par" for note in table.notes),
            rf"made by: \texttt{{{latex_text(command)}}}\par",
            r"\end{table}",
        ]
    )


def _tabular(table: Table, numbers: Sequence[int]) -> Iterator[str]:
    """Yield the lines of some columns of a table, beneath the names of their groups."""
    columns = [table.columns[number] for number in numbers]
    rows = [[row[number] for number in numbers] for row in table.rows]
    kinds = [
        _column_type(column, [row[place] for row in rows]) if place else "l"
        for place, column in enumerate(columns)
    ]
    yield _NO_WIDER_THAN_THE_LINE
    yield f"\\begin{{tabular}}{{{' '.join(kinds)}}}"
    yield r"\toprule"
    if any(column.group for column in columns):
        spans, rules, end = [], "", 0
        for name, of_group in groupby(columns, lambda column: column.group):
            begin, end = end + 1, end + len([*of_group])
            spans.append(rf"\multicolumn{{{end - begin + 1}}}{{c}}{{{latex_text(name)}}}")
            rules += rf"\cmidrule(lr){{{begin}-{end}}}" if name else ""
        yield _line(spans)
        yield rules
    headings = [latex_text(table.heading(column)) for column in columns]
    yield _line(
        f"{{{text}}}" if kind != "l" else text for text, kind in zip(headings, kinds, strict=True)
    )
    yield r"\midrule"
    for row in rows:
        yield _line(map(_latex_cell, columns, row, kinds))
    yield r"\bottomrule"
    yield r"\end{tabular}}"


def _line(cells: Iterable[str]) -> str:
    r"""Return a row; what follows `\\` is no option of it, though it begins with a bracket."""
    joined = " & ".join(cells)
    return rf"{'{}' if joined.startswith('[') else ''}{joined} \\"


def _column_type(column: Column, cells: Sequence[Entry]) -> str:
    """Return "l" for texts, "S" with room for the digits of plain numbers, "r" for all else."""
    if column.kind == "text":
        return "l"
    if not all(cell is None or _is_plain(column, quantity(cell)) for cell in cells):
        return "r"
    shown = [found for found in map(quantity, cells) if _is_finite(found)]
    values = [_digits(found.value, column) for found in shown]
    spreads = [_digits(found.spread, column) for found in shown if found.spread is not None]
    whole = max((whole for whole, _ in values), default=1)
    decimals = max((decimals for _, decimals in values), default=0)
    sign = "-" * any(found.value is not None and found.value < 0 for found in shown)
    spread = f"({max(whole for whole, _ in spreads) + decimals})" if spreads else ""
    return f"S[table-format={sign}{whole}{f'.{decimals}' if decimals else ''}{spread}]"


def _is_plain(column: Column, found: Quantity | None) -> bool:
    """Whether siunitx can align it: a number, or a number with its deviation."""
    if found is None or callable(column.format) or "+" in column.format:
        return False
    mark = column.marks_shown and found.mark
    return found.value is not None and not any(
        (found.low is not None, found.share, mark, found.status)
    )


def _is_finite(found: Quantity | None) -> TypeGuard[Quantity]:
    return found is not None and found.value is not None and math.isfinite(found.value)


def _digits(value: float | None, column: Column) -> tuple[int, int]:
    """Return how many digits of a number are printed before the point, and how many after."""
    whole, _, decimals = f"{abs(0 if value is None else value):{column.format}}".partition(".")
    return len(whole), len(decimals)


def _latex_cell(column: Column, cell: Entry, kind: str) -> str:
    if not kind.startswith("S"):
        return latex_text(column.text(cell))
    found = quantity(cell)
    if not _is_finite(found):
        return "{--}" if found is None else f"{{{latex_text(column.text(cell))}}}"
    number = f"{found.value:{column.format}}"
    return number if found.spread is None else f"{number} +- {found.spread:{column.format}}"


def html_text(text: str) -> str:
    """Escape a text; what stands between backticks is code."""
    escaped = re.sub(r"10\^(\d+)", r"10<sup>\1</sup>", html.escape(one_line(text)))
    return re.sub(r"`([^`]+)`", r"<code>\1</code>", escaped)


def _html(table: Table, command: str) -> str:
    body = _columns(table, "unsafehtml", html_text)  # what is printed is escaped by us
    notes = "".join(f"<li>{html_text(note)}</li>" for note in table.notes)
    made_by = f"<li>made by: <code>{html.escape(command)}</code></li>"
    return (
        f"<section>\n<h2>{html_text(table.title)}</h2>\n{body}\n<ul>{notes}{made_by}</ul>\n"
        "</section>"
    )


_FORMULA = re.compile(r"[=+\-@\t\r](?![\d.]+(e[+-]?\d+)?$|inf$)")
"""How a text begins that a spreadsheet would compute; no number does."""


def csv_cell(value: object) -> object:
    """Return the cell of a CSV row; a quote before a text says that it is no formula."""
    if isinstance(value, float):
        return repr(value)
    return f"'{value}" if isinstance(value, str) and _FORMULA.match(value) else value


def _csv(tables: Sequence[Table]) -> str:
    """Return a line a number, at full precision: facts, texts of the row, `VALUE_FIELDS`."""
    lines = [line for table in tables for line in table.lines()]
    about = dict.fromkeys(name for line in lines for name in line if name not in VALUE_FIELDS)
    out = io.StringIO()
    writer = csv.writer(out, lineterminator="\n")
    names = [*about, *VALUE_FIELDS]
    writer.writerow(map(csv_cell, names))
    writer.writerows([csv_cell(line.get(name, "")) for name in names] for line in lines)
    return out.getvalue().rstrip("\n")


def _plain(table: Table) -> dict[str, object]:
    rows = [
        {**texts, **({"values": [*map(_known, values)]} if values else {})}
        for texts, values in table.records()
    ]
    details = {"details": list(table.details)} if table.details else {}
    notes = {"notes": list(table.notes), **details}
    return {"title": table.title, **table.about, **notes, "rows": rows}


def _known(value: Mapping[str, object]) -> dict[str, object]:
    """Return a number without what it has not, such as an interval."""
    optional = {*VALUE_FIELDS} - {"column", "value", "unit"}
    return {k: v for k, v in value.items() if k not in optional or v not in (None, "")}


def _strict(value: Any) -> Any:
    """Return the content without what JSON has no number for: NaN is null, infinity a text."""
    if isinstance(value, dict):
        return {key: _strict(item) for key, item in value.items()}
    if isinstance(value, list | tuple):
        return [_strict(item) for item in value]
    if isinstance(value, float) and not math.isfinite(value):
        return None if math.isnan(value) else str(value)
    return value
