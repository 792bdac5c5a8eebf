"""Coverage of intervals: the share of test samples inside them."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import replace
from functools import partial
from itertools import chain
from typing import Any

import numpy as np
import pandas as pd
from matplotlib.figure import Figure

from stiff_bench.figures import style
from stiff_bench.figures.figure_source import Compared, FigureSource, data_text, subtitle
from stiff_bench.figures.prepared_figure import Prepared
from stiff_bench.results.fit_values import pooled_prediction
from stiff_bench.store.database import read_data
from stiff_bench.store.names import grouped
from stiff_bench.tables.units import percent
from stiff_protocols.contract.record import FitResult
from stiff_protocols.contract.types import BoolArray, TextArray
from stiff_protocols.scoring.bootstrap import pose_errors, resampled_means
from stiff_protocols.scoring.paired import LEVEL

MOST_MODELS, MOST_ROWS = 5, 12
LEVELS = "0.5, 0.8, 0.9, 0.95"
MODEL_INCH, GAP_INCH, FRAME_INCH = 0.09, 0.1, 0.5


def calibration_figure(shares: pd.DataFrame) -> Figure:
    """Draw a row per data set and a panel per nominal coverage.

    Columns: "data", "model", "nominal", and "share", "low" and "high" of the samples inside, all
    shares 0..1.
    """
    rows, names = shares["data"].unique(), shares["model"].unique()
    nominal = sorted(shares["nominal"].unique())
    labels = style.short_names(names)
    n_columns, legend = style.legend_layout(labels.values(), len(nominal), most=5, n_others=1)
    row_inch = FRAME_INCH + len(rows) * (GAP_INCH + MODEL_INCH * len(names))
    figure, panels = style.new_panels(len(nominal), row_inch, legend)
    place = {name: number for number, name in enumerate(rows)}
    offsets = np.linspace(-0.3, 0.3, len(names)) if len(names) > 1 else [0.0]
    for axes, level in zip(panels, nominal, strict=True):
        of_level = shares[shares["nominal"] == level]
        line: dict[str, Any] = {"color": style.REFERENCE_COLOR, "linestyle": "--", "linewidth": 0.9}
        axes.axvline(100.0 * level, **line, label="nominal")
        for (name, look), offset in zip(style.looks_of(names).items(), offsets, strict=True):
            of_model = of_level[of_level["model"] == name]
            share, low, high = (100.0 * of_model[key] for key in ("share", "low", "high"))
            height = [place[data] + offset for data in of_model["data"]]
            dots: dict[str, Any] = look.points() | {"capsize": 1.5, "elinewidth": 0.8}
            reach = [share - low, high - share]
            axes.errorbar(share, height, xerr=reach, **dots, label=labels[name])
        if len(nominal) > 1:
            axes.set_title(f"{percent(level)} intervals", loc="left")
        axes.set_yticks(range(len(rows)), style.short_names(rows).values())
        axes.grid(visible=False, axis="y")
        axes.set(xlabel="test samples inside [%]", ylim=(len(rows) - 0.5, -0.5))
        axes.set_xlim(right=101.0)
        axes.locator_params(axis="x", nbins=6)
    style.label_left(panels)
    style.name_panels(panels)
    style.share_legend(figure, panels, ncols=n_columns)
    return figure


def calibration(source: FigureSource) -> Prepared:
    """Show the share of test samples inside their intervals, a row per data set."""
    made_by = "create them with `bench run --metric coverage`"
    panels = source.panels(MOST_MODELS, _has_interval, "intervals", made_by, most_panels=MOST_ROWS)
    text = data_text if panels.condition else subtitle
    rows = [
        {"data": text(compared.task), "model": name, **share}
        for compared in panels.compared
        for name in compared.models
        for share in _shares(source, compared, name)
    ]
    caption = (
        "Share of the test samples of all splits inside their intervals, mean of X, Y and Z; bars: "
        f"{percent(1 - LEVEL)} bootstrap intervals over poses. Left of the dashed line intervals "
        f"are too narrow. For other intervals, use `bench run --coverage`, such as {LEVELS}. "
        f"{panels.setting}"
    )
    paint = partial(calibration_figure, pd.DataFrame(rows))
    return Prepared("Coverage of the intervals", caption, paint, panels.condition)


def _shares(source: FigureSource, compared: Compared, name: str) -> Iterator[dict[str, float]]:
    """Yield the share inside, with interval, per coverage of all splits."""
    # the models of the task hold only the newest coverage of each split
    with_interval = filter(_has_interval, compared.task.every)
    of_split = grouped(with_interval, _key_without_coverage)
    results = compared.task.results(name, compared.splits)
    splits = [of_split[_key_without_coverage(result)] for result in results]
    every = chain.from_iterable(splits)
    of_coverage = grouped(every, lambda result: result.fit.coverage or 0.0)
    pose_id = read_data(source.folder, compared.task.name.data_sha256).samples.pose_id
    for coverage, members in of_coverage.items():
        if len(members) == len(splits):
            yield {"nominal": coverage, **_share_inside(members, pose_id)}


def _share_inside(results: Sequence[FitResult], pose_id: TextArray) -> dict[str, float]:
    """Return the share of samples inside, with its interval over poses."""
    tested = pooled_prediction(results)
    assert tested.interval is not None  # each result has an interval
    low, high = tested.interval.lower, tested.interval.upper
    inside: BoolArray = (low <= tested.measured) & (tested.measured <= high)  # (n, 3)
    by_pose = pose_errors(pose_id, inside.mean(axis=1, keepdims=True), tested.rows)
    means = resampled_means(by_pose)[:, 0]
    share = float(by_pose.mean[0])
    bounds = np.quantile(means, [LEVEL / 2, 1 - LEVEL / 2])
    return {"share": share, "low": float(bounds[0]), "high": float(bounds[1])}


def _has_interval(result: FitResult) -> bool:
    return result.prediction is not None and result.prediction.interval is not None


def _key_without_coverage(result: FitResult) -> str:
    return replace(result.fit, coverage=None).key
