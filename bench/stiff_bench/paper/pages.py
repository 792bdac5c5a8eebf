"""Writes the committed pages: the paper's tables and figures beside ours, and the leaderboard."""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from pathlib import Path

from stiff_bench.analysis.collected import StoredResults
from stiff_bench.analysis.leaderboard import build_leaderboard
from stiff_bench.analysis.leaderboard_tables import render_leaderboard
from stiff_bench.analysis.sort_key import sort_key
from stiff_bench.figures.catalog import FIGURES
from stiff_bench.figures.figure import Prepared, can_be_drawn
from stiff_bench.figures.source import FigureSource
from stiff_bench.paper import figures as paper_figures
from stiff_bench.paper.results import PaperResults
from stiff_bench.paper.study import NETWORK_STEPS
from stiff_bench.paper.tables import TABLES, build
from stiff_bench.store.database import FILE, read_manifests, read_results
from stiff_bench.store.versions import sources
from stiff_bench.tables.render import markdown_code, markdown_text, render
from stiff_bench.tables.units import counted
from stiff_models.model_catalog import MODELS
from stiff_protocols.contract.errors import StiffBenchError
from stiff_protocols.contract.files import make_folder, written_whole
from stiff_protocols.contract.record import CellResult

TABLE_FILES = {"github": "md", "csv": "csv", "latex": "tex"}
PICTURE_FILES = ("png", "pdf")
OF_LEADERBOARD = ("learning-curves", "scores", "errors", "workspace")
"""Figures of its page; the others are the paper's questions."""
OF_PAPER = tuple(name for name in FIGURES if name not in ("learning-curves", "calibration"))
"""General figures that its page has beside the paper's own."""
_ABOUT_LEADERBOARD = (
    "every model that stiffbench ships, on five specimens of the simulated KR10, on the same twin "
    "with forces in all directions, and on 43 real measurements of a FANUC R-2000iC",
    f"`pretrain_steps={NETWORK_STEPS}` in a name: pre-trained for that many steps in place of the "
    "recipe's; `deep-ensemble` has 2 members in place of 5. What that changes: docs/findings.md; "
    "the full recipes: docs/models.md",
)


def write_paper(output: Path, command: str, n_missing: int) -> Iterator[Path]:
    """Write the paper's tables and figures beside ours into OUTPUT/paper, and yield each file.

    What cannot be made of the results in OUTPUT/paper/runs is named on the page, with the reason.
    Arguments and errors are those of `write_study`.
    """
    folder = output / "paper"
    results = PaperResults.of(folder / "runs")
    tables, missing = list[str](), dict[str, str]()
    for number in TABLES:
        try:
            table = build(number, results)
        except StiffBenchError as error:
            missing[f"Table {number}"] = str(error)
            continue
        again = f"bench table {number}"
        for fmt, suffix in TABLE_FILES.items():
            path = folder / "tables" / f"table_{number}.{suffix}"
            yield written(path, render(table, fmt, f"{again} --format {fmt}"))
        tables.append(render(table, "github", again))
    source = FigureSource(results.folder, results.cases)
    drawn, not_drawn = can_be_drawn(paper_figures.FIGURES, results)
    others, also = can_be_drawn({name: FIGURES[name] for name in OF_PAPER}, source)
    missing |= {f"Figure {name}": why for name, why in (not_drawn | also).items()}
    yield from pictures(drawn | others, folder / "figures")
    page = [
        "# The source paper's tables and figures, published and ours",
        "Published numbers are of a measured KUKA KR10 R1100-2; ours are of `kr10-twin`, a "
        "simulation of it. Compare methods within each, never across in absolute terms.",
        listed(*provenance(folder / "runs", command, n_missing)),
        "## Tables",
        *tables,
        *figures_and_missing(drawn | others, "figures", missing),
    ]
    yield written(folder / "README.md", "\n\n".join(page))


def write_leaderboard(output: Path, command: str, n_missing: int) -> Iterator[Path]:
    """Write OUTPUT/leaderboard.md, .csv and figures; arguments and errors as in `write_study`.

    Raises:
        ConfigError: there is nothing to compare.
    """
    runs = output / "leaderboard" / "runs"
    stored = StoredResults.read(runs)
    board = build_leaderboard(stored, key=sort_key("norm", None))
    asked = {name: FIGURES[name] for name in OF_LEADERBOARD}
    figures, missing = can_be_drawn(asked, FigureSource(runs, stored.cases))
    return write_study(
        *(runs.parent, "Leaderboard", _ABOUT_LEADERBOARD),
        lambda fmt: render_leaderboard(board, fmt, command),
        command=command,
        n_missing=n_missing,
        figures=figures,
        missing=missing,
    )


