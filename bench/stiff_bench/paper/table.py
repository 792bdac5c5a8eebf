"""A table of the paper beside ours -> LaTeX with booktabs and siunitx's S columns.

Groups stand side by side where that is narrow enough, and otherwise line by line beneath each
other.
"""

from __future__ import annotations

import csv
import html
import io
import json
import math
import re
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from itertools import repeat
from typing import Any, Final, Literal

import numpy as np

from stiff_bench.console import one_line
from stiff_bench.tables.render import TextTable, csv_cells, latex_text, render_texts
from stiff_bench.tables.units import MM
from stiff_protocols.contract.errors import StoreError
from stiff_protocols.contract.record import CellResult
from stiff_protocols.scoring.metrics import metric

Errors = Mapping[tuple[str, str], float]
"""(metric key, axis) -> mm."""


def errors_mm(result: CellResult, metrics: Sequence[str]) -> Errors:
    """Return a result's errors by axis.

    Raises:
        StoreError: it has no predictions.
    """
    if result.prediction is None:
        raise StoreError(f"{result.shown.model}: a result without predictions")
    return {
        (key, axis): value * MM
        for key in metrics
        for axis, value in metric(key).values(result.prediction).items()
    }


def reduction(old: float, new: float) -> float:
    """Return by how many per cent `new` is below `old`; negative where it is above."""
    return 100.0 * (1.0 - new / old)


def mean_reduction(old: Sequence[float], new: Sequence[float], mark: str = "") -> Entry | None:
    """Return the reduction split by split, as mean and deviation; None where `old` is 0."""
    if not all(old):
        return None
    each = [reduction(before, after) for before, after in zip(old, new, strict=True)]
    return Entry.of(each, mark)


Labels = tuple[str, ...]
"""Of a row: one under each row heading."""
PAPER_DATA: Final = "KR10 (measured)"
Unit = Literal["mm", "10^3 Nm/rad", "%"]


@dataclass(frozen=True)
class Entry:
    """A number of a table.

    Attributes:
        mean: in the unit of its part; over `n` splits or specimens.
        std: their sample standard deviation; NaN where there is one.
        n: how many; 1 for what the paper prints.
        mark: what must go with it, such as that the epoch was picked on the test part.
    """

    mean: float
    std: float = math.nan
    n: int = 1
    mark: str = ""

    @classmethod
    def of(cls, values: Sequence[float], mark: str = "") -> Entry:
        """Return mean and deviation of one value a split or specimen."""
        std = float(np.std(values, ddof=1)) if len(values) > 1 else math.nan
        return cls(float(np.mean(values)), std, len(values), mark)


@dataclass(frozen=True)
class Group:
    """Columns of one origin, that stand together.

    Attributes:
        label: above them; no other group of the part has it.
        source: whose numbers they are.
        columns: as the paper heads them.
        decimals: to print.
        data: what the numbers come from.
        protocol: that our models were tested by; "" for none.
        seed: of the run; None: there was none.
    """

    label: str
    source: Literal["published", "ours"]
    columns: Labels
    decimals: int
    data: str
    protocol: str = ""
    seed: int | None = None


@dataclass(frozen=True)
class Part:
    """Rows and groups of columns under one caption.

    Attributes:
        caption: what is shown; the unit is not said there.
        unit: of all its numbers.
        row_headings: of the columns that name a row.
        rows: labels of each row.
        groups: of the columns.
        entries: (row, group's label, column) -> number; a missing one is a dash.
        notes: what must be read with it.
    """

    caption: str
    unit: Unit
    row_headings: Labels
    rows: tuple[Labels, ...]
    groups: tuple[Group, ...]
    entries: Mapping[tuple[Labels, str, str], Entry]
    notes: tuple[str, ...]

    @property
    def columns(self) -> list[tuple[Group, str]]:
        """Every column that holds numbers, from left to right."""
        return [(group, column) for group in self.groups for column in group.columns]

    def entry(self, row: Labels, group: Group, column: str) -> Entry | None:
        """Return a number, or None where there is none."""
        return self.entries.get((row, group.label, column))


@dataclass(frozen=True)
class PaperTable:
    """A table of the paper beside ours.

    Attributes:
        number: in the paper.
        parts: each with a caption and notes of its own.
    """

    number: int
    parts: tuple[Part, ...]

    @property
    def title(self) -> str:
        """The number and the first part's caption."""
        return self.title_of(self.parts[0])

    def title_of(self, part: Part) -> str:
        """Return the title of a part: number, caption and unit."""
        return f"Table {self.number}. {part.caption} [{part.unit}]"


PACKAGES = ("booktabs", "graphicx", "siunitx")
_UNITS: dict[Unit, str] = {
    "mm": r"\si{mm}",
    "10^3 Nm/rad": r"$10^3$\,\si{N.m/rad}",
    "%": r"\%",
}
_SIUNITX = (
    "group-digits=none, separate-uncertainty=true, retain-zero-uncertainty=true, "
    "table-align-uncertainty=false"
)
_NO_WIDER_THAN_THE_LINE = r"\resizebox{\ifdim\width>\linewidth\linewidth\else\width\fi}{!}{%"
_SIDE_BY_SIDE = 6
"""More columns of numbers than these would be too small to read."""


