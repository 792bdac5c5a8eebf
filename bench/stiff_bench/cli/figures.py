"""`bench figure` and `bench reproduce`."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import click

from stiff_bench.cli.options import (
    FILE,
    RESULTS,
    case_options,
    command_line,
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
    metavar="DIR",
    help=f"Folder of results.  [default: {RESULTS}; {PAPER_RESULTS} for the paper's figures]",
)
@click.option(
    "--output",
    type=FILE,
    metavar="FILE.pdf",
    help="File to write: .png, .pdf or .svg.  [default: figure-NAME.png]",
)
@models_option
@case_options
def figure(name: str, results: Path | None, output: Path | None, **chosen: Any) -> None:
    """Draw a figure and print its caption.

    NAME is a figure of the source paper (4, 5, 6, 8, 9) or a general one: scores, regression,
    errors, losses, sweep, freezing, learning-curves, workspace, springs, ranks. The caption names
    the data set and protocol that are shown.
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
                    f"--{option[:-1]} {words[0]}: the paper's figure {name} takes no choice "
                    "(valid: --results, --output)"
                )
        prepared = papers.prepare_figure(name, results)
    else:
        prepared = catalog.FIGURES[name].prepare(FigureSource.of(results or RESULTS, **chosen))
    prepared.save(target)
    print_text(f"{target}: {prepared.title}. {prepared.caption}")


@click.command()
@click.argument(
    "what",
    type=click.Choice(["paper", "leaderboard", "effects"]),
    default="paper",
    metavar="[WHAT]",
)
@click.option(
    "--quick/--full",
    default=None,
    help="Size of the paper's study. Quick: one split and coarse sweeps, about 7 minutes on 2 "
    "cores. Full: five splits, every width, depth and pair of layers, about an hour.  "
    "[default: quick]",
)
@click.option(
    "--output",
    type=FILE,
    default=Path("results"),
    metavar="DIR",
    help="Folder that takes paper/, leaderboard/ or effects/.",
)
@click.option("--write-only", is_flag=True, help="Write from stored results alone.")
@execution_options("the number of cores")
def reproduce(
    what: str, quick: bool | None, output: Path, write_only: bool, plan_only: bool, **how: Any
) -> int:
    """Make the paper's tables and figures again, or another study.

    WHAT is paper (the default), leaderboard, or effects: does the ranking of the models depend on
    the physics of the simulated robot? Stored results are not computed again: an interrupted
    command can be repeated. On 2 cores the leaderboard takes about 2 hours, effects half an hour.
    """
    from stiff_bench.analysis.forecast import forecast_line
    from stiff_bench.api.evaluation import computed
    from stiff_bench.cli.run import foreseen, say_summary, show_plan
    from stiff_bench.paper import study
    from stiff_bench.paper.effects import write_effects
    from stiff_bench.paper.pages import write_leaderboard, write_paper
    from stiff_bench.plan.registry import build_registry
    from stiff_bench.run.execution import chosen_execution
    from stiff_bench.store.database import ResultStore
    from stiff_models.catalog import MODELS

    if what != "paper" and quick is not None:
        raise click.UsageError(f"--quick and --full are of the paper; {what} has one size")
    if what == "leaderboard":
        write, runs = write_leaderboard, study.leaderboard_study([info.key for info in MODELS])
    elif what == study.EFFECTS_FOLDER:
        write, runs = write_effects, study.effects_study()
    else:
        write, runs = write_paper, study.paper_study(full=quick is False)
    if how["jobs"] is None and not how["dask"] and how["isolate"] is not False:
        how["jobs"] = usable_cores()
    folder, registry, command = output / what / "runs", build_registry(), command_line()
    plans = study.study_plans(runs, output=folder, command=command, registry=registry)
    execution = chosen_execution(plans[0], registry, **how)
    if plan_only:
        return show_plan(plans, "github", execution)
    status = 0
    if not write_only:
        ResultStore(folder)  # a folder that cannot be written is said before all else
        say(forecast_line(foreseen(plans, execution)))
        finished = computed(plans, execution)
        say_summary(finished, folder)
        say("writing tables and figures")
        status = int(any(result.status == "failed" for result in finished.results))
    for path in write(output, command, study.n_missing(plans)):
        click.echo(path)
    return status
