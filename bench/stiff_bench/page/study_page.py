"""Write the page of a study: tables, figures and provenance."""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Iterable, Iterator, Mapping
from functools import partial
from pathlib import Path
from typing import Any

from stiff_bench.analysis.collected import StoredResults, newest_results
from stiff_bench.analysis.leaderboard import build_leaderboard
from stiff_bench.analysis.leaderboard_tables import leaderboard_tables
from stiff_bench.analysis.sort_key import sort_key
from stiff_bench.figures.board_figures import score_against_cost, score_against_poses
from stiff_bench.figures.figure_catalog import FIGURES
from stiff_bench.figures.figure_source import FigureSource
from stiff_bench.figures.prepared_figure import Prepared
from stiff_bench.page.markdown import markdown_page
from stiff_bench.page.page import Figure, Page, Section, write_text
from stiff_bench.paper import paper_figures, paper_tables
from stiff_bench.paper.paper_results import PaperResults
from stiff_bench.paper.study_board import StudyResults
from stiff_bench.paper.study_file import Study
from stiff_bench.store.database import FILE
from stiff_bench.store.versions import sources
from stiff_bench.tables.metric_table import build_tables
from stiff_bench.tables.table import Table
from stiff_bench.tables.units import counted
from stiff_bench.tables.writers import markdown_code, render
from stiff_models.model_catalog import MODELS
from stiff_protocols.contract.errors import StiffBenchError, unknown_name
from stiff_protocols.contract.files import make_folder
from stiff_protocols.contract.record import CellResult
from stiff_protocols.scoring.metrics import metric

TABLE_FILES = {"github": "md", "csv": "csv", "latex": "tex"}
PICTURE_FILES = ("png", "pdf")
Makers = Mapping[str, Callable[[StudyResults, PaperResults], Any]]
"""Name in a study's file -> function of the stored results; numbers are the source paper's."""


def _leaderboard(results: StudyResults, stored: PaperResults) -> list[Table]:
    if results.study.board is not None:
        return results.board_tables
    return leaderboard_tables(build_leaderboard(stored, key=sort_key("norm", None)))


def _scores(results: StudyResults, stored: PaperResults) -> list[Table]:
    return build_tables(newest_results(stored), [metric(key) for key in results.study.metrics])


def _of_paper(make: Callable[[PaperResults], Any], _: StudyResults, stored: PaperResults) -> Any:
    return make(stored)


def _general(
    make: Callable[[FigureSource], Prepared], _: StudyResults, stored: PaperResults
) -> Prepared:
    return make(FigureSource(stored.folder, stored.cases))


TABLES: Makers = {
    "scores": _scores,
    "leaderboard": _leaderboard,
    **{number: partial(_of_paper, make) for number, make in paper_tables.TABLES.items()},
}
PICTURES: Makers = {
    "board-cost": lambda results, _: score_against_cost(results.board),
    "board-poses": lambda results, _: score_against_poses(results.board),
    **{number: partial(_of_paper, make) for number, make in paper_figures.FIGURES.items()},
    **{name: partial(_general, make) for name, make in FIGURES.items()},
}


def check_names(study: Study) -> None:
    """Check the names of a study's tables and figures.

    Raises:
        ConfigError: a name is unknown.
    """
    for name in study.tables:
        if name not in TABLES:
            raise unknown_name("table of a study", name, TABLES)
    for name in study.figures:
        if name not in PICTURES:
            raise unknown_name("figure of a study", name, PICTURES)


def write_page(
    study: Study,
    output: Path,
    command: str,
    n_missing: int,
    statuses: Mapping[str, str] | None = None,
) -> Iterator[Path]:
    """Write OUTPUT/NAME/README.md with its tables and figures, and yield each file.

    The results are in OUTPUT/NAME/runs; `n_missing` fits are not computed. The page names tables
    and figures that cannot be made, with the reason. `statuses` has the status of each model; None
    omits this column of the board.

    Raises:
        StoreError: nothing is stored, a file cannot be written, or a stored file is corrupt.
    """
    folder = output / study.name
    stored = PaperResults.of(folder / "runs")
    results = StudyResults(study, stored, statuses or {})
    sections, figures, missing = list[Section](), list[Section](), list[str]()

    def made(kind: str, names: Iterable[str], makers: Makers) -> Iterator[tuple[str, Any]]:
        for name in names:
            try:
                yield name, makers[name](results, stored)
            except StiffBenchError as error:
                missing.append(f"{kind} {name}: {error}")

    for name, tables in made("Table", study.tables, TABLES):
        for fmt, suffix in TABLE_FILES.items():
            line = f"bench table {name} --format {fmt}" if name.isdecimal() else command
            file = folder / "tables" / f"{_stem('table', name)}.{suffix}"
            yield write_text(file, f"{render(tables, fmt, line)}\n")
            if fmt == "github":
                sections.append(Section("", tables=tables, command=line))
    for name, figure in made("Figure", study.figures, PICTURES):
        make_folder(folder / "figures")
        address = f"figures/{_stem('figure', name)}"
        for suffix in PICTURE_FILES:
            picture = folder / f"{address}.{suffix}"
            figure.save(picture)
            yield picture
        number = f"Figure {name}: " if name.isdecimal() else ""
        placed_figure = Figure(figure.title, figure.caption, f"{address}.png")
        figures.append(Section(f"{number}{figure.title}", figures=[placed_figure]))
    notes = [*study.notes, *_provenance(stored, command, n_missing)]
    sections = [
        Section("", notes=notes),
        *sections,
        *([Section("Figures", sections=figures)] if figures else []),
        *([Section("Not made", notes=missing)] if missing else []),
    ]
    yield write_text(folder / "README.md", f"{markdown_page(Page(study.title, sections))}\n")


def _provenance(stored: StoredResults, command: str, n_missing: int) -> Iterator[str]:
    """Yield notes: the command, the versions, and each machine."""
    results = [result for case in stored.cases for result in case.every]
    yield f"made by {markdown_code(command)}"
    if n_missing:
        yield f"not finished: {counted(n_missing, 'fit')} not computed"
    if outdated := outdated_models(results):
        yield (
            f"out of date: {', '.join(outdated)} (these models changed since the run; "
            "`bench show MODEL` has their version)"
        )
    counts = Counter(result.run_id for result in results)
    yield sources(stored.folder, stored.runs, counts)
    unknown = {"processor": "unknown processor", "platform": "unknown platform"}
    unknown |= dict.fromkeys(("cores", "python", "torch"), "?")
    about = "{processor}, {cores} cores, {platform}, Python {python}, torch {torch}"
    machines = Counter(about.format_map(unknown | dict(run.environment)) for run in stored.runs)
    for machine, n_runs in machines.items():
        yield f"{machine}: {counted(n_runs, 'run')} (`{stored.folder.name}/{FILE}`)"


def outdated_models(results: Iterable[CellResult]) -> list[str]:
    """Return the shipped models with results of an earlier version.

    Third-party models are omitted: their versions are not plain numbers.
    """
    today = {info.key: str(info.version) for info in MODELS}
    of_cells = {(result.cell.model, result.cell.model_version) for result in results}
    numbered = {(key, version) for key, version in of_cells if version.isdecimal()}
    return sorted({key for key, version in numbered if today.get(key, version) != version})


def _stem(kind: str, name: str) -> str:
    return f"{kind}_{name.replace('-', '_')}"
