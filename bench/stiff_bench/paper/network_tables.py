"""Tables whose rows are variants of a network, each with the same errors of training and test."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from stiff_bench.paper.names import (
    ACTIVATIONS,
    ALL_PAIRS,
    ALL_SINGLES,
    BASE_LAYERS,
    BASE_WIDTH,
    EARLY_STEPS,
    FT_MLP,
    FT_MLP_LAST_EPOCH,
    pretrained,
    unfrozen,
)
from stiff_bench.paper.results import (
    FULL,
    REPRODUCE,
    PaperResults,
    SharedSplits,
    provenance,
    shared_splits,
)
from stiff_bench.paper.study import DATASET, DEPTH_WIDTH, DEPTHS, PAPER_PROTOCOL, SEED
from stiff_bench.paper.table import PAPER_DATA, Entry, Group, Labels, PaperTable, Part
from stiff_bench.tables.published import published_lines
from stiff_bench.tables.table import mark_of
from stiff_bench.tables.units import MM
from stiff_protocols.contract.errors import StoreError
from stiff_protocols.contract.record import CellResult
from stiff_protocols.contract.types import FloatArray
from stiff_protocols.scoring.metrics import absolute_errors

PAPER_PRETRAINING, PAPER_FINE_TUNING = 100_000, 50_000
"""Steps of the paper's trainings."""
PRETRAINING = "recipe=fast: Muon, Huber loss, 1,024 samples a step, linear decay"
FINE_TUNING = "recipe=fast: Adam, all samples a step, linear decay"
"""How the tables' networks are trained, but for those that are stopped early."""


def pretraining_note(results: Sequence[CellResult]) -> str:
    """Return a line about the pre-trainings."""
    return (
        f"Pre-training: ours {_steps(results, 'pre-training')} ({PRETRAINING}), the paper's "
        f"{PAPER_PRETRAINING:,} iterations (mean squared error; optimizer and batch not stated)."
    )


