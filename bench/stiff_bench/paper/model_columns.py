"""Tables whose rows are variants of a network, each with the same errors of training and test."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass

from stiff_bench.paper.paper_results import PaperResults
from stiff_bench.paper.paper_table import PAPER_DATA, Entry, Group, Labels, PaperTable, Part
from stiff_bench.paper.shared_splits import REPRODUCE, SharedSplits, provenance, shared_splits
from stiff_bench.paper.study import DATASET, PAPER_PROTOCOL, SEED
from stiff_bench.published import published_lines
from stiff_bench.tables import mark_of
from stiff_protocols.errors import StoreError
from stiff_protocols.record import CellResult

OURS = f"ours, {PAPER_PROTOCOL}"
PUBLISHED_DECIMALS = 4
PUBLISHED = "published"
"""Label of the paper's columns."""

Values = Mapping[str, float]
"""Column -> mm."""
Errors = Callable[[CellResult], Values]


@dataclass(frozen=True)
class Variants:
    """Our models of one group of columns.

    Attributes:
        label: above them.
        models: row -> model.
        decimals: to print.
    """

    label: str
    models: Mapping[Labels, str]
    decimals: int


@dataclass(frozen=True)
class Outline:
    """What differs from table to table.

    Attributes:
        number: in the paper.
        caption: of the table.
        headings: of the columns that name a row.
        columns: of every group.
        published: row -> what the paper prints; empty where it is not known.
        ours: a group of columns each; the first is what the note on training lengths is of.
        errors: a result -> its values.
        trained: results -> a note on how long they were trained.
        notes: before those that every table has.
        remedy: the command that makes what is missing.
    """

    number: int
    caption: str
    headings: Labels
    columns: Labels
    published: Mapping[Labels, Values]
    ours: tuple[Variants, ...]
    errors: Errors
    trained: Callable[[Sequence[CellResult]], str]
    notes: tuple[str, ...]
    remedy: str = REPRODUCE

    @property
    def models(self) -> dict[str, str]:
        """Every model of ours -> what it is called in the table."""
        return {
            model: " ".join(row) + ("" if number == 0 else f" ({variants.label})")
            for number, variants in enumerate(self.ours)
            for row, model in variants.models.items()
        }


def published_values(name: str, row: str, columns: Labels) -> dict[Labels, Values]:
    """Return row -> column -> mm of a published table whose columns are in this order."""
    found = dict[Labels, Values]()
    for line in published_lines(name):
        label = line.pop(row)
        found[label,] = dict(zip(columns, map(float, line.values()), strict=True))
    return found


def reported(result: CellResult, names: Mapping[str, str]) -> dict[str, float]:
    """Return column -> what a model reported, by column -> name of the diagnostic.

    Raises:
        StoreError: the result has none: an older stiffbench made it.
    """
    absent = [name for name in names.values() if name not in result.diagnostics]
    if absent:
        shown = result.shown
        raise StoreError(
            f"{shown.model} on {shown.dataset} under {shown.protocol}: its result has no "
            f"{absent[0]!r}: an older stiffbench made it; {REPRODUCE} makes it anew"
        )
    return {column: result.diagnostics[name] for column, name in names.items()}


def model_table(outline: Outline, results: PaperResults) -> PaperTable:
    """Return a table of one part.

    Raises:
        StoreError: the folder has none of the models, or no numbers of any.
    """
    shared = shared_splits(results, outline.models, PAPER_PROTOCOL)
    groups, entries = list[Group](), dict[tuple[Labels, str, str], Entry]()
    values, unread = _errors_of(shared, outline.errors)
    if outline.published:
        groups.append(
            Group(PUBLISHED, "published", outline.columns, PUBLISHED_DECIMALS, PAPER_DATA)
        )
        entries |= {
            (row, PUBLISHED, column): Entry(value)
            for row, values in outline.published.items()
            for column, value in values.items()
        }
    for variants in outline.ours:
        data = f"{DATASET} (simulated)"
        about = (variants.decimals, data, PAPER_PROTOCOL, SEED)
        groups.append(Group(variants.label, "ours", outline.columns, *about))
        entries |= _our_entries(variants, shared, values)
    rows = tuple(
        row
        for row, model in outline.ours[0].models.items()
        if row in outline.published or model not in shared.missing
    )
    first = [
        result
        for model in outline.ours[0].models.values()
        for result in shared.results.get(model, ())
    ]
    notes = (
        *outline.notes,
        *shared.notes(outline.remedy, outline.models),
        *(f"No numbers: {reason}." for reason in unread),
        outline.trained(first),
        provenance(results, [shared]),
    )
    part = Part(outline.caption, "mm", outline.headings, rows, tuple(groups), entries, notes)
    return PaperTable(outline.number, (part,))


def _errors_of(shared: SharedSplits, errors: Errors) -> tuple[dict[str, list[Values]], list[str]]:
    """Return model -> its values split by split, and why others have none.

    Raises:
        StoreError: all have none.
    """
    found, refused = dict[str, list[Values]](), list[StoreError]()
    for model, results in shared.results.items():
        try:
            found[model] = [errors(result) for result in results]
        except StoreError as error:
            refused.append(error)
    if not found:
        raise refused[0]
    return found, [str(error) for error in refused]


def _our_entries(
    variants: Variants, shared: SharedSplits, values: Mapping[str, Sequence[Values]]
) -> dict[tuple[Labels, str, str], Entry]:
    return {
        (row, variants.label, column): Entry.of(
            [of_split[column] for of_split in values[model]],
            mark_of(shared.results[model][0].shown),
        )
        for row, model in variants.models.items()
        if model in values
        for column in values[model][0]
    }
