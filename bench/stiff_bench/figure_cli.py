"""`bench figure`."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import TYPE_CHECKING

import click

from stiff_bench.cli_options import FILE, RESULTS, contest_options, debug_option
from stiff_bench.messages import print_text
from stiff_bench.paper.paper_results import PAPER_RESULTS, PaperResults, paper_results
from stiff_protocols.errors import ConfigError, unknown_name

if TYPE_CHECKING:
    from stiff_bench.figures.figure_line import Prepared

WITHOUT_RESULTS = "4"  # its model is fitted on the spot


@click.command()
@click.argument("name")
@click.option(
    "--results",
    type=FILE,
    default=None,
    metavar="DIR",
    help=f"Folder of the results.  [default: {PAPER_RESULTS} for the paper's figures, {RESULTS} "
    "for the others]",
)
@click.option(
    "--output",
    type=FILE,
    default=None,
    metavar="FILE.pdf",
    help="What to write: .png, .pdf or .svg.  [default: figure-NAME.png]",
)
@click.option(
    "--model",
    "models",
    multiple=True,
    metavar="KEY",
    help="A model, or a key that stands for all its variants; may be repeated; not for the paper's "
    "figures.  [default: depends on the figure; its caption says]",
)
@contest_options
@debug_option
def figure(
    name: str,
    results: Path | None,
    output: Path | None,
    models: tuple[str, ...],
    datasets: tuple[str, ...],
    protocols: tuple[str, ...],
) -> None:
    """Draw a figure and print its caption.

    NAME is one of the source paper's figures (4, 5a, 5b, 5c, 5, 6, 8, 9), or one that any results
    can be drawn as: regression, errors, losses, sweep, freezing, learning-curves, workspace,
    springs, ranks. Where results of several data sets or protocols could be drawn, a fair protocol
    comes first, then the one with most models; the caption says which.
    """
    from stiff_bench.picture_file import check_suffix

    is_papers = _is_papers(name)
    target = Path(f"figure-{name}.png") if output is None else output
    check_suffix(target)
    if is_papers:
        _refuse_choice({"--model": models, "--dataset": datasets, "--protocol": protocols}, name)
        prepared = _of_paper(name, results)
    else:
        folder = RESULTS if results is None else results
        prepared = _general(name, folder, models, datasets, protocols)
    prepared.save(target)
    print_text(f"{target}: {prepared.title}. {prepared.caption}")


def _is_papers(name: str) -> bool:
    """Say whether a figure is one of the paper's.

    Raises:
        ConfigError: there is none of that name.
    """
    from stiff_bench.figures import catalog
    from stiff_bench.paper import paper_figures

    known = [*paper_figures.FIGURES, *catalog.FIGURES]
    if name not in known:
        raise unknown_name("figure", name, known)
    return name in paper_figures.FIGURES


def _refuse_choice(chosen: Mapping[str, tuple[str, ...]], name: str) -> None:
    """See that nothing is chosen that the paper has chosen."""
    given = [option for option, words in chosen.items() if words]
    if given:
        raise ConfigError(
            f"{given[0]} {chosen[given[0]][0]}: the paper's figure {name} says what it shows "
            "(valid: --results, --output; `bench figure regression` and the like take a choice)"
        )


def _of_paper(name: str, folder: Path | None) -> Prepared:
    from stiff_bench.paper.paper_figures import FIGURES

    if name != WITHOUT_RESULTS:
        return FIGURES[name].prepare(paper_results(PAPER_RESULTS if folder is None else folder))
    if folder is not None:
        raise ConfigError(f"--results {folder}: figure {name} is fitted here and reads none")
    return FIGURES[name].prepare(PaperResults(PAPER_RESULTS, ()))


def _general(
    name: str,
    folder: Path,
    models: tuple[str, ...],
    datasets: tuple[str, ...],
    protocols: tuple[str, ...],
) -> Prepared:
    from stiff_bench.figures.catalog import FIGURES
    from stiff_bench.figures.figure_source import FigureSource

    return FIGURES[name].prepare(FigureSource.of(folder, models, datasets, protocols))
