"""`bench leaderboard`, `compare`, `table` and `report`: words in, one call, the result printed."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import click

from stiff_bench.cli.options import (
    FILE,
    RESULTS,
    FiniteRange,
    command_line,
    contest_options,
    debug_option,
    draws_seed_option,
    format_option,
    ranking_options,
    results_option,
)
from stiff_bench.console import print_text, say


@click.command()
@results_option
@ranking_options
@click.option(
    "--figure",
    type=FILE,
    default=None,
    metavar="FILE.png",
    help="Draw the critical-difference diagrams, too (.png, .pdf or .svg).",
)
@format_option("the tables")
@debug_option
def leaderboard(
    results: Path, metric: str, axis: str | None, figure: Path | None, fmt: str, **chosen: Any
) -> None:
    """Rank models over data sets and protocols, and say where ranks mean nothing."""
    from stiff_bench.analysis.leaderboard import stored_leaderboard
    from stiff_bench.analysis.leaderboard_tables import render_leaderboard
    from stiff_bench.analysis.sort_key import sort_key
    from stiff_bench.tables.picture_file import check_suffix

    if figure is not None:
        check_suffix(figure)
    board = stored_leaderboard(results, key=sort_key(metric, axis), **chosen)
    print_text(render_leaderboard(board, fmt, command_line()))
    if figure is not None:
        from stiff_bench.figures.ranks import save_diagrams

        first = board.sections[0]
        save_diagrams(first.analyses, f"{board.key.text} ({' and '.join(first.kinds)})", figure)


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
    rope_mm: float,
    confidence: float,
    seed: int,
    fmt: str,
    **asked: Any,
) -> None:
    """Say whether model A is better than model B, by how much, how sure that is, and where.

    A and B are models with their options, as `bench run` names them: vjm, ft-mlp@freeze=full.
    """
    from stiff_bench.analysis.comparison import compare_folder
    from stiff_bench.analysis.comparison_text import render_report
    from stiff_bench.analysis.verdict import Question
    from stiff_bench.tables.units import MM

    question = Question(rope=rope_mm / MM, confidence=confidence, seed=seed)
    report = compare_folder(results, a, b, question, **asked)
    print_text(render_report(report, fmt, command_line()))


@click.command()
@click.argument("number", type=click.Choice(["2", "3", "6", "7", "8", "9", "10"]), metavar="NUMBER")
@click.option(
    "--results",
    type=FILE,
    default=None,
    metavar="DIR",
    help="Folder of the results, as `bench reproduce` makes them; tables 2 and 3 need none.  "
    "[default: results/paper/runs]",
)
@format_option("the table")
@debug_option
def table(number: str, results: Path | None, fmt: str) -> None:
    """Print a table of the source paper beside ours: 2, 3, 6, 7, 8, 9 or 10.

    2: the VJM's errors on the samples it was fitted to; 3: identified joint stiffnesses; 6 and 7:
    errors on the simulated source by depth and by activation; 8: which layers are unfrozen; 9:
    last epoch against best epoch; 10: VJM, FT-MLP and DT-CNN.
    """
    from stiff_bench.paper.table import render_paper_table
    from stiff_bench.paper.tables import read_table

    print_text(render_paper_table(read_table(int(number), results), fmt, command_line()))


@click.command()
@click.option(
    "--results",
    "folders",
    type=FILE,
    multiple=True,
    default=(RESULTS,),
    show_default=str(RESULTS),
    metavar="DIR",
    help="Folder of results: the --output of `bench run`; may be repeated. Folders are not "
    "compared with each other.",
)
@click.option(
    "--output",
    type=FILE,
    required=True,
    metavar="FILE.html",
    help="The page; an older one is replaced.",
)
@ranking_options
@debug_option
def report(folders: tuple[Path, ...], output: Path, **chosen: Any) -> None:
    """Write all that results say as one HTML page that needs no network.

    Ranks, pairwise comparisons, figures, scores, failures, and where the results come from; its
    tables can be sorted and filtered in a browser.
    """
    from stiff_bench.report.report import write_report
    from stiff_bench.report.runs import Selection

    write_report(folders, Selection(**chosen), output, command_line())
    say(f"{output}: the page is written")
