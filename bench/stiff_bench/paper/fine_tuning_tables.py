"""Tables 8 and 9: which layers move in fine-tuning, and which epoch's weights are kept."""

from __future__ import annotations

from stiff_bench.paper.model_columns import (
    OURS,
    PUBLISHED_DECIMALS,
    Outline,
    Values,
    Variants,
    model_table,
    published_values,
    reported,
)
from stiff_bench.paper.model_words import (
    ALL_PAIRS,
    ALL_SINGLES,
    FT_MLP,
    FT_MLP_LAST_EPOCH,
    unfrozen,
)
from stiff_bench.paper.paper_results import PaperResults
from stiff_bench.paper.paper_table import Labels, PaperTable
from stiff_bench.paper.recipe_words import fine_tuning_note
from stiff_bench.paper.shared_splits import FULL
from stiff_bench.units import MM
from stiff_protocols.errors import StoreError
from stiff_protocols.metrics import absolute_errors
from stiff_protocols.record import CellResult

COLUMNS = ("train MAE", "train STDE", "validation MAE", "validation STDE")
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
    models: dict[Labels, str] = {("1 layer", layers[0]): unfrozen(layers) for layers in ALL_SINGLES}
    models |= {("2 layers", " + ".join(layers)): unfrozen(layers) for layers in ALL_PAIRS}
    outline = Outline(
        number=8,
        caption="Unfrozen layers of the fine-tuned network",
        headings=("moving", "layers"),
        columns=COLUMNS,
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
    published = published_values("table_9", "training", COLUMNS)
    models = {ROWS_9["normal"]: FT_MLP_LAST_EPOCH, ROWS_9["optimized"]: FT_MLP}
    outline = Outline(
        number=9,
        caption="Fine-tuning of layers 1 + 2: last epoch and best epoch",
        headings=("training",),
        columns=COLUMNS,
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
