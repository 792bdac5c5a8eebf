"""Writes the committed leaderboard."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path

from stiff_bench.figures.catalog import FIGURES
from stiff_bench.figures.figure_line import can_be_drawn
from stiff_bench.figures.figure_source import FigureSource
from stiff_bench.leaderboard_tables import render_leaderboard
from stiff_bench.paper.page_parts import figure_text, listed, not_made, pictures, written
from stiff_bench.paper.provenance_text import provenance_lines
from stiff_bench.paper.study import NETWORK_STEPS
from stiff_bench.sort_key import sort_key
from stiff_bench.stored_leaderboard import stored_leaderboard

METRIC = "norm"
SHOWN = ("ranks", "learning-curves", "errors", "workspace")
"""Figures of the page; the others are the paper's questions."""


def write_leaderboard(output: Path, command: str, n_missing: int) -> Iterator[Path]:
    """Write the leaderboard as markdown and CSV with its figures, and yield each file.

    Args:
        output: OUTPUT/leaderboard holds the results in its runs/ and gets figures/; beside it come
            leaderboard.md and leaderboard.csv.
        command: that made them.
        n_missing: how many of the study's cells are not stored.

    Raises:
        StoreError: a file cannot be written, or a stored one is damaged.
        ConfigError: there is nothing to compare.
    """
    folder = output / "leaderboard"
    board, provenance = stored_leaderboard(folder / "runs", key=sort_key(METRIC, None))
    as_csv = render_leaderboard(board, "csv", command, provenance)
    yield written(output / "leaderboard.csv", as_csv)
    asked = {name: FIGURES[name] for name in SHOWN}
    figures, missing = can_be_drawn(asked, FigureSource.of(folder / "runs"))
    yield from pictures(figures, folder / "figures")
    page = [
        "# Leaderboard",
        listed([*_about(), *provenance_lines(folder / "runs", command, n_missing)]),
        render_leaderboard(board, "github", command, provenance),
        "## Figures",
        *(figure_text(figure, "leaderboard/figures") for figure in figures),
    ]
    if missing:
        page += ["## Not made", listed(not_made(missing))]
    yield written(output / "leaderboard.md", "\n\n".join(page))


def _about() -> Iterator[str]:
    yield (
        "every model that stiffbench ships, on five specimens of the simulated KR10, on the same "
        "twin pulled in every direction, and on 43 real measurements of a FANUC R-2000iC"
    )
    yield (
        f"networks with `pretrain_steps={NETWORK_STEPS}` in their names were pre-trained for that "
        "many steps in place of their recipe's 1,000 (`dt-cnn`: 3,000), and `deep-ensemble` has 2 "
        "members in place of 5: at full length the cells would take a day of a small machine. "
        "`ft-mlp` hardly changes through it, `dt-cnn` becomes better by about 30 % (measured: "
        "docs/findings.md). docs/models.md has the full recipes on `holdout`"
    )
