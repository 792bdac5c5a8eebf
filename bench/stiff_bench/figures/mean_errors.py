"""The mean error of each model, with its interval."""

from __future__ import annotations

from functools import partial
from typing import Any

import numpy as np
import pandas as pd
from matplotlib.figure import Figure

from stiff_bench.figures.figure_source import FigureSource
from stiff_bench.figures.prepared_figure import Prepared
from stiff_bench.figures.style import COLUMN_INCH, new_figure, short
from stiff_bench.store.database import read_data
from stiff_bench.tables.units import MM, percent
from stiff_protocols.scoring.bootstrap import pose_errors, resampled_means
from stiff_protocols.scoring.metrics import norm_errors
from stiff_protocols.scoring.paired import LEVEL

MOST_MODELS = 12
HEAD_INCH, ROW_INCH = 0.55, 0.17


def scores_figure(errors: pd.DataFrame) -> Figure:
    """Draw a row a model: columns "mean", "low" and "high", m, the best model first."""
    figure = new_figure(COLUMN_INCH, HEAD_INCH + ROW_INCH * len(errors))
    axes, found = figure.subplots(), errors * MM
    reach = [found["mean"] - found["low"], found["high"] - found["mean"]]
    look: dict[str, Any] = {"fmt": "o", "color": "black", "capsize": 2.0, "elinewidth": 0.8}
    axes.errorbar(found["mean"], range(len(found)), xerr=reach, **look)
    axes.set_yticks(range(len(found)), [short(name) for name in found.index])
    axes.invert_yaxis()
    axes.set(xlabel="mean 3-D error [mm]", xlim=(0.0, None))
    return figure


def mean_errors(source: FigureSource) -> Prepared:
    """Show the mean 3-D error of each model, with 95 % intervals over poses."""
    compared = source.compared(MOST_MODELS)
    pose_id = read_data(source.folder, compared.case.name.data_sha256).samples.pose_id
    tested = compared.tested
    errors_of = np.column_stack([norm_errors(one) for one in tested.values()])  # (n, m) m
    by_pose = pose_errors(pose_id[next(iter(tested.values())).rows], errors_of)
    low, high = np.quantile(resampled_means(by_pose), [LEVEL / 2, 1 - LEVEL / 2], axis=0)
    errors = pd.DataFrame({"mean": by_pose.mean, "low": low, "high": high}, index=[*tested])
    caption = (
        "Mean 3-D error of the test samples of all splits, the best model first; bars: "
        f"{percent(1 - LEVEL)} bootstrap intervals over poses, with the fitted models held fixed. "
        f"{compared.setting}"
    )
    paint = partial(scores_figure, errors.sort_values("mean", kind="stable"))
    return Prepared("Mean error by model", caption, paint, compared.subtitle)
