"""The general figures, one line each: what any folder of results can be drawn as."""

from __future__ import annotations

from collections.abc import Mapping

from stiff_bench.figures import (
    calibration,
    learning_curves,
    losses,
    ranks,
    samples,
    scores,
    springs,
    variants,
)
from stiff_bench.figures.figure import FigureLine
from stiff_bench.figures.source import FigureSource

_LINES = (
    FigureLine("scores", "Mean error by model", scores.gather),
    FigureLine("regression", "Predicted against true deflection", samples.regression),
    FigureLine("errors", "Error of every test sample", samples.sample_errors),
    FigureLine("losses", "Loss curves", losses.gather),
    FigureLine("sweep", "Error over depth and width of a network", variants.sweep),
    FigureLine("freezing", "Freeze strategies", variants.freezing),
    FigureLine("learning-curves", "Error over training poses", learning_curves.gather),
    FigureLine("workspace", "Error over the workspace", samples.workspace),
    FigureLine("springs", "Torque and deflection of each joint", springs.gather),
    FigureLine("calibration", "Coverage of the intervals", calibration.gather),
    FigureLine("ranks", "Critical differences of mean ranks", ranks.gather),
)
FIGURES: Mapping[str, FigureLine[FigureSource]] = {line.name: line for line in _LINES}
