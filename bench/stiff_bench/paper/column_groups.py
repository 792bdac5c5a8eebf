"""A table of the paper next to ours: groups of columns, each with numbers of one origin."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass
from typing import TypeVar

from stiff_bench.paper.paper_models import DATASET, SEED
from stiff_bench.paper.paper_results import Found
from stiff_bench.store.names import Variant
from stiff_bench.tables.metric_table import mark_of, mean_over
from stiff_bench.tables.published import about_table
from stiff_bench.tables.table import Column, Quantity, Table
from stiff_protocols.contract.record import CellResult

Label = TypeVar("Label")

Labels = tuple[str, ...]
"""Texts of a row: one under each row heading."""
Numbers = Mapping[tuple[Labels, str], float]
"""(row, column) -> number."""
GroupNumbers = dict[tuple[Labels, str], Quantity]
"""The same with spread and marks; a missing one is a dash."""
PUBLISHED, PUBLISHED_DECIMALS = "published", 4
SIMULATED = f"{DATASET} (simulated)"


@dataclass(frozen=True)
class Group:
    """Columns of one origin.

    Attributes:
        label: above them; no other group of the table has it.
        columns: as the paper heads them.
        decimals: to print.
        numbers: of the group.
        protocol: that our models were tested by; "" for none.
        data: what the numbers come from.
    """

    label: str
    columns: Labels
    decimals: int
    numbers: GroupNumbers
    protocol: str = ""
    data: str = SIMULATED

    @classmethod
    def published(cls, values: Numbers, decimals: int = PUBLISHED_DECIMALS) -> Group:
        """Return the paper's columns."""
        columns = tuple(dict.fromkeys(column for _, column in values))
        numbers = {place: Quantity(value, n=1) for place, value in values.items()}
        return cls(PUBLISHED, columns, decimals, numbers, data="KR10 (measured)")

    @property
    def about(self) -> dict[str, object]:
        """Facts on each column, for csv and json."""
        return {
            "group": self.label,
            "source": PUBLISHED if self.label == PUBLISHED else "ours",
            "data": self.data,
            "protocol": self.protocol,
            "seed": SEED if self.protocol else None,
        }


def mean_numbers(each: Sequence[Numbers], mark: str = "") -> GroupNumbers:
    """Return the means over splits, or specimens, at the places that all of them have."""
    shared = [at for at in (each[0] if each else ()) if all(at in one for one in each)]
    return {at: mean_over([one[at] for one in each], mark) for at in shared}


def model_numbers(
    found: Found,
    models: Mapping[Label, Variant],
    errors: Callable[[Label, CellResult], Numbers],
) -> GroupNumbers:
    """Return the means over the splits of the errors of each model, which its label places."""
    numbers = GroupNumbers()
    for label, model in models.items():
        if results := found.results.get(model.name):
            each = [errors(label, result) for result in results]
            numbers |= mean_numbers(each, mark_of(results[0].shown))
    return numbers


def paper_table(
    table: str, rows: Iterable[Labels], groups: Sequence[Group], notes: Iterable[str] = ()
) -> Table:
    """Return a table that `results/published/tables.toml` describes.

    `rows` are the texts under its headings; `notes` follow its own.
    """
    about = about_table(table)
    number, unit = about.get("number", table), about["unit"]
    columns = [Column(heading, "text") for heading in about["headings"]]
    for group in groups:
        form = f".{group.decimals}f"
        columns += [
            Column(name, "number", unit, form, group.label, group.about, marks_shown=False)
            for name in group.columns
        ]
    cells = [
        [*row, *(group.numbers.get((row, name)) for group in groups for name in group.columns)]
        for row in rows
    ]
    title = f"Table {number}. {about['caption']} [{unit}]"
    every_note = [*about["notes"], *notes]
    return Table(title, columns, cells, every_note, unit, about={"table": int(number)})


def published_numbers(lines: Mapping[Labels, Mapping[str, str]], columns: Iterable[str]) -> Numbers:
    """Return the numbers of a published file: "train MAE" is its column "train_mae_mm"."""
    return {
        (row, column): float(line[f"{column.replace(' ', '_').lower()}_mm"])
        for column in columns
        for row, line in lines.items()
    }