def latex(table: PaperTable, command: str) -> str:
    """Return a table environment a part; the notes are printed beneath."""
    needs = " ".join(rf"\usepackage{{{package}}}" for package in PACKAGES)
    parts = "\n\n".join(_part(table, part, command) for part in table.parts)
    return f"% needs {needs}; on a page of two columns, table* is easier to read\n{parts}"


def _part(table: PaperTable, part: Part, command: str) -> str:
    caption = f"Table {table.number} of the paper: {part.caption}"
    notes = (*part.notes, f"made by: `{command}`")
    same_columns = len({group.columns for group in part.groups}) == 1
    body = _stacked if same_columns and len(part.columns) > _SIDE_BY_SIDE else _side_by_side
    return "\n".join(
        [
            r"\begin{table}",
            r"\centering",
            rf"\caption{{{_text(caption)} [{_UNITS[part.unit]}]}}",
            r"\small",
            r"\setlength{\tabcolsep}{4pt}",
            rf"\sisetup{{{_SIUNITX}}}",
            _NO_WIDER_THAN_THE_LINE,
            *body(part),
            r"\bottomrule",
            r"\end{tabular}}",
            r"\par\medskip\raggedright\footnotesize",
            *(rf"{_text(note)}\par" for note in notes),
            r"\end{table}",
        ]
    )


def _side_by_side(part: Part) -> Iterator[str]:
    """Yield the lines of a table whose groups stand beside each other."""
    yield _begin(len(part.row_headings), [_format(part, [place]) for place in part.columns])
    yield from _over(part)
    yield _line([*part.row_headings], [f"{{{_text(column)}}}" for _, column in part.columns])
    yield r"\midrule"
    for row in part.rows:
        places = part.columns
        yield _line(row, [_cell(part.entry(row, group, column), group) for group, column in places])


def _over(part: Part) -> Iterator[str]:
    """Yield the groups' labels above their columns, and a rule beneath each."""
    first, labels, rules = len(part.row_headings) + 1, list[str](), list[str]()
    for group in part.groups:
        last = first + len(group.columns) - 1
        labels.append(rf"\multicolumn{{{len(group.columns)}}}{{c}}{{{_text(group.label)}}}")
        rules.append(rf"\cmidrule(lr){{{first}-{last}}}")
        first = last + 1
    yield _line(list(repeat("", len(part.row_headings))), labels)
    yield "".join(rules)


def _stacked(part: Part) -> Iterator[str]:
    """Yield the lines of a table that has a line a group in each row."""
    columns = part.groups[0].columns
    formats = [_format(part, [(group, column) for group in part.groups]) for column in columns]
    yield _begin(len(part.row_headings) + 1, formats)
    yield _line([*part.row_headings, "numbers"], [f"{{{_text(column)}}}" for column in columns])
    for number, row in enumerate(part.rows):
        yield r"\addlinespace" if number else r"\midrule"
        labels = row
        for group in part.groups:
            cells = [_cell(part.entry(row, group, column), group) for column in columns]
            yield _line([*labels, group.label], cells)
            labels = ("",) * len(row)


def _begin(n_labels: int, formats: Sequence[str]) -> str:
    """Return the head of a tabular: text stands left, numbers at their decimal points."""
    types = " ".join(["l" * n_labels, *(f"S[table-format={one}]" for one in formats)])
    return f"\\begin{{tabular}}{{{types}}}\n\\toprule"


def _line(labels: Sequence[str], cells: Sequence[str]) -> str:
    return rf"{' & '.join([*map(_text, labels), *cells])} \\"


def _format(part: Part, places: Sequence[tuple[Group, str]]) -> str:
    """Return what siunitx keeps room for: digits before and after the point, and uncertainty."""
    shown = [
        (entry, group)
        for row in part.rows
        for group, column in places
        if (entry := part.entry(row, group, column)) is not None and math.isfinite(entry.mean)
    ]
    decimals = max(group.decimals for group, _ in places)
    sign = "-" if any(_number(one.mean, group).startswith("-") for one, group in shown) else ""
    whole = max((_whole(one.mean, group) for one, group in shown), default=1)
    of_deviations = [_whole(one.std, group) for one, group in shown if not math.isnan(one.std)]
    uncertainty = f"({max(of_deviations) + decimals})" if of_deviations else ""
    return f"{sign}{whole}.{decimals}{uncertainty}"


def _number(value: float, group: Group) -> str:
    return f"{value:.{group.decimals}f}"


def _whole(value: float, group: Group) -> int:
    """Return the number of digits before the point."""
    return len(_number(value, group).lstrip("-").partition(".")[0])


def _cell(entry: Entry | None, group: Group) -> str:
    """Return a number as siunitx reads it."""
    if entry is None:
        return "{--}"
    number = _number(entry.mean, group)
    if not math.isfinite(entry.mean):
        return f"{{{number}}}"
    return number if math.isnan(entry.std) else f"{number} +- {_number(entry.std, group)}"


def _text(text: str) -> str:
    """Escape a text; what stands between backticks is code."""
    return re.sub(r"`([^`]+)`", r"\\texttt{\1}", latex_text(one_line(text)))


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
