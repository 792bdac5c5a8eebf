"""Writes what a study is run for: tables, figures, and a page that holds them all."""

from __future__ import annotations

import re
from collections.abc import Iterable, Iterator, Sequence
from pathlib import Path

from stiff_bench.figures.catalog import available
from stiff_bench.figures.figure_line import Prepared
from stiff_bench.figures.figure_source import FigureSource
from stiff_bench.leaderboard_tables import render_leaderboard
from stiff_bench.paper.paper_figures import available as papers_available
from stiff_bench.paper.paper_results import PaperResults
from stiff_bench.paper.paper_table_text import render_paper_table
from stiff_bench.paper.paper_tables import TABLES, build
from stiff_bench.paper.provenance_text import provenance_lines
from stiff_bench.paper.study import NETWORK_STEPS
from stiff_bench.render import markdown_text
from stiff_bench.sort_key import sort_key
from stiff_bench.stored_leaderboard import stored_leaderboard
from stiff_protocols.errors import StoreError
from stiff_protocols.files import make_folder, written_whole

TABLE_FILES = {"github": "md", "csv": "csv", "latex": "tex"}
PICTURE_FILES = ("png", "pdf")
LEADERBOARD_METRIC = "norm"
ALL_OF_FIGURE_5 = "5"
"""Its three panels are drawn one by one, too."""


def write_paper(output: Path, command: str) -> Iterator[Path]:
    """Write the paper's tables and figures beside ours, and yield each file.

    Args:
        output: PAPER = OUTPUT/paper holds the results in PAPER/runs, and gets PAPER/tables,
            PAPER/figures and PAPER/README.md.
        command: that made them.

    Raises:
        StoreError: a file cannot be written, or a stored one is damaged.
    """
    folder = output / "paper"
    results = PaperResults.of(folder / "runs")
    tables = []
    for number in TABLES:
        table = build(number, results)
        again = f"bench table {number}"
        for fmt, suffix in TABLE_FILES.items():
            path = folder / "tables" / f"table_{number}.{suffix}"
            yield _written(path, render_paper_table(table, fmt, f"{again} --format {fmt}"))
        tables.append(render_paper_table(table, "github", again))
    figures = [
        *(one for one in papers_available(results) if one.name != ALL_OF_FIGURE_5),
        *available(FigureSource(results.folder, results.contests)),
    ]
    yield from _pictures(figures, folder / "figures")
    page = _paper_page(tables, figures, provenance_lines(folder / "runs", command))
    yield _written(folder / "README.md", page)


def write_leaderboard(output: Path, command: str) -> Iterator[Path]:
    """Write the leaderboard as markdown and CSV with its figures, and yield each file.

    Args:
        output: OUTPUT/leaderboard holds the results in its runs/ and gets figures/; beside it come
            leaderboard.md and leaderboard.csv.
        command: that made them.

    Raises:
        StoreError: a file cannot be written, or a stored one is damaged.
        ConfigError: there is nothing to compare.
    """
    folder = output / "leaderboard"
    board, provenance = stored_leaderboard(folder / "runs", key=sort_key(LEADERBOARD_METRIC, None))
    yield _written(
        output / "leaderboard.csv", render_leaderboard(board, "csv", command, provenance)
    )
    figures = available(FigureSource.of(folder / "runs"))
    yield from _pictures(figures, folder / "figures")
    text = render_leaderboard(board, "github", command, provenance)
    lines = [*_leaderboard_notes(), *provenance_lines(folder / "runs", command)]
    head = ["# Leaderboard", *_listed(lines), text]
    shown = [_figure_text(figure, "leaderboard/figures") for figure in figures]
    yield _written(output / "leaderboard.md", "\n\n".join([*head, "## Figures", *shown]))


def _leaderboard_notes() -> Iterator[str]:
    yield (
        "every model that stiffbench ships, on five specimens of the simulated KR10, on the same "
        "twin pulled in every direction, and on 43 real measurements of a FANUC R-2000iC"
    )
    yield (
        f"networks with `pretrain_steps={NETWORK_STEPS}` in their names were pre-trained for that "
        "many steps in place of their recipe's 1,000 (`dt-cnn`: 3,000), and `deep-ensemble` has 2 "
        "members in place of 5: at full length the cells would take a day of a small machine. "
        "docs/models.md has the full recipes on `holdout`"
    )


def _paper_page(
    tables: Sequence[str], figures: Sequence[Prepared], provenance: Iterable[str]
) -> str:
    parts = [
        "# The source paper's tables and figures, published and ours",
        "Published numbers are of a measured KUKA KR10 R1100-2; ours are of `kr10-twin`, a "
        "simulation of it. Compare methods within one source, never the two in absolute terms.",
        *_listed(provenance),
        "## Tables",
        *tables,
        "## Figures",
        *(_figure_text(figure, "figures") for figure in figures),
    ]
    return "\n\n".join(parts)


def _listed(lines: Iterable[str]) -> list[str]:
    return ["\n".join(f"- {line}" for line in lines)]


def _figure_text(figure: Prepared, folder: str) -> str:
    """Return a figure with its caption, in markdown."""
    picture = f"{folder}/{_file_name(figure)}"
    alt = re.sub(r"[\[\]\\]", " ", figure.title)
    heading = f"### {markdown_text(_label(figure))}"
    caption = f"{markdown_text(figure.caption)} ([PDF]({picture}.pdf))"
    return f"{heading}\n\n![{alt}]({picture}.png)\n\n{caption}"


def _label(figure: Prepared) -> str:
    number = f"Figure {figure.name}: " if figure.name[0].isdigit() else ""
    return f"{number}{figure.title}"


def _file_name(figure: Prepared) -> str:
    return f"figure_{figure.name.replace('-', '_')}"


def _pictures(figures: Iterable[Prepared], folder: Path) -> Iterator[Path]:
    make_folder(folder)
    for figure in figures:
        for suffix in PICTURE_FILES:
            path = folder / f"{_file_name(figure)}.{suffix}"
            figure.save(path)
            yield path


def _written(path: Path, text: str) -> Path:
    make_folder(path.parent)
    with written_whole(path) as temporary:
        try:
            temporary.write_text(f"{text}\n", encoding="utf-8")
        except OSError as error:
            raise StoreError(f"{path}: cannot be written: {error.strerror or error}") from error
    return path
