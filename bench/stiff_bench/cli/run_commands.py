"""`bench run`, and what it and `bench reproduce` print of a run."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import click
from click.core import ParameterSource

from stiff_bench import api
from stiff_bench.api import RESULTS
from stiff_bench.cli.click_options import (
    FILE,
    WholeRange,
    command_line,
    coverage_option,
    data_options,
    device_option,
    execution_options,
    format_option,
    plugin_option,
    print_tables,
    seed_option,
    settings_option,
    several_keys,
)
from stiff_bench.cli.help_pages import command
from stiff_bench.console import print_text, say
from stiff_bench.tables.table import SCREEN
from stiff_protocols.contract.errors import ConfigError

HOW = ("jobs", "isolate", "timeout", "memory", "threads", "dask", "rerun")
"""Options that say how fits are computed."""
WITH_STUDY = {
    *(*HOW, "models", "output", "study", "lite", "against"),
    *("plugin", "fmt", "plan_only", "paper", "verbose"),
}
"""Options that can be combined with --study."""


@command(epilog="bench run --model vjm --model vjm-gp --dataset fanuc-r2000ic --splits 5")
@several_keys(
    "--model",
    "models",
    help="A model; KEY@OPTION=VALUE sets its options; 'all' for all models; may be repeated.",
)
@several_keys(
    "--dataset",
    "datasets",
    help="A data set, such as kr10-twin@specimen=3; may be repeated.  [default: kr10-twin]",
)
@several_keys(
    "--protocol",
    "protocols",
    default=("holdout",),
    help="A protocol, such as kfold@folds=10; may be repeated.",
)
@several_keys(
    "--metric",
    "metrics",
    help="A metric of `bench list metrics`; may be repeated.  [default: mae, stde, me; for tool "
    "paths: norm, norm-p95, norm-max, removed]",
)
@coverage_option("Coverage of prediction intervals, per axis.  [default: 0.9]")
@click.option(
    "--splits", type=WholeRange(1, 10_000), help="Number of splits.  [default: the protocol's]"
)
@seed_option
@settings_option
@data_options
@plugin_option
@device_option
@execution_options("1")
@click.option(
    "--output", type=FILE, default=RESULTS, metavar="DIR", help="Folder that stores the results."
)
@click.option(
    "--study",
    metavar="NAME",
    help="Run a study of `bench reproduce`, or a file such as my_study.toml; --model replaces its "
    "models.",
)
@click.option(
    "--lite", is_flag=True, help="Run the short version of the study: few robots, one split."
)
@click.option(
    "--against",
    default="",
    show_default=False,
    metavar="DIR",
    help="Also show results of other models; 'published': the results in the repository.",
)
@format_option
@click.option(
    "--paper", is_flag=True, help="On a terminal, print the source paper's table: MAE, STDE and ME."
)
@click.option(
    "--verbose",
    is_flag=True,
    help="Also print a table of each data set, and what fits report, such as stiffnesses.",
)
@click.pass_context
def run(
    ctx: click.Context,
    /,
    study: str | None,
    lite: bool,
    against: str,
    fmt: str,
    plan_only: bool,
    paper: bool,
    verbose: bool,
    models: tuple[str, ...],
    datasets: Sequence[str | api.data_sets.Dataset],
    protocols: tuple[str, ...],
    data: Sequence[api.data_sets.Dataset],
    **words: Any,
) -> int:
    """Fit and test models; print which is best, and how sure that is.

    A fit is one model, trained and tested on one split. The VJM is always included as the
    baseline. Results are saved in --output at once; the same command continues an interrupted run.
    """
    how, output = {name: words.pop(name) for name in HOW}, words.pop("output")
    if study is None:
        for word, value in (("lite", lite), ("against", against)):
            if value:
                raise ConfigError("requires --study", word)
        datasets = [*datasets, *data] or [api.evaluation.DEFAULT_DATASET]
        prepared_run = api.evaluation.prepare_run(
            models, datasets, protocols, how=how, output=output, command=command_line(), **words
        )
    else:
        for option in ctx.command.params:
            source = ctx.get_parameter_source(option.name or "")
            if option.name not in WITH_STUDY and source == ParameterSource.COMMANDLINE:
                raise ConfigError(
                    f"{option.opts[0]} cannot be combined with --study; set it in {study}"
                )
        prepared_run = api.evaluation.run_of_study(
            study,
            models=models,
            lite=lite,
            against=against,
            output=output,
            command=command_line(),
            **how,
        )
    if plan_only:
        return show_plan(prepared_run, fmt)
    answer = not paper and (bool(models) if study else not words["metrics"])
    return execute(prepared_run, fmt, answer=answer, verbose=verbose)


def execute(
    run: api.evaluation.Run, fmt: str, *, answer: bool = True, verbose: bool = False
) -> int:
    """Compute a run and print its tables; return 1 if a cell failed or was skipped, else 0.

    With `answer`, a terminal shows the best model in place of the metrics.
    """
    results = run.compute()
    if (board := run.board(results)) is not None:
        print_tables(board, fmt)
        say_summary(results)
    elif fmt == SCREEN and answer:
        ended, *more = summary(results)
        facts = [f"Fits: {ended.replace(';', ',')}", *more]
        print_text(results.screen(*facts, verbose=verbose), laid_out=True)
    else:
        print_tables(results.table(verbose=verbose), fmt)
        say_summary(results)
    return 0 if all(result.status == "ok" for result in results.every) else 1


def say_summary(results: api.pictures.Results) -> None:
    """Print on standard error how the fits ended, and where results are stored."""
    for line in summary(results):
        say(line)


def summary(results: api.pictures.Results) -> list[str]:
    """Return how the fits ended, where results are stored, and how to repeat old failures."""
    finished = results.finished
    assert finished is not None
    lines = [f"{finished.summary}; {finished.wall_s:.1f} s; stored in {results.folder}"]
    failed = [result.cell.key for result in finished.results if result.status == "failed"]
    if old := len(finished.cached.intersection(failed)):
        lines.append(f"{old} of the failures are of earlier runs; --rerun failed repeats them")
    return lines


def show_plan(run: api.evaluation.Run, fmt: str) -> int:
    """Print the fits that a run would compute, without computing them."""
    forecast = run.forecast()
    print_tables(replace(forecast, text=""), fmt)
    say(forecast.text)
    return 0


@command(epilog="bench reproduce paper-quick")
@click.argument("name")
@click.option(
    "--output",
    type=FILE,
    default=Path("results"),
    metavar="DIR",
    help="Folder to write to; the study gets a folder in it.",
)
@click.option("--write-only", is_flag=True, help="Compute nothing; write from stored results.")
@click.option(
    "--site",
    type=FILE,
    metavar="DIR",
    help="Also write the web pages of the study's leaderboard to this folder.",
)
@execution_options("the number of cores")
@format_option
def reproduce(
    name: str,
    output: Path,
    write_only: bool,
    site: Path | None,
    plan_only: bool,
    fmt: str,
    **how: Any,
) -> int:
    """Run a study and write its page.

    NAME is a file such as my_study.toml, or a study that stiffbench ships (times: on 2 cores):

    \b
    paper        tables and figures of the source paper; 1 h
    paper-quick  the same with one split and coarse sweeps; 7 min
    leaderboard  every model on 12 simulated robots and a measured one; 5 h
    intervals    do prediction intervals cover what they claim?

    Results are saved at once; the same command continues an interrupted study.
    """  # noqa: D301  # click keeps the lines below \b
    command = command_line(without="--site")  # the page of results is the same with web pages
    study_run = api.evaluation.reproduction(name, output=output, command=command, **how)
    if plan_only:
        return show_plan(study_run, fmt)
    status = 0
    if not write_only:
        results = study_run.compute()
        say_summary(results)
        say("writing tables and figures")
        status = int(any(result.status == "failed" for result in results.every))
    for path in study_run.write():
        print_text(str(path))
    if site is not None:
        say(f"writing web pages to {site}")
        *_, first_page = study_run.write_site(site)
        print_text(str(first_page))
    return status
