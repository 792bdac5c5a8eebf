"""`bench figure`."""

from __future__ import annotations

from collections.abc import Mapping
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from stiff_bench.cli.options import (
    FILE,
    RESULTS,
    begin_execution,
    command_line,
    contest_options,
    debug_option,
    execution_of,
    execution_options,
)
from stiff_bench.console import print_text, say
from stiff_bench.paper.study import PAPER_RESULTS
from stiff_bench.run.machine import usable_cores
from stiff_protocols.contract.errors import ConfigError, unknown_name

if TYPE_CHECKING:
    from stiff_bench.figures.figure import Prepared


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
    from stiff_bench.tables.picture_file import check_suffix

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
    from stiff_bench.paper import figures as paper_figures

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
    from stiff_bench.paper.figures import FIGURES
    from stiff_bench.paper.results import PaperResults

    if name != WITHOUT_RESULTS:
        return FIGURES[name].prepare(PaperResults.of(PAPER_RESULTS if folder is None else folder))
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
    from stiff_bench.figures.source import FigureSource

    return FIGURES[name].prepare(FigureSource.of(folder, models, datasets, protocols))


@click.command()
@click.argument("what", type=click.Choice(["paper", "leaderboard"]), default="paper")
@click.option(
    "--quick/--full",
    default=True,
    show_default=True,
    help="Of the paper: one split and coarse sweeps, about 7 minutes on 2 cores; or five splits, "
    "every width, depth and pair of layers, about an hour.",
)
@click.option(
    "--output",
    type=FILE,
    default=Path("results"),
    show_default=True,
    metavar="DIR",
    help="Where paper/, or leaderboard/ with leaderboard.md and leaderboard.csv beside it, are "
    "written.",
)
@click.option(
    "--write-only",
    is_flag=True,
    help="Compute nothing; write what the stored results are enough for.",
)
@partial(execution_options, usual_jobs="as many as there are cores")
@debug_option
@click.pass_context
def reproduce(
    context: click.Context, /, what: str, quick: bool, output: Path, write_only: bool, **words: Any
) -> int:
    """Run all that the paper's tables and figures need, or the committed leaderboard; write them.

    What is to be computed is said first, and how long that takes where stored fits tell. What is
    stored already is not computed again: stopped in any way, the same command goes on. By default
    as many cells run at once as there are cores. The leaderboard takes about 2 hours on 2 cores.
    """
    given = context.get_parameter_source("quick")
    if what == "leaderboard" and given is not click.core.ParameterSource.DEFAULT:
        raise click.UsageError("--quick and --full are of the paper; the leaderboard has one size")
    by_default = context.get_parameter_source("jobs") is click.core.ParameterSource.DEFAULT
    if by_default and not words["dask"] and words["isolate"] is not False:
        words["jobs"] = usable_cores()
    taken = begin_execution(words)

    from stiff_bench.analysis.forecast import forecast_line, render_forecast
    from stiff_bench.cli.run import say_old_failures
    from stiff_bench.paper.pages import write_leaderboard, write_paper
    from stiff_bench.paper.reproduce import Study, forecast_of, run_study
    from stiff_bench.paper.study import leaderboard_study, paper_study
    from stiff_bench.plan.registry import usable_registry
    from stiff_bench.run.runner import tally
    from stiff_bench.store.database import ResultStore
    from stiff_models.catalog import MODELS

    keys = [info.key for info in MODELS]
    runs = leaderboard_study(keys) if what == "leaderboard" else paper_study(full=not quick)
    registry, command = usable_registry(), command_line()
    study = Study.of(runs, output=output / what / "runs", command=command, registry=registry)
    execution = execution_of(taken, study.plans[0], registry)
    if taken["plan"]:
        foreseen = forecast_of(study, execution)
        print_text(render_forecast(foreseen, "github", command))
        say(forecast_line(foreseen))
        return 0
    write = write_leaderboard if what == "leaderboard" else write_paper
    if write_only:
        for path in write(output, command, study.n_missing()):
            click.echo(path)
        return 0
    store = ResultStore(study.output)  # a folder that cannot be written is said before all else
    say(forecast_line(forecast_of(study, execution)))
    finished = run_study(study, store, execution)
    say(f"{tally(finished.results, finished.cached)}; stored in {study.output}")
    say_old_failures(finished)
    say("writing tables and figures")
    for path in write(output, command, study.n_missing()):
        click.echo(path)
    return 0 if all(result.status != "failed" for result in finished.results) else 1
