"""Write the page of a study: tables, figures and provenance."""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Iterable, Iterator, Mapping
from dataclasses import dataclass
from functools import cached_property, partial
from pathlib import Path
from typing import Any

from stiff_bench.figures.board_figures import score_against_cost, score_against_poses
from stiff_bench.figures.figure_catalog import FIGURES
from stiff_bench.figures.figure_source import FigureSource
from stiff_bench.figures.prepared_figure import Prepared
from stiff_bench.page.page import write_text
from stiff_bench.paper import paper_figures, paper_tables
from stiff_bench.paper.paper_results import PaperResults
from stiff_bench.paper.study_file import Study
from stiff_bench.results.columns import metric_tables
from stiff_bench.results.leaderboard import StudyLeaderboard, leaderboard_tables
from stiff_bench.results.load import StoredResults
from stiff_bench.results.notes import outdated_models, sources
from stiff_bench.results.scored_task import sort_key
from stiff_bench.store.database import FILE
from stiff_bench.tables.table import Table
from stiff_bench.tables.units import counted
from stiff_bench.tables.writers import markdown_code, markdown_text, render
from stiff_protocols.contract.errors import ConfigError, StiffBenchError, unknown_name
from stiff_protocols.contract.files import make_folder
from stiff_protocols.scoring.metrics import metric

TABLE_FILES = {"github": "md", "csv": "csv", "latex": "tex"}
PICTURE_FILES = ("png", "pdf")


@dataclass(frozen=True, eq=False)
class StudyResults:
    """A study with its results.

    Attributes:
        study: models, data sets and protocols, and content of the page.
        stored: results of the study.
    """

    study: Study
    stored: StoredResults

    @cached_property
    def leaderboard(self) -> StudyLeaderboard:
        """Return the study's leaderboard; ConfigError if its file has no key `board`."""
        if self.study.board is None:
            text = "[board] is missing: it names the protocol of the board"
            raise ConfigError(f"{self.study.file}: {text}")
        return StudyLeaderboard(self.stored, self.study.board)


Makers = Mapping[str, Callable[[StudyResults], Any]]
"""Name in a study's file -> function of the stored results; numbers are the source paper's."""


def _leaderboard(results: StudyResults) -> list[Table]:
    if results.study.board is not None:
        return results.leaderboard.tables
    return leaderboard_tables(results.stored, sort_key())


def _scores(results: StudyResults) -> list[Table]:
    metrics = [metric(key) for key in results.study.metrics]
    return metric_tables(results.stored.newest_results(), metrics)


def _of_paper(make: Callable[[Any], Any], results: StudyResults) -> Any:
    return make(results.stored)  # `PaperResults`


def _general(make: Callable[[FigureSource], Prepared], results: StudyResults) -> Prepared:
    return make(FigureSource(results.stored.folder, results.stored.tasks))


TABLES: Makers = {
    "scores": _scores,
    "leaderboard": _leaderboard,
    **{number: partial(_of_paper, make) for number, make in paper_tables.TABLES.items()},
}
PICTURES: Makers = {
    "board-cost": lambda results: score_against_cost(results.leaderboard),
    "board-poses": lambda results: score_against_poses(results.leaderboard),
    **{number: partial(_of_paper, make) for number, make in paper_figures.FIGURES.items()},
    **{name: partial(_general, make) for name, make in FIGURES.items()},
}


def check_names(study: Study) -> None:
    """Check the names of a study's tables and figures.

    Raises:
        ConfigError: a name is unknown.
    """
    every = ("table", study.tables, TABLES), ("figure", study.figures, PICTURES)
    for kind, names, makers in every:
        for name in names:
            if name not in makers:
                raise unknown_name(f"{kind} of a study", name, makers)


def write_page(study: Study, output: Path, command: str, n_missing: int) -> Iterator[Path]:
    """Write OUTPUT/NAME/README.md with its tables and figures, and yield each file.

    The results are in OUTPUT/NAME/runs; `n_missing` fits are not computed. The page names tables
    and figures that cannot be made, with the reason.

    Raises:
        StoreError: nothing is stored, a file cannot be written, or a stored file is corrupt.
    """
    folder = output / study.name
    stored = PaperResults.of(folder / "runs")
    results = StudyResults(study, stored)
    missing = list[str]()

    def made(kind: str, names: Iterable[str], makers: Makers) -> Iterator[tuple[str, Any]]:
        for name in names:
            try:
                yield name, makers[name](results)
            except StiffBenchError as error:
                missing.append(f"{kind} {name}: {error}")

    notes = [*study.notes, *_provenance(stored, command, n_missing)]
    parts = [f"# {markdown_text(study.title)}", _listed(notes)]
    for name, tables in made("Table", study.tables, TABLES):
        for fmt, suffix in TABLE_FILES.items():
            line = f"bench table {name} --format {fmt}" if name.isdecimal() else command
            text = render(tables, fmt, line)
            parts += [text] * (fmt == "github")
            yield write_text(folder / "tables" / f"{_stem('table', name)}.{suffix}", f"{text}\n")
    figures = list[str]()
    for name, figure in made("Figure", study.figures, PICTURES):
        make_folder(folder / "figures")
        address = f"figures/{_stem('figure', name)}"
        for suffix in PICTURE_FILES:
            picture = folder / f"{address}.{suffix}"
            figure.save(picture)
            yield picture
        title, number = markdown_text(figure.title), f"Figure {name}: " * name.isdecimal()
        caption = f"{markdown_text(figure.caption)} ([PDF]({address}.pdf))"
        figures += [f"### {number}{title}", f"![{title}]({address}.png)", caption]
    parts += ["## Figures", *figures] if figures else []
    parts += ["## Not made", _listed(missing)] if missing else []
    yield write_text(folder / "README.md", "\n\n".join(parts) + "\n")


def _listed(lines: Iterable[str]) -> str:
    return "\n".join(f"- {markdown_text(line)}" for line in lines)


def _provenance(stored: StoredResults, command: str, n_missing: int) -> Iterator[str]:
    """Yield notes: the command, the versions, and each machine."""
    results = stored.every
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


def _stem(kind: str, name: str) -> str:
    return f"{kind}_{name.replace('-', '_')}"
