"""The tables of the source paper that are made beside ours, by their numbers."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from pathlib import Path

from stiff_bench.figures.figure import FigureLine, Prepared, by_name
from stiff_bench.paper import figures
from stiff_bench.paper.method_table import table_10
from stiff_bench.paper.names import PAPER_RESULTS
from stiff_bench.paper.network_tables import table_6, table_7, table_8, table_9
from stiff_bench.paper.results import PaperResults, paper_results
from stiff_bench.paper.table import PaperTable
from stiff_bench.paper.vjm_tables import table_2, table_3
from stiff_protocols.contract.errors import ConfigError, unknown_name

_FITTED_HERE: Mapping[int, Callable[[], PaperTable]] = {2: table_2, 3: table_3}
_FROM_RESULTS: Mapping[int, Callable[[PaperResults], PaperTable]] = {
    6: table_6,
    7: table_7,
    8: table_8,
    9: table_9,
    10: table_10,
}
TABLES: Mapping[int, str] = {
    2: "errors of the VJM on the samples it was fitted to",
    3: "identified joint stiffnesses",
    6: "errors on the simulated source by number of hidden layers",
    7: "errors on the simulated source by activation",
    8: "which layers are unfrozen; ours alone",
    9: "last epoch against best epoch",
    10: "VJM, FT-MLP and DT-CNN",
}
"""Number -> what the table is about, in a few words."""
FITTED_HERE = frozenset(_FITTED_HERE)
"""Tables that need no stored results: a model is fitted in a second."""


def build(number: int, results: PaperResults | None) -> PaperTable:
    """Return a table of the paper beside ours.

    Args:
        number: of the table in the paper.
        results: that ours come from; None for a table of `FITTED_HERE`.

    Raises:
        ConfigError: the paper's table of that number is not made here.
        StoreError: the results have nothing of it.
    """
    if number in _FITTED_HERE:
        return _FITTED_HERE[number]()
    if number not in _FROM_RESULTS:
        raise unknown_name("table of the paper", str(number), map(str, TABLES))
    if results is None:
        raise ConfigError(f"table {number} needs results; `bench reproduce` makes them")
    return _FROM_RESULTS[number](results)


def read_table(number: int, folder: Path | None) -> PaperTable:
    """Return `build`'s table from the results of a folder; None: where `bench reproduce` puts them.

    Raises:
        ConfigError, StoreError: as `build`; a folder was named that is not read.
    """
    if number not in FITTED_HERE:
        return build(number, paper_results(folder or PAPER_RESULTS))
    _refuse_folder(folder, f"table {number}")
    return build(number, None)


def _refuse_folder(folder: Path | None, what: str) -> None:
    if folder is not None:
        raise ConfigError(f"--results {folder}: {what} is fitted here and reads none")


FIGURES: Mapping[str, FigureLine[PaperResults]] = by_name(
    (
        FigureLine("4", "Measured against VJM-fitted", figures.figure_4),
        FigureLine("5a", "MAE over nodes a layer", figures.figure_5a),
        FigureLine("5b", "STDE over nodes a layer", figures.figure_5b),
        FigureLine("5c", "Loss of the pre-training", figures.figure_5c),
        FigureLine("5", "Depth, width and pre-training of the network", figures.figure_5),
        FigureLine("6", "One unfrozen layer against two", figures.figure_6),
        FigureLine("8", "Measured against DT-CNN", figures.figure_8),
        FigureLine("9", "Measured against FT-MLP and VJM", figures.figure_9),
    )
)
_FITTED_FIGURE = "4"


def prepare_figure(name: str, folder: Path | None) -> Prepared:
    """Return one of the paper's figures from the results of a folder; None: as `read_table`.

    Raises:
        ConfigError: a folder was named that is not read.
        StoreError: the results have nothing of it.
    """
    if name != _FITTED_FIGURE:
        return FIGURES[name].prepare(paper_results(folder or PAPER_RESULTS))
    _refuse_folder(folder, f"figure {name}")
    return FIGURES[name].prepare(PaperResults(PAPER_RESULTS, ()))
