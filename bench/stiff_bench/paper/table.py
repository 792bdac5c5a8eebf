"""A table of the paper beside ours: groups of columns, each with numbers of one origin."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from typing import Literal

from stiff_bench.paper.study import DATASET, SEED
from stiff_bench.tables.metric_table import mean_over, pooled_prediction
from stiff_bench.tables.table import Column, Quantity, Table
from stiff_bench.tables.units import MM
from stiff_protocols.contract.record import CellResult
from stiff_protocols.scoring.metrics import metric

Errors = Mapping[tuple[str, str], float]
"""(metric key, axis) -> mm."""
Labels = tuple[str, ...]
"""Of a row: one under each row heading."""
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
        values: Mapping[tuple[Labels, str], float],
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

    @property
    def about(self) -> dict[str, object]:
        """What csv and json say of each of its columns."""
        source = PUBLISHED if self.label == PUBLISHED else "ours"
        facts = {"group": self.label, "source": source, "data": self.data}
        return facts | {"protocol": self.protocol, "seed": self.seed}


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
    columns = [(group, name) for group in groups for name in group.columns]
    return Table(
        title=f"Table {number}. {caption} [{unit}]",
        columns=[
            *(Column(heading, "text") for heading in headings),
            *(
                Column(
                    name,
                    unit=unit,
                    format=f".{group.decimals}f",
                    group=group.label,
                    about=group.about,
                    marks_shown=False,
                )
                for group, name in columns
            ),
        ],
        rows=[[*row, *(of.numbers.get((row, name)) for of, name in columns)] for row in rows],
        notes=list(notes),
        unit=unit,
        about={"table": number},
    )


def errors_mm(result: CellResult, metrics: Sequence[str]) -> Errors:
    """Return a result's errors by axis."""
    prediction = pooled_prediction([result])
    return {
        (key, axis): value * MM
        for key in metrics
        for axis, value in metric(key).values(prediction).items()
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
