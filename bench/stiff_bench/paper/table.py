"""A table of the paper beside ours, in parts; each becomes a table like any other."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Final, Literal

from stiff_bench.tables.metric_table import mean_over
from stiff_bench.tables.render import render
from stiff_bench.tables.table import Column, Quantity, Table
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


def mean_reduction(old: Sequence[float], new: Sequence[float], mark: str = "") -> Quantity | None:
    """Return the reduction split by split, as mean and deviation; None where `old` is 0."""
    if not all(old):
        return None
    each = [reduction(before, after) for before, after in zip(old, new, strict=True)]
    return mean_over(each, mark)


Labels = tuple[str, ...]
"""Of a row: one under each row heading."""
PAPER_DATA: Final = "KR10 (measured)"
Unit = Literal["mm", "10^3 Nm/rad", "%"]


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
    entries: Mapping[tuple[Labels, str, str], Quantity]
    notes: tuple[str, ...]

    @property
    def columns(self) -> list[tuple[Group, str]]:
        """Every column that holds numbers, from left to right."""
        return [(group, column) for group in self.groups for column in group.columns]

    def entry(self, row: Labels, group: Group, column: str) -> Quantity | None:
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


def render_paper_table(table: PaperTable, fmt: str, command: str) -> str:
    """Return the table as "github", "latex", "csv", "html" or "json".

    Args:
        table: the table.
        fmt: the format; csv and json hold full precision.
        command: that makes it.
    """
    return render([_typed(table, part) for part in table.parts], fmt, command)


def _typed(table: PaperTable, part: Part) -> Table:
    return Table(
        title=table.title_of(part),
        columns=[
            *(Column(heading, "text") for heading in part.row_headings),
            *(_column(part, group, column) for group, column in part.columns),
        ],
        rows=[[*row, *(part.entry(row, *place) for place in part.columns)] for row in part.rows],
        notes=part.notes,
        unit=part.unit,
        about={"table": table.number},
    )


def _column(part: Part, group: Group, name: str) -> Column:
    about = {"group": group.label, "source": group.source, "data": group.data}
    return Column(
        name,
        unit=part.unit,
        format=f".{group.decimals}f",
        group=group.label,
        about=about | {"protocol": group.protocol, "seed": group.seed},
        marks_shown=False,
    )
