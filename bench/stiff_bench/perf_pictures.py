"""The pictures of `bench perf`: measured curves on logarithmic axes."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

from stiff_bench.grouped import grouped
from stiff_bench.perf_report import Curve
from stiff_bench.picture_file import save_figure

SIZE_INCH = (8.0, 5.6)
PREFIX = "performance_"
LONG_LABEL = 45  # characters; two such labels do not fit beside each other


def save_pictures(curves: Sequence[Curve], folder: Path) -> list[Path]:
    """Draw a picture of each name and return the files.

    Raises:
        StoreError: a file cannot be written.
    """
    by_picture = grouped(curves, lambda curve: curve.picture)
    return [_save(found, folder / f"{PREFIX}{name}.png") for name, found in by_picture.items()]


def _save(curves: Sequence[Curve], path: Path) -> Path:
    from matplotlib.figure import Figure
    from matplotlib.ticker import LogLocator

    figure = Figure(figsize=SIZE_INCH, layout="constrained")
    ax = figure.subplots()
    for curve in curves:
        style = {"linewidth": 2.2} if curve.ours else {"linewidth": 1.2, "linestyle": "--"}
        label = f"{curve.who}: {curve.note}" if curve.note else curve.who
        ax.plot(curve.x, curve.y, marker="o", markersize=3.5, label=label, **style)
    ax.set(xscale="log", yscale="log", xlabel=curves[0].x_label, ylabel=curves[0].y_label)
    ax.yaxis.set_minor_locator(LogLocator(subs="auto"))
    ax.grid(True, which="major", linewidth=0.6, color="0.8")
    ax.grid(True, which="minor", linewidth=0.3, color="0.9")
    ax.set_title(path.stem.removeprefix(PREFIX).replace("_", " "))
    longest = max(len(str(line.get_label())) for line in ax.get_lines())
    n_columns = 1 if longest > LONG_LABEL else 2
    figure.legend(loc="outside lower center", ncols=n_columns, frameon=False)
    save_figure(figure, path)
    return path
