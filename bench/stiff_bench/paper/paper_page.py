"""Writes the paper's tables and figures beside ours, and a page that holds them all."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping, Sequence
from pathlib import Path

from stiff_bench.figures.catalog import FIGURES
from stiff_bench.figures.figure_line import Prepared, can_be_drawn
from stiff_bench.figures.figure_source import FigureSource
from stiff_bench.paper import paper_figures
from stiff_bench.paper.page_parts import figure_text, listed, not_made, pictures, written
from stiff_bench.paper.paper_results import PaperResults
from stiff_bench.paper.paper_table_text import render_paper_table
from stiff_bench.paper.paper_tables import TABLES, build
from stiff_bench.paper.provenance_text import provenance_lines
from stiff_protocols.errors import StiffBenchError

TABLE_FILES = {"github": "md", "csv": "csv", "latex": "tex"}
LEFT_OUT = {
    "5": "its three panels are drawn one by one",
    "learning-curves": "of the leaderboard",
    "ranks": "of the leaderboard",
}
"""Figures that belong on no page of the paper, and why."""


def write_paper(output: Path, command: str, n_missing: int) -> Iterator[Path]:
    """Write the paper's tables and figures beside ours, and yield each file.

    What cannot be made of the results is named on the page, with the reason.

    Args:
        output: PAPER = OUTPUT/paper holds the results in PAPER/runs, and gets PAPER/tables,
            PAPER/figures and PAPER/README.md.
        command: that made them.
        n_missing: how many of the study's cells are not stored.

    Raises:
        StoreError: a file cannot be written, or a stored one is damaged.
    """
    folder = output / "paper"
    results = PaperResults.of(folder / "runs")
    tables, missing = [], {}
    for number in TABLES:
        try:
            table = build(number, results)
        except StiffBenchError as error:
            missing[f"Table {number}"] = str(error)
            continue
        again = f"bench table {number}"
        for fmt, suffix in TABLE_FILES.items():
            path = folder / "tables" / f"table_{number}.{suffix}"
            yield written(path, render_paper_table(table, fmt, f"{again} --format {fmt}"))
        tables.append(render_paper_table(table, "github", again))
    figures, not_drawn = _figures(results)
    missing |= not_drawn
    yield from pictures(figures, folder / "figures")
    page = _page(tables, figures, missing, provenance_lines(folder / "runs", command, n_missing))
    yield written(folder / "README.md", page)


def _figures(results: PaperResults) -> tuple[list[Prepared], dict[str, str]]:
    """Return the paper's figures and the general ones, and why some cannot be drawn."""
    of_paper = {name: one for name, one in paper_figures.FIGURES.items() if name not in LEFT_OUT}
    general = {name: one for name, one in FIGURES.items() if name not in LEFT_OUT}
    drawn, missing = can_be_drawn(of_paper, results)
    others, also = can_be_drawn(general, FigureSource(results.folder, results.contests))
    return [*drawn, *others], {f"Figure {name}": why for name, why in (missing | also).items()}


def _page(
    tables: Sequence[str],
    figures: Sequence[Prepared],
    missing: Mapping[str, str],
    provenance: Iterable[str],
) -> str:
    parts = [
        "# The source paper's tables and figures, published and ours",
        "Published numbers are of a measured KUKA KR10 R1100-2; ours are of `kr10-twin`, a "
        "simulation of it. Compare methods within one source, never the two in absolute terms.",
        listed(provenance),
        "## Tables",
        *tables,
        "## Figures",
        *(figure_text(figure, "figures") for figure in figures),
    ]
    if missing:
        parts += ["## Not made", listed(not_made(missing))]
    return "\n\n".join(parts)
