"""Writes the paper's tables and figures beside ours, and a page that holds them all."""

from __future__ import annotations

import re
from collections import Counter
from collections.abc import Iterable, Iterator, Mapping, Sequence
from datetime import timedelta
from pathlib import Path

from stiff_bench.analysis.leaderboard_tables import render_leaderboard
from stiff_bench.analysis.sort_key import sort_key
from stiff_bench.analysis.stored_leaderboard import stored_leaderboard
from stiff_bench.figures.catalog import FIGURES
from stiff_bench.figures.figure import Prepared, can_be_drawn
from stiff_bench.figures.source import FigureSource
from stiff_bench.paper import catalog as paper_figures
from stiff_bench.paper.catalog import TABLES, build
from stiff_bench.paper.results import PaperResults
from stiff_bench.paper.study import NETWORK_STEPS
from stiff_bench.paper.table import render_paper_table
from stiff_bench.store.database import FILE, read_manifests, stored_results
from stiff_bench.store.versions import sources
from stiff_bench.tables.render import markdown_code, markdown_text
from stiff_bench.tables.units import counted
from stiff_protocols.contract.errors import StiffBenchError
from stiff_protocols.contract.files import make_folder, written_whole
from stiff_protocols.contract.record import RunManifest


def provenance_lines(folder: Path, command: str, n_missing: int) -> Iterator[str]:
    """Yield lines of markdown: the command, the versions, the time, and each machine.

    Raises:
        StoreError: a file of the folder is damaged.
    """
    runs = list(read_manifests(folder))
    counts: Counter[str] = Counter()
    fitting_s = 0.0
    for result in stored_results(folder):
        counts[result.run_id] += 1
        fitting_s += 0.0 if result.cost is None else result.cost.fit_s
    yield f"made by {markdown_code(command)}"
    if n_missing:
        yield f"not finished: {counted(n_missing, 'cell')} of it not computed"
    for line in sources(folder, runs, counts):
        yield markdown_text(line)
    yield f"fits took {timedelta(seconds=round(fitting_s))} (h:min:s) of one thread in all"
    name = f"{folder.name}/{FILE}"
    for machine, n_runs in _machines(runs).items():
        where = "its manifest is" if n_runs == 1 else "their manifests are"
        yield f"{markdown_text(machine)}: {counted(n_runs, 'run')}; {where} in `{name}`"


def _machines(runs: list[RunManifest]) -> Counter[str]:
    """Return machine -> number of its runs."""
    found: Counter[str] = Counter()
    for run in runs:
        known = run.environment
        about = (
            f"{known.get('processor', 'unknown processor')}, {known.get('cores', '?')} cores, "
            f"{known.get('platform', 'unknown platform')}, Python {known.get('python', '?')}, "
            f"torch {known.get('torch', '?')}"
        )
        found[about] += 1
    return found


PICTURE_FILES = ("png", "pdf")


def written(path: Path, text: str) -> Path:
    """Write a text file, whole or not at all, and return its path.

    Raises:
        StoreError: it cannot be written.
    """
    make_folder(path.parent)
    with written_whole(path) as temporary:
        temporary.write_text(f"{text}\n", encoding="utf-8")
    return path


def pictures(figures: Iterable[Prepared], folder: Path) -> Iterator[Path]:
    """Write figures as PNG and PDF, and yield each file.

    Raises:
        StoreError: a file cannot be written.
    """
    make_folder(folder)
    for figure in figures:
        for suffix in PICTURE_FILES:
            path = folder / f"{_file_name(figure)}.{suffix}"
            figure.save(path)
            yield path


def listed(lines: Iterable[str]) -> str:
    """Return a list in markdown."""
    return "\n".join(f"- {line}" for line in lines)


def not_made(reasons: Mapping[str, str]) -> Iterator[str]:
    """Yield a line for each table or figure that could not be made, with the reason."""
    for what, reason in reasons.items():
        yield f"{what}: {markdown_text(reason)}"


def figure_text(figure: Prepared, folder: str) -> str:
    """Return a figure with its heading and caption, in markdown; `folder` is seen from the page."""
    picture = f"{folder}/{_file_name(figure)}"
    number = f"Figure {figure.name}: " if figure.name[0].isdigit() else ""
    alt = re.sub(r"[\[\]\\]", " ", figure.title)
    return "\n\n".join(
        [
            f"### {markdown_text(f'{number}{figure.title}')}",
            f"![{alt}]({picture}.png)",
            f"{markdown_text(figure.caption)} ([PDF]({picture}.pdf))",
        ]
    )


def _file_name(figure: Prepared) -> str:
    return f"figure_{figure.name.replace('-', '_')}"


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
