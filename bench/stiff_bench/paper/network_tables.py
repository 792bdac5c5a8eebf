"""Tables 6 to 9: rows are variants of a network, with the same errors of training and test each."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import replace

import numpy as np

from stiff_bench.paper.results import FULL, REPRODUCE, PaperResults
from stiff_bench.paper.study import (
    ACTIVATIONS,
    ALL_PAIRS,
    ALL_SINGLES,
    BASE_LAYERS,
    BASE_WIDTH,
    DATASET,
    DEPTH_WIDTH,
    DEPTHS,
    EARLY_STEPS,
    FT_MLP,
    FT_MLP_LAST_EPOCH,
    PAPER_PROTOCOL,
    SEED,
    pretrained,
    unfrozen,
)
from stiff_bench.paper.table import PAPER_DATA, Group, Labels, Part, Unit
from stiff_bench.store.names import Variant
from stiff_bench.tables.metric_table import mark_of, mean_over
from stiff_bench.tables.published import published_lines
from stiff_bench.tables.table import Quantity
from stiff_bench.tables.units import MM
from stiff_protocols.contract.errors import StoreError
from stiff_protocols.contract.record import CellResult
from stiff_protocols.contract.types import FloatArray
from stiff_protocols.scoring.metrics import absolute_errors

PUBLISHED, PUBLISHED_DECIMALS = "published", 4
SIMULATED = f"{DATASET} (simulated)"
Numbers = Mapping[tuple[Labels, str], Quantity]
"""(row, column) -> number of one group of columns."""


def part_of(
    caption: str,
    unit: Unit,
    headings: Labels,
    rows: Iterable[Labels],
    groups: Mapping[Group, Numbers],
    notes: Iterable[str],
) -> Part:
    """Return a part of a table, group by group of its columns."""
    entries = {
        (row, group.label, column): entry
        for group, numbers in groups.items()
        for (row, column), entry in numbers.items()
    }
    return Part(caption, unit, headings, tuple(rows), tuple(groups), entries, tuple(notes))


def published_group(columns: Labels, decimals: int = PUBLISHED_DECIMALS) -> Group:
    """Return the paper's columns."""
    return Group(PUBLISHED, "published", columns, decimals, PAPER_DATA)


def our_group(protocol: str, columns: Labels, decimals: int, label: str = "") -> Group:
    """Return columns of models that were tested by a protocol."""
    label = label or f"ours, {protocol}"
    return Group(label, "ours", columns, decimals, SIMULATED, protocol, SEED)


PAPER_PRETRAINING, PAPER_FINE_TUNING = 100_000, 50_000
"""Steps of the paper's trainings."""
PRETRAINING = "recipe=fast: Muon, Huber loss, 1,024 samples a step, linear decay"
FINE_TUNING = "recipe=fast: Adam, all samples a step, linear decay"
"""How the tables' networks are trained, but for those that are stopped early."""


def _pretraining_note(results: Sequence[CellResult]) -> str:
    return (
        f"Pre-training: ours {_steps(results, 'pre-training')} ({PRETRAINING}), the paper's "
        f"{PAPER_PRETRAINING:,} iterations (mean squared error; optimizer and batch not stated)."
    )


def fine_tuning_note(results: Sequence[CellResult]) -> str:
    """Return a line about both trainings."""
    return (
        f"{_pretraining_note(results)} Fine-tuning: ours {_steps(results, 'fine-tuning')} "
        f"({FINE_TUNING}), the paper's {PAPER_FINE_TUNING:,} epochs at a rate of 0.03; both of the "
        "mean absolute error."
    )


def _steps(results: Sequence[CellResult], training: str) -> str:
    """Return how many steps the results' curves of a training go."""
    lengths = sorted(
        {int(one.curves[training][-1, 0]) for one in results if len(one.curves.get(training, ()))}
    )
    if not lengths:
        return "of unknown length"
    return f"{' or '.join(f'{length:,}' for length in lengths)} steps"


Values = Mapping[str, float]
"""Column -> mm."""


