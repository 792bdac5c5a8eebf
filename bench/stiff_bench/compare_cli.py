"""The `bench compare` command: words in, one function of `compare` called."""

from __future__ import annotations

from pathlib import Path

import click

from stiff_bench.cli_options import (
    FiniteRange,
    command_line,
    contest_options,
    debug_option,
    draws_seed_option,
    format_option,
    results_option,
)
from stiff_bench.messages import print_text


@click.command()
@click.argument("a", metavar="A")
@click.argument("b", metavar="B")
@results_option
@contest_options
@click.option(
    "--condition",
    "conditions",
    multiple=True,
    metavar="TEXT",
    help='A condition of a protocol, as the report names it ("n = 40"); may be repeated.  '
    "[default: all]",
)
@click.option(
    "--rope",
    "rope_mm",
    type=FiniteRange(min=0),
    default=0.01,
    show_default=True,
    metavar="MM",
    help="Largest difference in mean error that makes none in practice.",
)
@click.option(
    "--confidence",
    type=FiniteRange(0, 1, min_open=True, max_open=True),
    default=0.95,
    show_default=True,
    help="Of intervals and verdicts.",
)
@draws_seed_option
@format_option("the report")
@debug_option
def compare(
    a: str,
    b: str,
    results: Path,
    datasets: tuple[str, ...],
    protocols: tuple[str, ...],
    conditions: tuple[str, ...],
    rope_mm: float,
    confidence: float,
    seed: int,
    fmt: str,
) -> None:
    """Say whether model A is better than model B, by how much, how sure that is, and where.

    A and B are models with their options, as `bench run` names them: vjm, ft-mlp@freeze=full.
    """
    from stiff_bench.compare import CompareWords, compare_folder
    from stiff_bench.comparison_text import render_report
    from stiff_bench.estimates import Question
    from stiff_bench.units import MM

    words = CompareWords(
        a=a,
        b=b,
        results=results,
        datasets=datasets,
        protocols=protocols,
        conditions=conditions,
        question=Question(rope=rope_mm / MM, confidence=confidence, seed=seed),
        command=command_line(),
    )
    print_text(render_report(compare_folder(words), fmt))
