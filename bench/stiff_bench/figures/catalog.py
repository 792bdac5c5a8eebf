"""The general figures: what any folder of results can be drawn as."""

from stiff_bench.figures import (
    calibration,
    learning_curves,
    losses,
    samples,
    scores,
    springs,
    variants,
)
from stiff_bench.figures.figure import Figures
from stiff_bench.figures.source import FigureSource

FIGURES: Figures[FigureSource] = {
    "scores": scores.gather,
    "regression": samples.regression,
    "errors": samples.sample_errors,
    "losses": losses.gather,
    "sweep": variants.sweep,
    "freezing": variants.freezing,
    "learning-curves": learning_curves.gather,
    "workspace": samples.workspace,
    "springs": springs.gather,
    "calibration": calibration.gather,
}
