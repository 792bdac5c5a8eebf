"""The general figures, one line each: what any folder of results can be drawn as."""

from __future__ import annotations

from collections.abc import Mapping

from stiff_bench.figures import (
    freezing,
    learning_curves,
    losses,
    ranks,
    regression,
    sample_errors,
    springs,
    sweep,
    workspace,
)
from stiff_bench.figures.figure import FigureLine, by_name
from stiff_bench.figures.source import FigureSource

FIGURES: Mapping[str, FigureLine[FigureSource]] = by_name(
    (
        FigureLine("regression", "Measured against predicted", regression.gather),
        FigureLine("errors", "Error of every test sample", sample_errors.gather),
        FigureLine("losses", "Loss curves", losses.gather),
        FigureLine("sweep", "Error over depth and width of a network", sweep.gather),
        FigureLine("freezing", "Freeze strategies", freezing.gather),
        FigureLine("learning-curves", "Error over measured poses", learning_curves.gather),
        FigureLine("workspace", "Error over the workspace", workspace.gather),
        FigureLine("springs", "Torque and deflection of each joint", springs.gather),
        FigureLine("ranks", "Critical differences of mean ranks", ranks.gather),
    )
)
