"""Figures of results, and the source paper's tables and figures beside ours."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

from stiff_bench.analysis.selection import EVERYTHING
from stiff_bench.api import RESULTS
from stiff_bench.api.results import Results
from stiff_bench.api.tables import Tables
from stiff_bench.tables.picture_file import check_suffix as check_suffix
from stiff_protocols.contract.errors import ConfigError, unknown_name

if TYPE_CHECKING:
    from stiff_bench.figures.prepared_figure import Prepared


def figure(
    name: str,
    results: Results | Path | str | None = None,
) -> Prepared:
    """Return a figure with its caption; a notebook shows it, and `save("my.png")` writes it.

    Args:
        name: one of `list_figures`; numbers are the source paper's.
        results: that it shows, or their folder; None: where `bench run` stores them, and for the
            paper's figures `bench reproduce`. `Results.select` chooses among them; else a figure
            shows the models that it is clear with, of measured data, then of the data set with
            most models, then of the one that was asked for first.

    Raises:
        ConfigError: there is no such figure, or a name has no results.
        StoreError: the folder does not hold what it shows.
    """
    from stiff_bench.figures.figure_catalog import FIGURES
    from stiff_bench.figures.figure_source import FigureSource
    from stiff_bench.paper import paper_figures as papers

    folder = _folder(results)
    selection = results.selection if isinstance(results, Results) else EVERYTHING
    if name in FIGURES:
        return FIGURES[name](FigureSource.of(folder or RESULTS, selection))
    if name not in papers.FIGURES:
        raise unknown_name("figure", name, [*papers.FIGURES, *FIGURES])
    for kind, word in selection.options:
        raise ConfigError(f"{word}: the paper's figure {name} takes no choice", kind)
    return papers.prepare_figure(name, folder)


def paper_table(
    number: int | str, results: Results | Path | str | None = None, *, command: str = ""
) -> Tables:
    """Return a table of the source paper, beside ours where there are ours.

    Args:
        number: of the table in the paper, 1 to 10.
        results: of `bench reproduce`, or their folder; None: where it stores them.
        command: that made it, for the record.

    Raises:
        ConfigError: the paper has no table of that number, or it reads no results.
        StoreError: the results have nothing of it.
    """
    from stiff_bench.paper.paper_tables import read_table

    tables = read_table(str(number), _folder(results))
    made_by = command or f"stiffbench.paper_table({number})"
    return Tables(tables, made_by)


def _folder(results: Results | Path | str | None) -> Path | None:
    folder = results.folder if isinstance(results, Results) else results
    return None if folder is None else Path(folder)