def write_study(
    folder: Path,
    title: str,
    about: Sequence[str],
    text_as: Callable[[str], str],
    *,
    command: str,
    n_missing: int,
    figures: Mapping[str, Prepared] = {},
    missing: Mapping[str, str] = {},
) -> Iterator[Path]:
    """Write FOLDER.csv, figures into FOLDER/figures and the page FOLDER.md; yield each file.

    The results are in FOLDER/runs, of which `n_missing` are not computed; `about` is what must be
    known of them, `text_as` returns their tables in a format. `missing` has figures that cannot be
    drawn -> why.

    Raises:
        StoreError: nothing is stored, a file cannot be written, or a stored one is corrupt.
    """
    yield written(folder.with_suffix(".csv"), text_as("csv"))
    yield from pictures(figures, folder / "figures")
    page = [
        f"# {title}",
        listed(*about, *provenance(folder / "runs", command, n_missing)),
        text_as("github"),
        *figures_and_missing(figures, f"{folder.name}/figures", missing),
    ]
    yield written(folder.with_suffix(".md"), "\n\n".join(page))


def provenance(folder: Path, command: str, n_missing: int) -> Iterator[str]:
    """Yield lines of markdown: the command, the versions, and each machine."""
    runs, results = read_manifests(folder), read_results(folder)
    yield f"made by {markdown_code(command)}"
    if n_missing:
        yield f"not finished: {counted(n_missing, 'fit')} not computed"
    if former := former_models(results):
        yield (
            f"waits to be made again: {', '.join(former)} gave other numbers then (their "
            "version was raised since; `bench show MODEL` has it)"
        )
    yield markdown_text(sources(folder, runs, Counter(one.run_id for one in results)))
    unknown = {"processor": "unknown processor", "platform": "unknown platform"}
    unknown |= dict.fromkeys(("cores", "python", "torch"), "?")
    about = "{processor}, {cores} cores, {platform}, Python {python}, torch {torch}"
    machines = Counter(about.format_map(unknown | dict(run.environment)) for run in runs)
    for machine, n_runs in machines.items():
        yield f"{markdown_text(machine)}: {counted(n_runs, 'run')} (`{folder.name}/{FILE}`)"


def former_models(results: Iterable[CellResult]) -> list[str]:
    """Return the shipped models of which results are of a former version.

    A model that is a library's is known by more than a number, and left out.
    """
    today = {info.key: str(info.version) for info in MODELS}
    of_cells = {(one.cell.model, one.cell.model_version) for one in results}
    numbered = {(key, version) for key, version in of_cells if version.isdecimal()}
    return sorted({key for key, version in numbered if today.get(key, version) != version})


def figures_and_missing(
    figures: Mapping[str, Prepared], folder: str, missing: Mapping[str, str]
) -> Iterator[str]:
    """Yield the end of a page: its figures, and what could not be made, with the reason."""
    if figures:
        yield "## Figures"
    for name, figure in figures.items():
        picture = f"{folder}/{_file_name(name)}"
        number = f"Figure {name}: " if name[0].isdigit() else ""
        yield f"### {number}{figure.title}"
        yield f"![{figure.title}]({picture}.png)"
        yield f"{markdown_text(figure.caption)} ([PDF]({picture}.pdf))"
    if missing:
        yield "## Not made"
        yield listed(*(f"{what}: {markdown_text(why)}" for what, why in missing.items()))


def listed(*lines: str) -> str:
    """Return lines of markdown as a list."""
    return "\n".join(f"- {line}" for line in lines)


def _file_name(figure: str) -> str:
    return f"figure_{figure.replace('-', '_')}"


def pictures(figures: Mapping[str, Prepared], folder: Path) -> Iterator[Path]:
    """Write figures as PNG and PDF, and yield each file."""
    for name, figure in figures.items():
        make_folder(folder)
        for suffix in PICTURE_FILES:
            path = folder / f"{_file_name(name)}.{suffix}"
            figure.save(path)
            yield path


def written(path: Path, text: str) -> Path:
    """Write a page whole, and return where."""
    make_folder(path.parent)
    with written_whole(path) as temporary:
        temporary.write_text(f"{text}\n", encoding="utf-8")
    return path
