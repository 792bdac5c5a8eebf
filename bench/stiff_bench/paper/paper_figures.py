"""The source paper's figures, made again: one line each."""

from __future__ import annotations

from collections.abc import Mapping

from stiff_bench.figures.figure_line import FigureLine, by_name
from stiff_bench.paper import freezing_figure, network_figures, regression_figures
from stiff_bench.paper.paper_results import PaperResults

FIGURES: Mapping[str, FigureLine[PaperResults]] = by_name(
    (
        FigureLine("4", "Measured against VJM-fitted", regression_figures.figure_4),
        FigureLine("5a", "MAE over nodes a layer", network_figures.figure_5a),
        FigureLine("5b", "STDE over nodes a layer", network_figures.figure_5b),
        FigureLine("5c", "Loss of the pre-training", network_figures.figure_5c),
        FigureLine("5", "Depth, width and pre-training of the network", network_figures.figure_5),
        FigureLine("6", "One unfrozen layer against two", freezing_figure.figure_6),
        FigureLine("8", "Measured against DT-CNN", regression_figures.figure_8),
        FigureLine("9", "Measured against FT-MLP and VJM", regression_figures.figure_9),
    )
)
