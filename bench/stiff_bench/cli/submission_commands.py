"""`bench submit` and `bench verify`: a way for others into the leaderboard."""

from __future__ import annotations

import secrets
import sys
from pathlib import Path
from typing import Any

import click

from stiff_bench import api
from stiff_bench.api import RESULTS
from stiff_bench.cli.click_options import (
    FILE,
    FiniteRange,
    Fraction,
    Size,
    WholeRange,
    command_line,
    output_option,
    together,
)
from stiff_bench.cli.help_pages import command
from stiff_bench.console import print_text, printable, say, wrapped
from stiff_bench.run.machine import pinned
from stiff_bench.tables.units import counted
from stiff_protocols.contract.errors import ConfigError

REFUSED = 1
INDENTS = "  ", 16 * " "
"""Before the first and the other lines of a check on a terminal."""
study_option = click.option(
    "--study", default="leaderboard", metavar="NAME", help="Study, or a file such as my_study.toml."
)
limit_options = together(
    click.option("--jobs", type=WholeRange(1, 1024), default=1, help="Number of parallel fits."),
    click.option(
        "--timeout",
        type=FiniteRange(0, 1e7, min_open=True),
        default=600.0,
        metavar="SECONDS",
        help="Time limit of each fit.",
    ),
    click.option(
        "--memory", type=Size(), default="4GiB", metavar="SIZE", help="Memory limit of each fit."
    ),
)


@command(epilog="bench submit --lite --card card.toml --output submission")
@click.option(
    "--lite/--full",
    default=None,
    help="Fits of the short version of the study (four robots), or of all of it.  [required]",
)
@click.option(
    "--card",
    type=FILE,
    required=True,
    metavar="FILE.toml",
    help="Card of the model: plugin file, authors, licence, reference ...",
)
@study_option
@click.option(
    "--results",
    type=FILE,
    default=RESULTS,
    metavar="DIR",
    help="Folder of results: fits that it holds are not computed again.",
)
@limit_options
@output_option("DIR", "New folder for the submission.")
def submit(
    lite: bool | None,
    card: Path,
    study: str,
    results: Path,
    output: Path,
    **how: Any,
) -> None:
    """Write a submission to the leaderboard.

    The missing fits are computed first. The folder holds the card, the code, a record per fit with
    its predictions, the environment, and a manifest with hashes.
    """
    if lite is None:
        raise ConfigError("give --lite or --full")
    submission = api.submissions.submit(
        card,
        output,
        scope="lite" if lite else "full",
        results=results,
        study=study,
        command=command_line(),
        threads=pinned(),
        **how,
    )
    n_records = counted(len(submission.records), "record")
    say(f"{output}: {submission.manifest.model}, {n_records} written; next: bench verify {output}")


@command(epilog="bench verify results/submissions/quadratic-springs")
@click.argument("folders", metavar="DIR...", type=FILE, nargs=-1, required=True)
@study_option
@click.option(
    "--seed",
    type=WholeRange(0, 2**32),
    help="Seed of the choice of fits that are computed again.  [default: random, printed]",
)
@click.option(
    "--share",
    type=Fraction(0, 1, min_open=True),
    default=0.1,
    help="Share of the fits that are computed again, at least two.",
)
@limit_options
@click.option(
    "--write",
    is_flag=True,
    help="Store the outcome in the folder, for the leaderboard's column of status.",
)
def verify(
    folders: tuple[Path, ...],
    study: str,
    seed: int | None,
    share: float,
    timeout: float,
    memory: int,
    jobs: int,
    write: bool,
) -> int:
    """Verify submissions to the leaderboard.

    Hashes, schema, data and splits are checked, metrics are recomputed from the predictions, and a
    random tenth of the fits is computed again from the code, in isolated processes.

    Exit status: 0 nothing is wrong; 1 a submission is refused; 2 it cannot be read.
    """
    seed = secrets.randbelow(2**31) if seed is None else seed
    refits = api.submissions.Refits(seed, share, timeout, memory, jobs)
    outcomes = set()
    for folder in folders:
        verification = api.submissions.VerificationRun(folder, study, refits)
        for number, check in enumerate(verification):
            if not number:
                print_text(str(folder))
            on_terminal = sys.stdout.isatty()
            print_text(wrapped(printable(str(check)), *INDENTS) if on_terminal else f"  {check}")
        print_text(f"{verification.outcome}: {folder}")
        outcomes.add(verification.outcome)
        if write and verification.outcome != "refused":
            verification.write()
    return REFUSED if "refused" in outcomes else 0
