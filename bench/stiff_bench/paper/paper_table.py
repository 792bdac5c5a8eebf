"""A table of the source paper beside ours: what it holds, whatever it is printed as."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Final, Literal

import numpy as np

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
