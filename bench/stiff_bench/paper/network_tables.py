"""Tables 6 to 8: rows are variants of a network, with the same errors each."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass

from stiff_bench.paper.results import FULL, REPRODUCE, PaperResults
from stiff_bench.paper.study import (
    ACTIVATIONS,
    ALL_PAIRS,
    ALL_SINGLES,
    BASE_LAYERS,
    BASE_WIDTH,
    DEPTH_WIDTH,
    DEPTHS,
    EARLY_STEPS,
    PAPER_PROTOCOL,
    pretrained,
    unfrozen,
)
from stiff_bench.paper.table import COMPARE, PUBLISHED_DECIMALS, Group, Labels, paper_table
from stiff_bench.tables.metric_table import mark_of, mean_over, pooled_prediction
from stiff_bench.tables.published import published_lines
from stiff_bench.tables.table import Table
from stiff_bench.tables.units import MM, counted
from stiff_protocols.contract.record import CellResult
from stiff_protocols.scoring.metrics import absolute_errors

Values = Mapping[str, float]
"""Column -> mm."""
Models = Mapping[Labels, str]
"""Row -> model."""


@dataclass(frozen=True)
class NetworkTable:
    """What a table shows.

    Attributes:
        caption: of the table.
        headings: of the columns that name a row.
        published: row -> what the paper prints; empty where it is not known.
        ours, early: rows and models; those of a second group of columns were stopped early.
        columns: of each group.
        errors: a result -> its values by column.
        notes: before those that every table has.
        decimals: of our first group.
        remedy: the command that makes what is missing.
    """

    caption: str
    headings: Labels
    published: Mapping[Labels, Values]
    ours: Models
    columns: Labels
    errors: Callable[[CellResult], Values]
    notes: tuple[str, ...]
    decimals: int = 5
    early: Models | None = None
    remedy: str = REPRODUCE


def _published(name: str, row: str, columns: Labels) -> dict[Labels, Values]:
    """Return row -> column -> mm of a published table whose columns are in this order."""
    found: dict[Labels, Values] = {}
    for line in published_lines(name):
        label = line.pop(row)
        found[(label,)] = dict(zip(columns, map(float, line.values()), strict=True))
    return found


_ON_SOURCE = {
    "train MAE": "source training MAE [mm]",
    "train STDE": "source training STDE [mm]",
    "test MAE": "source test MAE [mm]",
    "test STDE": "source test STDE [mm]",
}
"""Column -> what a pre-trained network reports."""
_ON_TARGET = ("validation MAE", "validation STDE")


def _source_errors(result: CellResult) -> Values:
    """Return the errors on both parts of the source domain that were reported."""
    found = result.diagnostics
    return {column: found[name] for column, name in _ON_SOURCE.items() if name in found}


def _target_errors(result: CellResult) -> Values:
    """Return the errors on the test part, mm, all axes and samples together."""
    errors = absolute_errors(pooled_prediction([result])) * MM
    return dict(zip(_ON_TARGET, (float(errors.mean()), float(errors.std())), strict=True))


_ON_SOURCE_TEXT = ": errors on the simulated pre-training data, all axes together"
EARLY = "ours, stopped early"
_SOURCE_NOTES = (
    COMPARE,
    f"Stopped early: {EARLY_STEPS} steps of plain Adam, chosen afterwards to be near the MAEs of "
    "the paper's Table 6: compare the order, not the errors.",
)
NETWORK_TABLES: Mapping[int, Callable[[], NetworkTable]] = {
    6: lambda: NetworkTable(
        f"Hidden layers of {DEPTH_WIDTH} nodes each{_ON_SOURCE_TEXT}",
        ("layers",),
        _published("table_6", "layers", tuple(_ON_SOURCE)),
        {(str(d),): pretrained(layers=d, width=DEPTH_WIDTH).name for d in DEPTHS},
        tuple(_ON_SOURCE),
        _source_errors,
        _SOURCE_NOTES,
        early={
            (str(d),): pretrained(layers=d, width=DEPTH_WIDTH, stopped_early=True).name
            for d in DEPTHS
        },
    ),
    7: lambda: NetworkTable(
        f"Activation, {BASE_LAYERS} x {BASE_WIDTH} nodes{_ON_SOURCE_TEXT}",
        ("activation",),
        _published("table_7", "activation", tuple(_ON_SOURCE)),
        {(kind,): pretrained(activation=kind).name for kind in ACTIVATIONS},
        tuple(_ON_SOURCE),
        _source_errors,
        _SOURCE_NOTES,
        early={
            (kind,): pretrained(activation=kind, stopped_early=True).name for kind in ACTIVATIONS
        },
    ),
    8: lambda: NetworkTable(
        "Unfrozen layers of the fine-tuned network",
        ("moving", "layers"),
        {},
        {
            (counted(len(layers), "layer"), " + ".join(layers)): unfrozen(layers).name
            for layers in (*ALL_SINGLES, *ALL_PAIRS)
        },
        _ON_TARGET,
        _target_errors,
        (
            "Ours alone, simulated, not comparable in absolute terms; the numbers of the paper's "
            "Table 8 are not available to us.",
            "Layers from the input on; out: the output layer. All axes and samples together; "
            "validation is the 20 % test part, which picks the epoch.",
        ),
        decimals=PUBLISHED_DECIMALS,
        remedy=FULL,
    ),
}
"""Number in the paper -> what it shows."""


def network_table(number: int, results: PaperResults) -> Table:
    """Return one of `NETWORK_TABLES`.

    Raises:
        StoreError: the folder has none of the models.
    """
    wanted = NETWORK_TABLES[number]()
    columns = wanted.columns
    early = wanted.early or {}
    labels = {model: " ".join(row) for row, model in wanted.ours.items()}
    labels |= {model: f"{' '.join(row)} ({EARLY})" for row, model in early.items()}
    found = results.on_shared_splits(labels, PAPER_PROTOCOL.name)
    values = {
        model: [wanted.errors(result) for result in of_model]
        for model, of_model in found.results.items()
    }

    def group(models: Models, decimals: int, label: str = "") -> Group:
        numbers = {
            (row, column): mean_over(
                [of_split[column] for of_split in values[model]],
                mark_of(found.results[model][0].shown),
            )
            for row, model in models.items()
            if model in values
            for column in columns
            if all(column in of_split for of_split in values[model])
        }
        return Group.ours(PAPER_PROTOCOL.name, columns, decimals, numbers, label)

    groups = [group(wanted.ours, wanted.decimals)]
    if wanted.published:
        of_paper = {
            (row, column): value
            for row, of_row in wanted.published.items()
            for column, value in of_row.items()
        }
        groups.insert(0, Group.published(columns, of_paper))
    if wanted.early:
        groups.append(group(wanted.early, PUBLISHED_DECIMALS, EARLY))
    rows = [
        row
        for row, model in wanted.ours.items()
        if row in wanted.published or model not in found.missing
    ]
    notes = [
        *wanted.notes,
        found.about,
        *found.absences(wanted.remedy, labels),
        results.provenance([found]),
    ]
    return paper_table(number, wanted.caption, "mm", wanted.headings, rows, groups, notes)
