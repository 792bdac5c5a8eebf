"""Figures that can be drawn from any folder of results.

A figure is a function of a `FigureSource`; the first line of its docstring is its summary in
`bench list figures`. `bench figure`, the pages of studies and the report page read this list.
"""

from stiff_bench.figures import (
    calibration,
    learning_curves,
    losses,
    robot_picture,
    samples,
    springs,
    variants,
    workspace,
)
from stiff_bench.figures.figure_source import FigureSource
from stiff_bench.figures.prepared_figure import Figures

FIGURES: Figures[FigureSource] = {
    "scores": samples.mean_errors,
    "regression": samples.regression,
    "errors": samples.sample_errors,
    "losses": losses.loss_curves,
    "sweep": variants.sweep,
    "freezing": variants.freezing,
    "learning-curves": learning_curves.learning_curves,
    "workspace": workspace.workspace,
    "robot": robot_picture.robot,
    "springs": springs.springs,
    "what-bends": springs.what_bends,
    "calibration": calibration.calibration,
}
