"""Tables 6 and 7: how well networks of some depths and activations learn the source domain."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace

import numpy as np

from stiff_bench.paper.model_columns import (
    OURS,
    PUBLISHED,
    Outline,
    Values,
    Variants,
    model_table,
    published_values,
    reported,
)
from stiff_bench.paper.model_words import (
    ACTIVATIONS,
    BASE_LAYERS,
    BASE_WIDTH,
    EARLY_STEPS,
    pretrained,
)
from stiff_bench.paper.paper_results import PaperResults
from stiff_bench.paper.paper_table import PaperTable, Part
from stiff_bench.paper.recipe_words import pretraining_note
from stiff_bench.paper.study import DATASET, DEPTH_WIDTH, DEPTHS
from stiff_protocols.record import CellResult
from stiff_protocols.types import FloatArray

_DIAGNOSTICS = {
    "train MAE": "source training MAE [mm]",
    "train STDE": "source training STDE [mm]",
    "test MAE": "source test MAE [mm]",
    "test STDE": "source test STDE [mm]",
}
"""Column -> what a pre-trained network reports."""
COLUMNS = tuple(_DIAGNOSTICS)
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
            {(str(depth),): pretrained(layers=depth, width=DEPTH_WIDTH) for depth in DEPTHS},
            _OURS_DECIMALS,
        ),
        Variants(
            EARLY,
            {
                (str(depth),): pretrained(layers=depth, width=DEPTH_WIDTH, stopped_early=True)
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
            OURS, {(name,): pretrained(activation=name) for name in ACTIVATIONS}, _OURS_DECIMALS
        ),
        Variants(
            EARLY,
            {(name,): pretrained(activation=name, stopped_early=True) for name in ACTIVATIONS},
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
        columns=COLUMNS,
        published=published_values(f"table_{number}", heading, COLUMNS),
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
    return reported(result, _DIAGNOSTICS)