def fine_tuning_note(results: Sequence[CellResult]) -> str:
    """Return a line about both trainings."""
    return (
        f"{pretraining_note(results)} Fine-tuning: ours {_steps(results, 'fine-tuning')} "
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


_PRETRAINING_DIAGNOSTICS = {
    "train MAE": "source training MAE [mm]",
    "train STDE": "source training STDE [mm]",
    "test MAE": "source test MAE [mm]",
    "test STDE": "source test STDE [mm]",
}
"""Column -> what a pre-trained network reports."""
PRETRAINING_COLUMNS = tuple(_PRETRAINING_DIAGNOSTICS)
EARLY = "ours, stopped early"
_OURS_DECIMALS, _EARLY_DECIMALS = 5, 4
_NOTES = (
    f"The source domain is simulated by a VJM: the paper's by that of the measured KR10, ours by "
    f"that of the simulated {DATASET}, identified on each split's training samples. Not comparable "
    "in absolute terms.",
    "70 % / 30 % of 106,400 samples at random; training errors of ours: of as many training "
    "samples as the test part has.",
    f"Stopped early: plain Adam, {EARLY_STEPS} steps of 256 samples "
    f"(`recipe=paper@pretrain_steps={EARLY_STEPS}`); {EARLY_STEPS} was chosen afterwards, because "
    "the MAEs of Table 6 then are near the paper's. Orders can be compared, errors cannot.",
)


def table_6(results: PaperResults) -> PaperTable:
    """Return the errors on the source domain by depth.

    Raises:
        StoreError: the folder has none of them, or no errors on the source.
    """
    return _table(
        6,
        f"Hidden layers of {DEPTH_WIDTH} nodes each: errors on the source domain, all axes "
        "together",
        "layers",
        Variants(
            OURS,
            {(str(depth),): pretrained(layers=depth, width=DEPTH_WIDTH).name for depth in DEPTHS},
            _OURS_DECIMALS,
        ),
        Variants(
            EARLY,
            {
                (str(depth),): pretrained(layers=depth, width=DEPTH_WIDTH, stopped_early=True).name
                for depth in DEPTHS
            },
            _EARLY_DECIMALS,
        ),
        results,
    )


def table_7(results: PaperResults) -> PaperTable:
    """Return the errors on the source domain by activation.

    Raises:
        StoreError: the folder has none of them, or no errors on the source.
    """
    return _table(
        7,
        f"Activation, {BASE_LAYERS} x {BASE_WIDTH} nodes: errors on the source domain, all axes "
        "together",
        "activation",
        Variants(
            OURS,
            {(name,): pretrained(activation=name).name for name in ACTIVATIONS},
            _OURS_DECIMALS,
        ),
        Variants(
            EARLY,
            {(name,): pretrained(activation=name, stopped_early=True).name for name in ACTIVATIONS},
            _EARLY_DECIMALS,
        ),
        results,
    )


def _table(
    number: int,
    caption: str,
    heading: str,
    ours: Variants,
    early: Variants,
    results: PaperResults,
) -> PaperTable:
    outline = Outline(
        number=number,
        caption=caption,
        headings=(heading,),
        columns=PRETRAINING_COLUMNS,
        published=published_values(f"table_{number}", heading, PRETRAINING_COLUMNS),
        ours=(ours, early),
        errors=source_errors,
        trained=pretraining_note,
        notes=_NOTES,
    )
    (part,) = model_table(outline, results).parts
    notes = (*_NOTES, *_sizes(part), *part.notes[len(_NOTES) :])
    return PaperTable(number, (replace(part, notes=notes),))


def _sizes(part: Part) -> Iterator[str]:
    """Yield how near the errors of those that were stopped early are to the paper's."""
    places = [
        (row, side)
        for row in part.rows
        for side in ("train", "test")
        if (row, EARLY, f"{side} MAE") in part.entries
    ]

    def of(group: str, error: str) -> FloatArray:
        return np.array([part.entries[row, group, f"{side} {error}"].mean for row, side in places])

    if places:
        yield (
            f"Stopped early: MAE {_range(of(EARLY, 'MAE') / of(PUBLISHED, 'MAE'))} of the "
            f"published; STDE / MAE {_range(of(EARLY, 'STDE') / of(EARLY, 'MAE'))}, published "
            f"{_range(of(PUBLISHED, 'STDE') / of(PUBLISHED, 'MAE'))}."
        )


def _range(values: FloatArray) -> str:
    return f"{values.min():.2f} to {values.max():.2f}"


def source_errors(result: CellResult) -> Values:
    """Return the errors on the source domain that a pre-trained network reports, mm.

    Raises:
        StoreError: the result has none: an older stiffbench made it.
    """
    return reported(result, _PRETRAINING_DIAGNOSTICS)


FINE_TUNING_COLUMNS = ("train MAE", "train STDE", "validation MAE", "validation STDE")
ROWS_9: dict[str, Labels] = {
    "normal": ("normal (last epoch)",),
    "optimized": ("optimized (best epoch)",),
}
_DECIMALS_9 = 5
"""In the last epoch 120 samples are learned to about 0.0001 mm."""
_DIAGNOSTICS = {"train MAE": "training MAE [mm]", "train STDE": "training STDE [mm]"}
_TOGETHER = "All axes and samples together. Validation is the 20 % test part."


def table_8(results: PaperResults) -> PaperTable:
    """Return the errors by which layers are unfrozen; ours alone.

    Raises:
        StoreError: the folder has none of them, or no errors of training.
    """
    models: dict[Labels, str] = {
        ("1 layer", layers[0]): unfrozen(layers).name for layers in ALL_SINGLES
    }
    models |= {("2 layers", " + ".join(layers)): unfrozen(layers).name for layers in ALL_PAIRS}
    outline = Outline(
        number=8,
        caption="Unfrozen layers of the fine-tuned network",
        headings=("moving", "layers"),
        columns=FINE_TUNING_COLUMNS,
        published={},
        ours=(Variants(OURS, models, PUBLISHED_DECIMALS),),
        errors=target_errors,
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
    return model_table(outline, results)


def table_9(results: PaperResults) -> PaperTable:
    """Return the errors of the last epoch's weights and of the best epoch's.

    Raises:
        StoreError: the folder has neither, or no errors of training.
    """
    published = published_values("table_9", "training", FINE_TUNING_COLUMNS)
    models = {ROWS_9["normal"]: FT_MLP_LAST_EPOCH.name, ROWS_9["optimized"]: FT_MLP}
    outline = Outline(
        number=9,
        caption="Fine-tuning of layers 1 + 2: last epoch and best epoch",
        headings=("training",),
        columns=FINE_TUNING_COLUMNS,
        published={row: published[name,] for name, row in ROWS_9.items()},
        ours=(Variants(OURS, models, _DECIMALS_9),),
        errors=target_errors,
        trained=fine_tuning_note,
        notes=(
            "Published: KR10 measured. Ours: simulated. Not comparable in absolute terms.",
            _TOGETHER,
            "The paper's validation MAE of the best epoch, 0.1604 mm, is 3.8 times the mean over "
            "the axes of FT-MLP's MAE in its Table 10, 0.0424 mm.",
        ),
    )
    return model_table(outline, results)


def target_errors(result: CellResult) -> Values:
    """Return the errors on training and test part, mm, all axes and samples together.

    Raises:
        StoreError: the result has none: an older stiffbench made it.
    """
    trained = reported(result, _DIAGNOSTICS)
    if result.prediction is None:
        raise StoreError(f"{result.shown.model}: a result without predictions")
    errors = absolute_errors(result.prediction) * MM
    return trained | {
        "validation MAE": float(errors.mean()),
        "validation STDE": float(errors.std()),
    }
