"""Learning curves: error over the number of training poses."""

from __future__ import annotations

from collections.abc import Collection, Iterable, Mapping, Sequence
from dataclasses import replace
from functools import partial
from itertools import islice

import numpy as np
import pandas as pd
import seaborn
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.ticker import NullLocator
from scipy import stats

from stiff_bench.figures import style
from stiff_bench.figures.figure_source import (
    LEAST,
    MOST_PANELS,
    FigureSource,
    between,
    marks_in,
    mean_length,
    noise_floor,
    with_linear,
)
from stiff_bench.figures.prepared_figure import Prepared
from stiff_bench.figures.samples import draw_noise_floor, noise_note
from stiff_bench.results.load import Task
from stiff_bench.results.scored_task import family_of
from stiff_bench.store.names import grouped
from stiff_bench.tables.units import MM, counted
from stiff_models.model_catalog import REFERENCE_MODEL
from stiff_protocols.contract.errors import StoreError
from stiff_protocols.splits.sample_efficiency import condition_of

CONFIDENCE = 0.95
FEWEST_FOR_INTERVAL = 3
MOST_MODELS = 5
PANEL_INCH = 2.2
_NEEDS = (
    "learning curves; create them with `bench run --protocol sample-efficiency --model "
    f"{REFERENCE_MODEL} ...`"
)


def learning_figure(
    panels: Mapping[str, pd.DataFrame],
    names: Sequence[str],
    noise_floors: Mapping[str, float | None],
) -> Figure:
    """Draw errors against training poses, both logarithmic, a panel per type of robot.

    Args:
        panels: type of robot -> its `errors_of`.
        names: models, in the order of their colours.
        noise_floors: type of robot -> mean 3-D error of the instruments' noise, m; None: not
            known.
    """
    labels = style.short_names(names)
    n_columns, legend = style.legend_layout(
        labels.values(), len(panels), most=3, n_others=any(noise_floors.values())
    )
    figure, grid = style.new_panels(len(panels), PANEL_INCH, legend)
    for name, look in style.looks_of(names).items():
        grid[0].plot([], [], color=look.color, marker=look.marker, label=labels[name])
    for axes, (title, errors) in zip(grid, panels.items(), strict=True):
        axes.sharey(grid[0])
        _draw(axes, errors, names)
        draw_noise_floor(axes.axhline, noise_floors[title])
        axes.set_title(style.short(title), loc="left")
    style.label_left(grid, "mean 3-D error [mm]")
    style.name_panels(grid)
    style.share_legend(figure, grid, ncols=n_columns)
    return figure


def _draw(axes: Axes, errors: pd.DataFrame, names: Sequence[str]) -> None:
    # set first: seaborn then averages logarithms, which gives the geometric mean
    axes.set(xscale="log", yscale="log")
    lengths_mm = (errors.clip(lower=LEAST) * MM).melt(ignore_index=False).reset_index()
    about = {"x": "size", "y": "value", "hue": "model", "style": "model", "legend": False}
    band = {"errorbar": _interval, "err_kws": {"alpha": 0.15, "linewidth": 0.0}}
    seaborn.lineplot(lengths_mm, ax=axes, **about, **band, **style.seaborn_looks(names))
    axes.set(xlabel="training poses", ylabel="")
    axes.set_xticks(errors.columns, map(str, errors.columns))
    axes.xaxis.set_minor_locator(NullLocator())
    style.plain_numbers(axes.yaxis, style.FINE_STEPS)


def _interval(values: pd.Series) -> tuple[float, float]:
    """Return Student's interval of the mean; NaN of few values."""
    if len(values) < FEWEST_FOR_INTERVAL:
        return np.nan, np.nan
    low, high = stats.t.interval(CONFIDENCE, len(values) - 1, np.mean(values), stats.sem(values))
    return float(low), float(high)


def size_of(task: Task) -> int:
    """Return the number of training poses of a task; 0: its condition is not a size."""
    results = [result for name in task.models for result in task.results(name)]
    sizes: Iterable[int] = {result.n_poses for result in results} - {0}
    if not sizes:  # older results do not have the number; each pose has at least one row
        sizes = range(1, max((result.n_train for result in results), default=0) + 1)
    return next((size for size in sizes if condition_of(size) == task.name.condition), 0)


