"""Write tables as text: github, latex (booktabs, siunitx), csv, html, json, or for a terminal.

Texts of third parties are escaped: they stay in their cell and are never markup.
"""

from __future__ import annotations

import html
import json
import math
import re
import sys
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import TYPE_CHECKING

from tabulate import tabulate

from stiff_bench.console import one_line, printable, wrapped_lines
from stiff_bench.store.names import grouped
from stiff_bench.tables.table import SCREEN, VALUE_FIELDS, Column, Entry, Table
from stiff_bench.tables.terminal import screen_text
from stiff_protocols.contract.display import WIDTH, html_block

if TYPE_CHECKING:
    from pandas import DataFrame


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
        tables: tables in the order of the output.
        fmt: "github", "latex", "csv", "html", "json", or "screen" for a terminal.
        command: command that makes the tables; html omits an empty one.
        text: paragraph above the tables; csv omits it.
        about: facts about all tables, for json.
    """
    tables = of_format(tables, fmt)
    if fmt == SCREEN:
        return screen_text(tables, text=text)
    if fmt == "csv":
        return _csv(tables)
    if fmt == "json":
        facts = {"command": command, **({"text": text} if text else {}), **(about or {})}
        content = {**facts, "tables": [_plain(table) for table in tables]}
        return json.dumps(content, indent=2, allow_nan=False)
    render_table, paragraph = {
        "github": (_github, markdown_text),
        "latex": (_latex, latex_text),
        "html": (_html, lambda words: f"<p>{html_text(words)}</p>"),
    }[fmt]
    paragraphs = [paragraph(text)] if text else []
    last = len(tables) - 1
    parts = [
        render_table(table.visible_table(), command if number == last or fmt == "latex" else "")
        for number, table in enumerate(tables)
    ]
    head = [LATEX_NEEDS] if fmt == "latex" else []
    return "\n\n".join([*head, *paragraphs, *parts])


def of_format(tables: Sequence[Table], fmt: str) -> list[Table]:
    """Return the tables that are written in a format."""
    return [table for table in tables if not table.formats or fmt in table.formats]


def plain_text(table: Table) -> str:
    """Return headings and cells in columns, then the notes, without the title."""
    if sys.stdout.isatty():  # fits its width
        untitled = replace(table, title="")
        return screen_text([untitled], colors=False).strip("\n")
    return "\n".join([_columns(table, "simple", one_line), *table.notes])


def _columns(table: Table, fmt: str, escape: Callable[[str], str]) -> str:
    """Return headings and cells in a format of tabulate."""
    return tabulate(
        [[escape(cell) for cell in row] for row in table.texts()],
        headers=list(map(escape, table.headings())),
        tablefmt=fmt,
        colalign=["right" if column.kind == "number" else "left" for column in table.columns],
        disable_numparse=True,
    )


_MARKDOWN_SIGNS = re.compile(r"(\\*)(<(?=[A-Za-z/!?])|(?<=\])\()")
_BAR = re.compile(r"(\\*)\|")


def markdown_text(text: str) -> str:
    """Return a text in one line; signs that begin HTML, a link or a picture are escaped.

    A backslash before such a sign is escaped, too: it would escape ours.
    """
    return _MARKDOWN_SIGNS.sub(r"\1\1\\\2", one_line(text))


def markdown_code(text: str) -> str:
    """Return a text in one line as Markdown code, without its backticks."""
    return f"`{one_line(text).replace('`', '')}`"


def _github(table: Table, command: str) -> str:
    body = _columns(table, "github", lambda cell: _BAR.sub(r"\1\1\\|", markdown_text(cell)))
    notes = [*map(markdown_text, table.notes)]
    notes += [f"made by: {markdown_code(command)}"] if command else []
    listed = [f"- {note}" for note in notes]
    return "\n".join([f"**{markdown_text(table.title)}**", "", body, "", *listed]).rstrip("\n")


LATEX_NEEDS = (
    r"% needs \usepackage{booktabs} \usepackage{graphicx} \usepackage{siunitx}; on a page of two "
    "columns, table* is easier to read"
)
_SIUNITX = (
    "group-digits=none, separate-uncertainty=true, retain-zero-uncertainty=true, "
    "retain-explicit-plus=true, table-alignment-mode=none, table-alignment=right"
)
"""Options of siunitx; the numbers of a column have the same number of decimals."""
_NO_WIDER_THAN_THE_LINE = r"\resizebox{\ifdim\width>\linewidth\linewidth\else\width\fi}{!}{"
_SIDE_BY_SIDE = 6
"""Largest number of grouped columns in one block; more would be too small to read."""
_LATEX_ESCAPES = str.maketrans(
    {character: rf"\{character}" for character in "&%$#_{}"}
    | {"\\": r"\textbackslash{}", "~": r"\textasciitilde{}", "^": r"\textasciicircum{}"}
    | {"|": r"\textbar{}", "<": r"\textless{}", ">": r"\textgreater{}", "[": "{[}"}
    | {"±": r"$\pm$", "≈": r"$\approx$"}
)


def latex_text(text: str) -> str:
    """Escape a text for LaTeX; text between backticks becomes code."""
    parts = re.split(r"`([^`]+)`", one_line(text))
    parts[1::2] = map(_latex_code, parts[1::2])
    parts[::2] = map(_latex_words, parts[::2])
    return "".join(parts)


def _latex_code(code: str) -> str:
    return rf"\texttt{{{_latex_escaped(code)}}}"


def _latex_words(words: str) -> str:
    escaped = re.sub(r"10\\textasciicircum\{\}(\d+)", r"$10^{\1}$", _latex_escaped(words))
    return re.sub(r"(?<![\w.)-])-(?=\d|\.\d)", "$-$", escaped)  # a minus sign, not a hyphen


def _latex_escaped(text: str) -> str:
    return text.translate(_LATEX_ESCAPES).replace("--", "-{}-")  # `--` would become one dash


def _latex(table: Table, command: str) -> str:
    """Return a table environment, with the notes printed below the table."""
    every = [*range(len(table.columns))]
    groups = grouped(every, lambda number: table.columns[number].group)
    texts = groups.pop("", [])
    too_wide = sum(map(len, groups.values())) > _SIDE_BY_SIDE
    parts = [[*texts, *group] for group in groups.values()] if too_wide else [every]
    tabulars = [f"{_NO_WIDER_THAN_THE_LINE}\n{_tabular(table, part)}}}" for part in parts]
    return "\n".join(
        [
            r"\begin{table}",
            r"\centering",
            rf"\caption{{{latex_text(table.title)}}}",
            r"\footnotesize",
            r"\setlength{\tabcolsep}{4pt}",
            rf"\sisetup{{{_SIUNITX}}}",
            "\n\\par\\medskip\n".join(tabulars),
            r"\par\medskip\raggedright\footnotesize",
            *(rf"{latex_text(note)}\par" for note in table.notes),
            rf"made by: {_latex_code(one_line(command))}\par",
            r"\end{table}",
        ]
    )


def _tabular(table: Table, numbers: Sequence[int]) -> str:
    """Return some columns of a table, with the names of their groups."""
    from pandas import DataFrame, MultiIndex  # `bench list` prints without it

    columns = [table.columns[number] for number in numbers]
    heads = [(latex_text(column.group), latex_text(table.heading(column))) for column in columns]
    cells = [[_latex_cell(table.columns[n], row[n]) for n in numbers] for row in table.rows]
    names = (
        MultiIndex.from_tuples(heads)
        if any(group for group, _ in heads)
        else [heading for _, heading in heads]
    )
    style = DataFrame(cells, columns=names).style.hide(axis="index")
    kinds = "".join("l" if column.kind == "text" else "S" for column in columns)
    text = style.to_latex(column_format=kinds, hrules=True, siunitx=True, multicol_align="c")
    return text.rstrip()


_ALIGNED = re.compile(r"[+-]?\d+(\.\d+)?( ± \d+(\.\d+)?)?")
"""Texts that siunitx aligns: a number, or a number with its deviation."""


def _latex_cell(column: Column, cell: Entry) -> str:
    text = column.text(cell)
    if column.kind == "text":
        return latex_text(text)
    return text.replace("±", "+-") if _ALIGNED.fullmatch(text) else f"{{{latex_text(text)}}}"


def html_text(text: str) -> str:
    """Escape a text for HTML; text between backticks becomes code."""
    escaped = re.sub(r"10\^(\d+)", r"10<sup>\1</sup>", html.escape(one_line(text)))
    return re.sub(r"`([^`]+)`", r"<code>\1</code>", escaped)


def _html(table: Table, command: str) -> str:
    body = _columns(table, "unsafehtml", html_text)  # safe: `html_text` escapes the cells
    notes = [*map(html_text, table.notes)]
    notes += [f"made by: <code>{html.escape(one_line(command))}</code>"] if command else []
    listed = "\n".join(["<ul>", *(f"<li>{note}</li>" for note in notes), "</ul>"]) if notes else ""
    return f"<p><strong>{html_text(table.title)}</strong></p>\n{body}\n{listed}"


def _csv(tables: Sequence[Table]) -> str:
    """Return a line per number at full precision: facts, texts, `VALUE_FIELDS`."""
    from pandas import DataFrame

    lines = [line for table in tables for line in table.lines()]
    about = dict.fromkeys(name for line in lines for name in line if name not in VALUE_FIELDS)
    frame = DataFrame(lines, columns=[*about, *VALUE_FIELDS], dtype=object)
    return frame.to_csv(index=False, lineterminator="\n").rstrip("\n")


def _plain(table: Table) -> dict[str, object]:
    """Return a table for json."""
    rows = [
        {**texts, **({"values": [*map(_without_empty_fields, values)]} if values else {})}
        for texts, values in table.records()
    ]
    details = {"details": [*table.details]} if table.details else {}
    return {"title": table.title, **table.about, "notes": [*table.notes], **details, "rows": rows}


def _without_empty_fields(value: Mapping[str, object]) -> dict[str, object]:
    """Return a number without its empty fields, such as a missing interval.

    NaN becomes null and infinity a text, because JSON has no such numbers.
    """
    optional = {*VALUE_FIELDS} - {"column", "value", "unit"}
    return {k: _strict(v) for k, v in value.items() if k not in optional or v not in (None, "")}


def _strict(value: object) -> object:
    if isinstance(value, float) and not math.isfinite(value):
        return None if math.isnan(value) else str(value)
    return value


class Text(str):
    """A text that a terminal and a notebook print line by line."""

    def __repr__(self) -> str:
        return wrapped_lines(printable(self))

    def _repr_html_(self) -> str:
        text = html.escape(printable(self))
        return html_block(f'<pre style="white-space: pre-wrap;">{text}</pre>')


@dataclass(frozen=True, eq=False, repr=False)
class Tables:
    """Tables that print themselves, in a terminal and in a notebook.

    Attributes:
        tables: typed values, with titles and notes.
        command: command that made them.
        text: sentence above them; "" for none.
        about: facts about all tables, for json.
    """

    tables: Sequence[Table]
    command: str
    text: str = ""
    about: Mapping[str, object] = field(default_factory=dict)

    def frame(self) -> DataFrame:
        """Return the numbers as tidy data with a row per number."""
        from pandas import DataFrame  # slow import (0.5 s), not needed for a leaderboard

        return DataFrame(
            [line for table in of_format(self.tables, "github") for line in table.lines()]
        )

    def text_as(self, fmt: str) -> str:
        """Return the tables as "github", "latex", "csv", "html" or "json"."""
        return render(self.tables, fmt, self.command, text=self.text, about=self.about)

    def __repr__(self) -> str:
        """Return the tables for a terminal."""
        tables = of_format(self.tables, SCREEN)
        return screen_text(tables, text=self.text, width=WIDTH, colors=False)

    def _repr_html_(self) -> str:
        return html_block(render(self.tables, "html", "", text=self.text))
