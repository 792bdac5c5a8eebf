"""Tables 6 to 8: rows are variants of a network, with the same errors each."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping
from typing import Any

from stiff_bench.figures.variants import SOURCE_MAE
from stiff_bench.paper.column_groups import (
    COMPARE,
    PUBLISHED_DECIMALS,
    Group,
    GroupNumbers,
    Labels,
    Numbers,
    mean_numbers,
    paper_table,
    published_key,
)
from stiff_bench.paper.paper_models import (
    ACTIVATIONS,
    ALL_PAIRS,
    ALL_SINGLES,
    BASE_LAYERS,
    BASE_WIDTH,
    DEPTH_WIDTH,
    DEPTHS,
    EARLY_STEPS,
    pretrained,
    unfrozen,
)
from stiff_bench.paper.paper_models import PAPER_PROTOCOL as PROTOCOL
from stiff_bench.paper.paper_results import REPRODUCE, Found, PaperResults
from stiff_bench.store.names import Variant
from stiff_bench.tables.metric_table import mark_of, pooled_prediction
from stiff_bench.tables.published import published_lines
from stiff_bench.tables.table import Table
from stiff_bench.tables.units import MM, counted
from stiff_protocols.contract.record import CellResult
from stiff_protocols.scoring.metrics import absolute_errors

Models = Mapping[Labels, Variant]
"""Row -> model."""
Networks = Mapping[str, Mapping[str, Any]]
"""Row -> arguments of `pretrained`."""
ON_SOURCE = {
    "train MAE": "source training MAE [mm]",
    "train STDE": "source training STDE [mm]",
    "test MAE": SOURCE_MAE,
    "test STDE": "source test STDE [mm]",
}
"""Column -> what a pre-trained network reports."""
_ON_TARGET = ("validation MAE", "validation STDE")
EARLY = "ours, stopped early"
_SOURCE_NOTES = (
    COMPARE,
    f"Stopped early: {EARLY_STEPS} steps of plain Adam, chosen afterwards to be near "
    "the MAEs of the paper's Table 6: compare the order, not the errors.",
)
_TARGET_NOTES = (
    "Ours alone, simulated, not comparable in absolute terms; the numbers of the paper's Table 8 "
    "are not available to us.",
    "Layers from the input on; out: the output layer. All axes and samples together; validation "
    "is the 20 % test part, which picks the epoch.",
)


def table_6(results: PaperResults) -> list[Table]:
    """Return the errors of pre-trained networks by depth; errors as in `on_shared_splits`."""
    width = DEPTH_WIDTH
    networks: Networks = {str(depth): {"layers": depth, "width": width} for depth in DEPTHS}
    return _on_source(6, "layers", f"Hidden layers of {width} nodes each", networks, results)


def table_7(results: PaperResults) -> list[Table]:
    """Return the errors of pre-trained networks by activation; errors as in `on_shared_splits`."""
    networks: Networks = {kind: {"activation": kind} for kind in ACTIVATIONS}
    caption = f"Activation, {BASE_LAYERS} x {BASE_WIDTH} nodes"
    return _on_source(7, "activation", caption, networks, results)


def _on_source(
    number: int,
    heading: str,
    caption: str,
    networks: Networks,
    results: PaperResults,
) -> list[Table]:
    """Return a table of pre-trained networks, a row each."""
    published: Numbers = {
        ((line[heading],), column): float(line[published_key(column)])
        for line in published_lines(f"table_{number}")
        for column in ON_SOURCE
    }
    ours: Models = {(row,): pretrained(**given) for row, given in networks.items()}
    early: Models = {
        (row,): pretrained(**given, stopped_early=True) for row, given in networks.items()
    }
    labels = {model.name: row for (row,), model in ours.items()}
    labels |= {model.name: f"{row} ({EARLY})" for (row,), model in early.items()}
    found = results.on_shared_splits([*ours.values(), *early.values()], PROTOCOL)
    of_ours, of_early = (_numbers(found, models, _source_errors) for models in (ours, early))
    groups = [
        Group.published(published),
        Group(f"ours, {PROTOCOL}", tuple(ON_SOURCE), 5, of_ours, PROTOCOL),
        Group(EARLY, tuple(ON_SOURCE), PUBLISHED_DECIMALS, of_early, PROTOCOL),
    ]
    caption += ": errors on the simulated pre-training data, all axes together"
    notes = [*_SOURCE_NOTES, *_stored(found, results, found.absences(labels=labels))]
    return [paper_table(number, caption, "mm", (heading,), ours, groups, notes)]


def _source_errors(result: CellResult) -> Mapping[str, float]:
    """Return the errors on both parts of the source domain that were reported."""
    reported = result.diagnostics
    return {column: reported[name] for column, name in ON_SOURCE.items() if name in reported}


def table_8(results: PaperResults) -> list[Table]:
    """Return the errors of fine-tuned networks by layers; errors as in `on_shared_splits`."""
    models: Models = {
        (counted(len(layers), "layer"), " + ".join(layers)): unfrozen(layers)
        for layers in (*ALL_SINGLES, *ALL_PAIRS)
    }
    labels = {model.name: " ".join(row) for row, model in models.items()}
    found = results.on_shared_splits(models.values(), PROTOCOL)
    numbers = _numbers(found, models, _target_errors)
    groups = [Group(f"ours, {PROTOCOL}", _ON_TARGET, PUBLISHED_DECIMALS, numbers, PROTOCOL)]
    rows = [row for row, model in models.items() if model.name not in found.missing]
    caption = "Unfrozen layers of the fine-tuned network"
    notes = [*_TARGET_NOTES, *_stored(found, results, found.absences(REPRODUCE, labels))]
    return [paper_table(8, caption, "mm", ("moving", "layers"), rows, groups, notes)]


def _target_errors(result: CellResult) -> Mapping[str, float]:
    """Return the errors on the test part, mm, all axes and samples together."""
    errors = absolute_errors(pooled_prediction([result])) * MM
    return dict(zip(_ON_TARGET, (float(errors.mean()), float(errors.std())), strict=True))


def _stored(found: Found, results: PaperResults, absences: Iterator[str]) -> list[str]:
    """Return the notes on the results of a table."""
    return [f"Ours: {found.setting}", *absences, results.provenance([found])]


def _numbers(
    found: Found, models: Models, errors: Callable[[CellResult], Mapping[str, float]]
) -> GroupNumbers:
    """Return the means over the splits of the errors, by column, that all splits have."""
    numbers = GroupNumbers()
    for row, model in models.items():
        of_model = found.results.get(model.name, ())
        each: list[Numbers] = [
            {(row, name): value for name, value in errors(one).items()} for one in of_model
        ]
        numbers |= mean_numbers(each, mark_of(of_model[0].shown) if of_model else "")
    return numbers