def errors_of(names: Sequence[str], tasks: Sequence[Task]) -> pd.DataFrame:
    """Return the mean error lengths [m] of models on the data sets of one robot type.

    Each row is a model and a data set with all draws of all sizes. Each column is a size.
    """
    rows = [
        (name, replace(task.name, condition=""), size_of(task), mean_length(results))
        for task in tasks
        for name in names
        if (results := task.complete_results(name))
    ]
    table = pd.DataFrame(rows, columns=["model", "data set", "size", "error"])
    sizes = pd.Index(sorted({size_of(task) for task in tasks}), name="size")
    by_size = table.pivot(index=["model", "data set"], columns="size", values="error")
    return by_size.reindex(columns=sizes).dropna()


def _shared(errors: pd.DataFrame, models: Sequence[str]) -> pd.DataFrame:
    """Return the models' errors on the data sets that all models with errors share."""
    selected_errors = errors[errors.index.isin(models, level="model")]
    n_models = selected_errors.groupby("data set").size()
    shared = n_models.index[n_models == len(selected_errors.index.unique("model"))]
    return selected_errors[selected_errors.index.isin(shared, level="data set")]


def learning_curves(source: FigureSource) -> Prepared:
    """Show the error over training poses (`sample-efficiency`).

    Models need all draws of all sizes on a data set to be drawn.
    """
    tasks = [task for task in source.newest if size_of(task)]
    if not tasks:
        raise StoreError(f"{source.folder}: no result of {_NEEDS}", "results")
    protocol = max(tasks, key=lambda task: task.newest_run).name.protocol
    of_protocol = [task for task in tasks if task.name.protocol == protocol]
    names = source.names(of_protocol)
    members = {
        f"{family} ({of_family[0].presentation.kind})": of_family
        for family, of_family in grouped(of_protocol, lambda task: family_of(task.name)).items()
    }
    families = {title: errors_of(names, of_family) for title, of_family in members.items()}
    models = names if source.models else _best(families.values())
    every = {title: _shared(errors, models) for title, errors in families.items()}
    every = {title: errors for title, errors in every.items() if len(errors)}
    panels = dict(islice(every.items(), MOST_PANELS))
    if not panels:
        raise StoreError(
            f"{source.folder}: no data set on which {', '.join(models) or 'any model'} "
            f"has all draws of all sizes of {protocol}; repeat the `bench run` command to continue",
            "results",
        )
    drawn = {name for errors in panels.values() for name in errors.index.unique("model")}
    drawn_models = [name for name in models if name in drawn]
    floors = {title: _noise_floor(members[title], drawn_models) for title in panels}
    hidden = [name for name in names if name not in drawn]
    hidden += [title for title in families if title not in panels]
    caption = _caption(panels, of_protocol, drawn) + noise_note(floors.values())
    if hidden:
        caption += f" Not shown: {', '.join(hidden)}."
    paint = partial(learning_figure, panels, drawn_models, floors)
    return Prepared("Error over training poses", caption, paint, protocol)


def _noise_floor(tasks: Sequence[Task], names: Sequence[str]) -> float | None:
    """Return the geometric mean of the tasks' noise floors, m; None: a noise floor is not known."""
    floors = []
    for task in tasks:
        complete = filter(None, map(task.complete_results, names))
        if (floor := noise_floor(next(complete, []))) is None:
            return None
        floors.append(floor)
    return float(np.exp(np.mean(np.log(floors))))


def _best(families: Iterable[pd.DataFrame]) -> list[str]:
    """Return the best models at the largest sizes, and the linear model.

    Only models with most data sets are compared.
    """
    tables = [errors for errors in families if len(errors)]
    if not tables:
        return []
    last = [np.log(errors.iloc[:, -1].clip(lower=LEAST)).groupby("model") for errors in tables]
    n_sets = pd.concat([group.size() for group in last], axis=1).sum(axis=1)
    mean = pd.concat([group.mean() for group in last], axis=1).mean(axis=1)
    return with_linear(list(mean[n_sets == n_sets.max()].sort_values().index), MOST_MODELS)


def _caption(
    panels: Mapping[str, pd.DataFrame], tasks: Sequence[Task], models: Collection[str]
) -> str:
    n_sets = ", ".join(
        f"{title}: {counted(len(errors.index.unique('data set')), 'data set')}"
        for title, errors in panels.items()
    )
    n_draws = between([len(task.splits) for task in tasks], "draw")
    seeds = ", ".join(str(seed) for seed in sorted({task.name.seed for task in tasks}))
    return (
        f"{tasks[0].name.protocol}: mean 3-D error on the same test poses, "
        f"{n_draws} per size and data set, seed {seeds}. Lines: geometric mean over data sets "
        f"({n_sets}); bands: its {CONFIDENCE:.0%} interval, from {FEWEST_FOR_INTERVAL} data sets "
        f"on.{marks_in(tasks, models)}"
    )
