"""The general figures, one line each: what any folder of results can be drawn as."""

from __future__ import annotations

from collections.abc import Mapping

from stiff_bench.figures import learning_curves, losses, ranks, samples, springs, variants
from stiff_bench.figures.figure import FigureLine, by_name
from stiff_bench.figures.source import FigureSource

FIGURES: Mapping[str, FigureLine[FigureSource]] = by_name(
    (
        FigureLine("regression", "Measured against predicted", samples.regression),
        FigureLine("errors", "Error of every test sample", samples.sample_errors),
        FigureLine("losses", "Loss curves", losses.gather),
        FigureLine("sweep", "Error over depth and width of a network", variants.sweep),
        FigureLine("freezing", "Freeze strategies", variants.freezing),
        FigureLine("learning-curves", "Error over measured poses", learning_curves.gather),
        FigureLine("workspace", "Error over the workspace", samples.workspace),
        FigureLine("springs", "Torque and deflection of each joint", springs.gather),
        FigureLine("ranks", "Critical differences of mean ranks", ranks.gather),
    )
)
