"""Draw figures of results, and tables of the source paper."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

from stiff_bench.api import RESULTS
from stiff_bench.parameter_types import Bounds
from stiff_bench.results.results import Results
from stiff_bench.results.selection import EVERYTHING
from stiff_bench.tables.writers import Tables
from stiff_protocols.contract.errors import ConfigError, unknown_name

if TYPE_CHECKING:
    from stiff_bench.api.data_sets import Dataset
    from stiff_bench.api.model import Model
    from stiff_bench.figures.prepared_figure import Prepared


def figure(
    name: str,
    results: Results | Dataset | Path | str | None = None,
    *,
    model: Model | None = None,
    row: Annotated[int, Bounds(at_least=0)] | None = None,
) -> Prepared:
    """Return a figure with its caption; `save("my.png")` writes it.

    Args:
        name: name from `list_figures`; numbers are figures of the source paper.
        results: results or their folder; None: the default folder of `bench run`, or of
            `bench reproduce` for the paper's figures. Use `Results.select` to choose models and
            data sets. By default a figure shows as many models as fit, and a panel per data set:
            measured ones first, then in the order of the request. The figure "robot" also takes a
            data set.
        model: fitted model for the figure "robot", which draws its prediction; without `results`
            at a training pose.
        row: sample of the figure robot, from 0; by default the one with the largest deflection.

    Raises:
        ConfigError: the figure is unknown, or a name has no results.
        NotFittedError: the model is not fitted.
        StoreError: the folder does not have the results for the figure.
    """
    from stiff_bench.figures.figure_catalog import FIGURES
    from stiff_bench.figures.figure_source import FigureSource
    from stiff_bench.paper import paper_figures as papers

    if name not in FIGURES and name not in papers.FIGURES:
        raise unknown_name("figure", name, [*papers.FIGURES, *FIGURES])
    if name == "robot":
        return _robot_figure(results, model, row)
    if model is not None or row is not None or not isinstance(results, _STORED):
        raise ConfigError(f"{name}: only the figure robot draws a data set, a model or a row")
    folder = _folder(results)
    selection = results.selection if isinstance(results, Results) else EVERYTHING
    if name in FIGURES:
        return FIGURES[name](FigureSource.of(folder or RESULTS, selection))
    for kind, word in selection.options:
        raise ConfigError(f"{word}: not supported by the paper's figure {name}; leave it out", kind)
    return papers.prepare_figure(name, folder)


def _robot_figure(
    results: Results | Dataset | Path | str | None, model: Model | None, row: int | None
) -> Prepared:
    from stiff_bench.figures import robot_picture
    from stiff_bench.figures.figure_source import FigureSource

    chosen: dict[str, Any] = {"row": row}
    if model is not None:
        model.check_fitted()
        if results is None:
            if row is not None:
                raise ConfigError(f"{row}: a model has no rows; give a data set, too", "row")
            return robot_picture.model_picture(model.fitted, model.name)
        chosen |= {"model": model.fitted, "model_name": model.name}
    if isinstance(results, _STORED):
        selection = results.selection if isinstance(results, Results) else EVERYTHING
        source = FigureSource.of(_folder(results) or RESULTS, selection)
        return robot_picture.robot(source, **chosen)
    kind = results.choice.info.kind
    about = f"{results.name} ({kind})"
    return robot_picture.robot_picture(results.samples, results.robot, about, kind, **chosen)


def paper_table(
    number: int | str, results: Results | Path | str | None = None, *, command: str = ""
) -> Tables:
    """Print a table of the source paper with our numbers.

    The tables are:

        1   measured poses
        2   errors of the VJM on the samples it was fitted to
        3   identified joint stiffnesses
        4   poses of the simulated pre-training data
        5   wrenches of the simulated pre-training data
        6   errors on these data by depth
        7   errors on these data by activation
        8   unfrozen layers
        9   last epoch against best epoch
        10  VJM, FT-MLP and DT-CNN, scored in three ways

    Args:
        number: number of the table in the paper, 1 to 10.
        results: results of `bench reproduce`, or their folder; by default results/paper/runs.
        command: command that made the table.

    Raises:
        ConfigError: the number is unknown, or the table does not use results.
        StoreError: the results do not belong to the table.
    """
    from stiff_bench.paper.paper_tables import read_table

    tables = read_table(str(number), _folder(results))
    made_by = command or f"stiffbench.paper_table({number})"
    return Tables(tables, made_by)


_STORED = Results | Path | str | None


def _folder(results: Results | Path | str | None) -> Path | None:
    folder = results.folder if isinstance(results, Results) else results
    return None if folder is None else Path(folder)
