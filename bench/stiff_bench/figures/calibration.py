"""Whether intervals hold as often as they promise."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from functools import partial
from itertools import chain

import numpy as np
import pandas as pd
from matplotlib.figure import Figure

from stiff_bench.figures.figure_source import FigureSource
from stiff_bench.figures.prepared_figure import Prepared
from stiff_bench.figures.style import COLUMN_INCH, REFERENCE_COLOR, looks, new_figure, short
from stiff_bench.store.names import grouped
from stiff_bench.tables.metric_table import pooled_prediction
from stiff_protocols.contract.record import CellResult
from stiff_protocols.scoring.metrics import METRICS

MOST_MODELS = 8
LEVELS = "0.5, 0.8, 0.9, 0.95"


def calibration_figure(held: pd.DataFrame) -> Figure:
    """Draw a line a model: a row is a nominal coverage, a column a model, both 0..1."""
    figure = new_figure(COLUMN_INCH, COLUMN_INCH)
    axes, found = figure.subplots(), 100.0 * held
    limits = min(held.index.min(), held.min(axis=None)) * 100.0 - 3.0, 101.0
    axes.axline((90.0, 90.0), slope=1.0, color=REFERENCE_COLOR, linewidth=0.8)
    for look, name in zip(looks(len(found.columns)), found.columns, strict=True):
        line = found[name].dropna()
        axes.plot(
            100.0 * line.index, line, marker=look.marker, label=short(name), **look.connected()
        )
    axes.set(xlabel="nominal coverage [%]", ylabel="test samples inside [%]")
    axes.set(xlim=limits, ylim=limits, aspect="equal")
    axes.legend(loc="upper left")
    return figure


def calibration(source: FigureSource) -> Prepared:
    """Show the share of test samples inside their intervals over the nominal coverage."""
    made_by = "`bench run --metric coverage` makes them"
    compared = source.compared(MOST_MODELS, _has_interval, "intervals", made_by)
    # of each split its competitors have the newest coverage alone, which other figures show
    each = filter(_has_interval, compared.case.every)
    of_split = grouped(each, _whatever_coverage)
    held = {}
    for name in compared.models:
        splits = compared.case.results(name, compared.slots)
        held[name] = _held([of_split[_whatever_coverage(one)] for one in splits])
    caption = (
        "Share of the test samples of all splits inside their intervals, mean of X, Y and Z, over "
        "the share that should be; on the diagonal the intervals hold, below it they are too "
        f"narrow. A point a coverage (`bench run --coverage`, such as {LEVELS}). {compared.setting}"
    )
    paint = partial(calibration_figure, pd.DataFrame(held))
    return Prepared("Coverage of the intervals", caption, paint, compared.subtitle)


def _held(splits: Sequence[Sequence[CellResult]]) -> pd.Series:
    """Return nominal coverage -> share inside, of those that every split has."""
    of_coverage = grouped(chain.from_iterable(splits), lambda one: one.cell.coverage or 0.0)
    shares = {
        coverage: np.mean([*METRICS["coverage"].values(pooled_prediction(results)).values()])
        for coverage, results in of_coverage.items()
        if len(results) == len(splits)
    }
    return pd.Series(shares).sort_index()


def _has_interval(result: CellResult) -> bool:
    return result.prediction is not None and result.prediction.interval is not None


def _whatever_coverage(result: CellResult) -> str:
    return replace(result.cell, coverage=None).key