def _network_table(
    results: PaperResults,
    caption: str,
    headings: Labels,
    *,
    published: Mapping[Labels, Values],
    ours: Mapping[Group, Mapping[Labels, str]],
    errors: Callable[[CellResult], Values],
    trained: Callable[[Sequence[CellResult]], str],
    notes: tuple[str, ...],
    remedy: str = REPRODUCE,
) -> Part:
    """Return a table whose rows are variants of a network.

    Args:
        results: that ours come from.
        caption: of the table.
        headings: of the columns that name a row.
        published: row -> what the paper prints; empty where it is not known.
        ours: a group of columns -> row -> model; the note on training lengths is of the first.
        errors: a result -> its values.
        trained: results -> a note on how long they were trained.
        notes: before those that every table has.
        remedy: the command that makes what is missing.

    Raises:
        StoreError: the folder has none of the models, or no numbers of any.
    """
    first, *_ = ours
    labels = {
        model: " ".join(row) + ("" if group == first else f" ({group.label})")
        for group, models in ours.items()
        for row, model in models.items()
    }
    found = results.on_shared_splits(labels, PAPER_PROTOCOL)
    values, unread = dict[str, list[Values]](), list[StoreError]()
    for model, of_model in found.results.items():
        try:
            values[model] = [errors(result) for result in of_model]
        except StoreError as error:
            unread.append(error)
    if not values:
        raise unread[0]
    groups = dict[Group, Numbers]()
    if published:
        groups[published_group(first.columns)] = {
            (row, column): Quantity(value, n=1)
            for row, of_row in published.items()
            for column, value in of_row.items()
        }
    for group, models in ours.items():
        groups[group] = {
            (row, column): mean_over(
                [of_split[column] for of_split in values[model]],
                mark_of(found.results[model][0].shown),
            )
            for row, model in models.items()
            if model in values
            for column in group.columns
        }
    rows = [
        row for row, model in ours[first].items() if row in published or model not in found.missing
    ]
    of_first = [one for model in ours[first].values() for one in found.results.get(model, ())]
    all_notes = [
        *notes,
        *found.notes(remedy, labels),
        *(f"No numbers: {error}." for error in unread),
        trained(of_first),
        results.provenance([found]),
    ]
    return part_of(caption, "mm", headings, rows, groups, all_notes)


def _published_values(name: str, row: str, columns: Labels) -> dict[Labels, Values]:
    """Return row -> column -> mm of a published table whose columns are in this order."""
    lines = published_lines(name)
    labels = [(line.pop(row),) for line in lines]
    values = [dict(zip(columns, map(float, line.values()), strict=True)) for line in lines]
    return dict(zip(labels, values, strict=True))


def _reported(result: CellResult, names: Mapping[str, str]) -> dict[str, float]:
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


_ON_SOURCE = {
    "train MAE": "source training MAE [mm]",
    "train STDE": "source training STDE [mm]",
    "test MAE": "source test MAE [mm]",
    "test STDE": "source test STDE [mm]",
}
"""Column -> what a pre-trained network reports."""
EARLY = "ours, stopped early"
_SOURCE_NOTES = (
    f"The source domain is simulated by a VJM: the paper's by that of the measured KR10, ours by "
    f"that of the simulated {DATASET}, identified on each split's training samples. Not comparable "
    "in absolute terms.",
    "70 % / 30 % of 106,400 samples at random; training errors of ours: of as many training "
    "samples as the test part has.",
    f"Stopped early: plain Adam, {EARLY_STEPS} steps of 256 samples "
    f"(`recipe=paper@pretrain_steps={EARLY_STEPS}`); {EARLY_STEPS} was chosen afterwards, because "
    "the MAEs of Table 6 then are near the paper's. Orders can be compared, errors cannot.",
)


def table_6(results: PaperResults) -> Part:
    """Return the errors on the source domain by depth."""
    return _source_table(
        results,
        "table_6",
        "layers",
        f"Hidden layers of {DEPTH_WIDTH} nodes each",
        {str(depth): pretrained(layers=depth, width=DEPTH_WIDTH).name for depth in DEPTHS},
        {
            str(depth): pretrained(layers=depth, width=DEPTH_WIDTH, stopped_early=True).name
            for depth in DEPTHS
        },
    )


def table_7(results: PaperResults) -> Part:
    """Return the errors on the source domain by activation."""
    return _source_table(
        results,
        "table_7",
        "activation",
        f"Activation, {BASE_LAYERS} x {BASE_WIDTH} nodes",
        {name: pretrained(activation=name).name for name in ACTIVATIONS},
        {name: pretrained(activation=name, stopped_early=True).name for name in ACTIVATIONS},
    )


