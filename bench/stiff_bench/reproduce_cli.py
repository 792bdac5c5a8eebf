"""`bench reproduce`."""

from __future__ import annotations

from functools import partial
from pathlib import Path
from typing import Any

import click

from stiff_bench.cli_options import FILE, command_line, debug_option
from stiff_bench.cores import usable_cores
from stiff_bench.execution_options import begin_execution, execution_of, execution_options
from stiff_bench.messages import print_text, say


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

    from stiff_bench.forecast import forecast_line, render_forecast
    from stiff_bench.paper.leaderboard_page import write_leaderboard
    from stiff_bench.paper.paper_page import write_paper
    from stiff_bench.paper.reproduce import Study, forecast_of, run_study
    from stiff_bench.paper.study import leaderboard_study, paper_study
    from stiff_bench.registry import usable_registry
    from stiff_bench.run import say_old_failures
    from stiff_bench.store import ResultStore
    from stiff_bench.tally import tally
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
