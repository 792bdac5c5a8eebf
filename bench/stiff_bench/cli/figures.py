"""`bench figure` and `bench reproduce`."""

from __future__ import annotations

from functools import partial
from pathlib import Path
from typing import Any

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
    models_option,
)
from stiff_bench.console import print_text, say
from stiff_bench.paper import PAPER_RESULTS
from stiff_bench.run.machine import usable_cores
from stiff_protocols.contract.errors import ConfigError, unknown_name


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
@models_option("Not for the paper's figures.  [default: depends on the figure; its caption says]")
@contest_options
@debug_option
def figure(name: str, results: Path | None, output: Path | None, **chosen: Any) -> None:
    """Draw a figure and print its caption.

    NAME is one of the source paper's figures (4, 5, 6, 8, 9), or one that any results
    can be drawn as: regression, errors, losses, sweep, freezing, learning-curves, workspace,
    springs, ranks. Where results of several data sets or protocols could be drawn, a fair protocol
    comes first, then the one with most models; the caption says which.
    """
    from stiff_bench.figures import catalog
    from stiff_bench.figures.source import FigureSource
    from stiff_bench.paper import figures as papers
    from stiff_bench.tables.picture_file import check_suffix

    known = [*papers.FIGURES, *catalog.FIGURES]
    if name not in known:
        raise unknown_name("figure", name, known)
    target = output or Path(f"figure-{name}.png")
    check_suffix(target)
    if name in papers.FIGURES:
        for option, words in chosen.items():
            if words:
                raise ConfigError(
                    f"--{option[:-1]} {words[0]}: the paper's figure {name} says what it shows "
                    "(valid: --results, --output; `bench figure regression` and the like take a "
                    "choice)"
                )
        prepared = papers.prepare_figure(name, results)
    else:
        prepared = catalog.FIGURES[name].prepare(FigureSource.of(results or RESULTS, **chosen))
    prepared.save(target)
    print_text(f"{target}: {prepared.title}. {prepared.caption}")


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

    from stiff_bench.analysis.forecast import forecast_line
    from stiff_bench.cli.run import computed, foreseen, say_old_failures, show_plan
    from stiff_bench.paper import study
    from stiff_bench.paper.pages import write_leaderboard, write_paper
    from stiff_bench.plan.registry import usable_registry
    from stiff_bench.run.runner import tally
    from stiff_bench.store.database import ResultStore
    from stiff_models.catalog import MODELS

    if what == "leaderboard":
        write, runs = write_leaderboard, study.leaderboard_study([info.key for info in MODELS])
    else:
        write, runs = write_paper, study.paper_study(full=not quick)
    folder, registry, command = output / what / "runs", usable_registry(), command_line()
    plans = study.study_plans(runs, output=folder, command=command, registry=registry)
    execution = execution_of(taken, plans[0], registry)
    if taken["plan"]:
        return show_plan(plans, "github", execution)
    status = 0
    if not write_only:
        ResultStore(folder)  # a folder that cannot be written is said before all else
        say(forecast_line(foreseen(plans, execution)))
        finished = computed(plans, execution)
        say(f"{tally(finished.results, finished.cached)}; stored in {folder}")
        say_old_failures(finished)
        say("writing tables and figures")
        status = int(any(result.status == "failed" for result in finished.results))
    for path in write(output, command, study.n_missing(plans)):
        click.echo(path)
    return status