def _source_table(
    results: PaperResults,
    published: str,
    heading: str,
    what: str,
    ours: Mapping[str, str],
    early: Mapping[str, str],
) -> Part:
    """Return the errors of pre-trained networks; rows of `ours` and `early` -> model."""
    columns = tuple(_ON_SOURCE)
    part = _network_table(
        results,
        f"{what}: errors on the source domain, all axes together",
        (heading,),
        published=_published_values(published, heading, columns),
        ours={
            our_group(PAPER_PROTOCOL, columns, 5): {(row,): model for row, model in ours.items()},
            our_group(PAPER_PROTOCOL, columns, PUBLISHED_DECIMALS, EARLY): {
                (row,): model for row, model in early.items()
            },
        },
        errors=lambda result: _reported(result, _ON_SOURCE),
        trained=_pretraining_note,
        notes=_SOURCE_NOTES,
    )
    of_table, others = part.notes[: len(_SOURCE_NOTES)], part.notes[len(_SOURCE_NOTES) :]
    return replace(part, notes=(*of_table, *_nearness(part), *others))


def _nearness(part: Part) -> Iterator[str]:
    """Yield how near the errors of those that were stopped early are to the paper's."""
    places = [
        (row, side)
        for row in part.rows
        for side in ("train", "test")
        if (row, EARLY, f"{side} MAE") in part.entries
    ]

    def of(group: str, error: str) -> FloatArray:
        return np.array([part.entries[row, group, f"{side} {error}"].value for row, side in places])

    def span(values: FloatArray) -> str:
        return f"{values.min():.2f} to {values.max():.2f}"

    if places:
        yield (
            f"Stopped early: MAE {span(of(EARLY, 'MAE') / of(PUBLISHED, 'MAE'))} of the "
            f"published; STDE / MAE {span(of(EARLY, 'STDE') / of(EARLY, 'MAE'))}, published "
            f"{span(of(PUBLISHED, 'STDE') / of(PUBLISHED, 'MAE'))}."
        )


FINE_TUNING_COLUMNS = ("train MAE", "train STDE", "validation MAE", "validation STDE")
_DECIMALS_9 = 5
"""In the last epoch 120 samples are learned to about 0.0001 mm."""
_TOGETHER = "All axes and samples together. Validation is the 20 % test part."


def table_8(results: PaperResults) -> Part:
    """Return the errors by which layers are unfrozen; ours alone."""
    variants: dict[Labels, Variant] = {
        **{("1 layer", layers[0]): unfrozen(layers) for layers in ALL_SINGLES},
        **{("2 layers", " + ".join(layers)): unfrozen(layers) for layers in ALL_PAIRS},
    }
    models = {row: variant.name for row, variant in variants.items()}
    return _network_table(
        results,
        "Unfrozen layers of the fine-tuned network",
        ("moving", "layers"),
        published={},
        ours={our_group(PAPER_PROTOCOL, FINE_TUNING_COLUMNS, PUBLISHED_DECIMALS): models},
        errors=_target_errors,
        trained=fine_tuning_note,
        notes=(
            "Ours alone: the numbers of the paper's Table 8 are not available to us. Its text "
            "finds two layers much better than one, and 1 + 2 the best pair.",
            "Ours are from a simulated robot, not comparable with the paper's in absolute terms.",
            "Layers are counted from the input; out: the output layer.",
            _TOGETHER,
        ),
        remedy=FULL,
    )


def table_9(results: PaperResults) -> Part:
    """Return the errors of the last epoch's weights and of the best epoch's."""
    published = _published_values("table_9", "training", FINE_TUNING_COLUMNS)
    last, best = ("normal (last epoch)",), ("optimized (best epoch)",)
    return _network_table(
        results,
        "Fine-tuning of layers 1 + 2: last epoch and best epoch",
        ("training",),
        published={last: published["normal",], best: published["optimized",]},
        ours={
            our_group(PAPER_PROTOCOL, FINE_TUNING_COLUMNS, _DECIMALS_9): {
                last: FT_MLP_LAST_EPOCH.name,
                best: FT_MLP,
            }
        },
        errors=_target_errors,
        trained=fine_tuning_note,
        notes=(
            "Published: KR10 measured. Ours: simulated. Not comparable in absolute terms.",
            _TOGETHER,
            "The paper's validation MAE of the best epoch, 0.1604 mm, is 3.8 times the mean over "
            "the axes of FT-MLP's MAE in its Table 10, 0.0424 mm.",
        ),
    )


def _target_errors(result: CellResult) -> Values:
    """Return the errors on training and test part, mm, all axes and samples together.

    Raises:
        StoreError: the result has none: an older stiffbench made it.
    """
    of_training = {"train MAE": "training MAE [mm]", "train STDE": "training STDE [mm]"}
    trained = _reported(result, of_training)
    if result.prediction is None:
        raise StoreError(f"{result.shown.model}: a result without predictions")
    errors = absolute_errors(result.prediction) * MM
    validated = {"validation MAE": float(errors.mean()), "validation STDE": float(errors.std())}
    return trained | validated
