"""A table of the paper beside ours: groups of columns, each with numbers of one origin."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from typing import Literal

from stiff_bench.paper.study import DATASET, SEED
from stiff_bench.tables.table import Column, Quantity, Table

Labels = tuple[str, ...]
"""Of a row: one under each row heading."""
Places = Mapping[tuple[Labels, str], float]
"""(row, column) -> value."""
Numbers = Mapping[tuple[Labels, str], Quantity]
"""(row, column) -> number of one group of columns; a missing one is a dash."""
Unit = Literal["mm", "10^3 Nm/rad", "%"]
PUBLISHED, PUBLISHED_DECIMALS = "published", 4
SIMULATED = f"{DATASET} (simulated)"
COMPARE = (
    f"Published: KR10 measured. Ours: {SIMULATED}. Not comparable in absolute terms; "
    "docs/reproduction.md says what differs."
)


@dataclass(frozen=True)
class Group:
    """Columns of one origin, that stand together.

    Attributes:
        label: above them; no other group of the table has it.
        columns: as the paper heads them.
        decimals: to print.
        numbers: of the group.
        data: what the numbers come from.
        protocol: that our models were tested by; "" for none.
        seed: of the run; None: there was none.
    """

    label: str
    columns: Labels
    decimals: int
    numbers: Numbers
    data: str = SIMULATED
    protocol: str = ""
    seed: int | None = None

    @classmethod
    def published(
        cls,
        columns: Labels,
        values: Places,
        decimals: int = PUBLISHED_DECIMALS,
    ) -> Group:
        """Return the paper's columns."""
        numbers = {place: Quantity(value, n=1) for place, value in values.items()}
        return cls(PUBLISHED, columns, decimals, numbers, "KR10 (measured)")

    @classmethod
    def ours(
        cls, protocol: str, columns: Labels, decimals: int, numbers: Numbers, label: str = ""
    ) -> Group:
        """Return columns of models that were tested by a protocol."""
        label = label or f"ours, {protocol}"
        return cls(label, columns, decimals, numbers, SIMULATED, protocol, SEED)


def paper_table(
    number: int,
    caption: str,
    unit: Unit,
    headings: Labels,
    rows: Iterable[Labels],
    groups: Sequence[Group],
    notes: Iterable[str],
) -> Table:
    """Return a table.

    Args:
        number: in the paper.
        caption: what is shown; the unit is not said there.
        unit: of all its numbers.
        headings: of the columns that name a row.
        rows: labels of each.
        groups: of the other columns.
        notes: what must be read with it.
    """
    columns = [Column(heading, "text") for heading in headings]
    for group in groups:
        about = {
            "group": group.label,
            "source": PUBLISHED if group.label == PUBLISHED else "ours",
            "data": group.data,
            "protocol": group.protocol,
            "seed": group.seed,
        }
        columns += [
            Column(
                name,
                unit=unit,
                format=f".{group.decimals}f",
                group=group.label,
                about=about,
                marks_shown=False,
            )
            for name in group.columns
        ]
    return Table(
        title=f"Table {number}. {caption} [{unit}]",
        columns=columns,
        rows=[
            [*row, *(one.numbers.get((row, name)) for one in groups for name in one.columns)]
            for row in rows
        ],
        notes=list(notes),
        unit=unit,
        about={"table": number},
    )


def printed_name(column: str) -> str:
    """Return what a column of errors, such as "train MAE", is called in the published file."""
    return f"{column.replace(' ', '_').lower()}_mm"
