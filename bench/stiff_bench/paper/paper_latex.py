"""A table of the paper beside ours -> LaTeX with booktabs and siunitx's S columns.

Groups stand side by side where that is narrow enough, and otherwise line by line beneath each
other.
"""

from __future__ import annotations

import math
import re
from collections.abc import Iterator, Sequence
from itertools import repeat

from stiff_bench.messages import one_line
from stiff_bench.paper.paper_table import Entry, Group, PaperTable, Part, Unit
from stiff_bench.render import latex_text

PACKAGES = ("booktabs", "graphicx", "siunitx")
_UNITS: dict[Unit, str] = {
    "mm": r"\si{mm}",
    "10^3 Nm/rad": r"$10^3$\,\si{N.m/rad}",
    "%": r"\%",
}
_NUMBERS = (
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
            rf"\sisetup{{{_NUMBERS}}}",
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
