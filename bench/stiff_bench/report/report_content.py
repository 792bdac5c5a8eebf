"""From a folder of results to what the page says of it."""

from __future__ import annotations

import shlex
from collections.abc import Iterator, Sequence
from contextlib import suppress
from dataclasses import dataclass, replace
from datetime import UTC, datetime
from pathlib import Path

from stiff_bench.analysis.answer import Answer
from stiff_bench.analysis.collected import StoredResults, left_out_notes, same_name_other_data
from stiff_bench.analysis.leaderboard import Leaderboard, build_leaderboard
from stiff_bench.analysis.leaderboard_tables import section_tables
from stiff_bench.analysis.scored_case import family_of
from stiff_bench.analysis.selection import EVERYTHING, Selection
from stiff_bench.analysis.sort_key import SortKey, sort_key
from stiff_bench.figures.figure_catalog import FIGURES
from stiff_bench.figures.figure_source import FigureSource
from stiff_bench.report.first_screen import first_screen
from stiff_bench.report.html_page import Block, Picture, render_page
from stiff_bench.report.model_pairs import pair_table
from stiff_bench.report.run_blocks import failure_block, provenance_block
from stiff_bench.report.score_blocks import Asked, data_block, score_block
from stiff_bench.store.names import CaseName
from stiff_bench.tables.metric_table import SELECTION_MARK
from stiff_bench.tables.units import counted
from stiff_protocols.contract.errors import (
    ConfigError,
    StiffBenchError,
    StoreError,
    unsupported_extension,
)
from stiff_protocols.contract.files import written_whole


@dataclass(frozen=True)
class PageOptions:
    """What a page shows, and what it ranks by; no axis: the mean over them. `seed`: of draws."""

    selection: Selection = EVERYTHING
    metric: str = "norm"
    axis: str | None = None
    seed: int = 0

    def command(
        self, *words: str, folder: Path, ranked: bool = False, narrowed: Selection = EVERYTHING
    ) -> str:
        """Return a command line that begins with `words`.

        Args:
            words: the command.
            folder: of the results.
            ranked: whether it ranks, and draws poses.
            narrowed: a choice of data in place of the page's; its models are the page's.
        """
        chosen = self.selection
        if narrowed.options:
            chosen = replace(narrowed, models=chosen.models)
        options: list[tuple[str, object]] = [("results", folder), *chosen.options]
        if ranked:
            given = {"metric": self.metric, "axis": self.axis, "seed": self.seed}
            usual = {"metric": "norm", "axis": None, "seed": 0}
            options += [(name, value) for name, value in given.items() if value != usual[name]]
        words = (*words, *(word for name, value in options for word in (f"--{name}", str(value))))
        return shlex.join(["bench", *words])


def blocks_of(stored: StoredResults, choice: PageOptions, key: SortKey) -> list[Block]:
    """Return the content of one folder: the first screen, figures, and folded details.

    Raises:
        ConfigError: a word has no results in the folder.
        StoreError: a file of the folder is corrupt.
    """
    folder = stored.folder
    selection = choice.selection
    selection.models_of(stored.cases)  # each has results
    chosen = tuple(selection.cases_of(stored.cases))
    if not chosen:
        words = ", ".join(f"{kind} {word}" for kind, word in selection.options)
        raise ConfigError(f"{words}: nothing in {folder} is of all of these")
    asked = {
        case: [model for name, model in case.competitors.items() if selection.takes(name)]
        for case in chosen
    }
    shown = StoredResults(folder, chosen, stored.runs)
    board = None
    with suppress(ConfigError, StoreError):  # scores need neither other models nor samples
        board = build_leaderboard(shown, key, Selection(selection.models), seed=choice.seed)
    pictures = _pictures(FigureSource(folder, chosen, selection.models), choice)
    failures = failure_block(asked)
    return [
        _first_block(shown, asked, choice, key),
        *([Block("Figures", pictures=pictures)] if pictures else []),
        *([failures] if failures.tables else []),
        score_block(asked, key.metric.key),
        *(_ranking(board, folder, choice) if board else ()),
        data_block(chosen, shown.data_of),
        provenance_block(stored.runs, chosen, board.provenance if board else (), pictures),
    ]


def _first_block(shown: StoredResults, asked: Asked, choice: PageOptions, key: SortKey) -> Block:
    """Return the answer, or why there is none; its heading counts what the folder holds."""
    cases = [*asked]
    notes = [*same_name_other_data(cases, shown.data_of), *left_out_notes(cases)]
    models = {model.name for of_case in asked.values() for model in of_case}
    heading = _counts(asked)
    try:
        answer = Answer.of(shown, key, cases, models, seed=choice.seed)
    except (ConfigError, StoreError) as error:
        return Block(heading, [f"No answer: {str(error).removesuffix('.')}."], notes=notes)
    left_out = [f"{name} is left out: it {reason}." for name, reason in answer.left_out.items()]
    return Block(heading, screen=first_screen(answer, [*notes, *left_out]))


def _counts(asked: Asked) -> str:
    """Return the number of models, data sets, protocols and fits, in one line."""
    competitors = [model for of_case in asked.values() for model in of_case]
    failures = [failure for model in competitors for failure in model.failures.values()]
    n_skipped = sum(failure.status == "skipped" for failure in failures)
    words = [
        counted(len({model.name for model in competitors}), "model"),
        counted(len({family_of(case.name) for case in asked}), "data set"),
        counted(len({case.name.protocol for case in asked}), "protocol"),
        counted(sum(len(model.done) for model in competitors), "fit"),
        f"{len(failures) - n_skipped} failed",
        *([f"{n_skipped} skipped"] if n_skipped else []),
    ]
    return ", ".join(words)


def _ranking(board: Leaderboard, folder: Path, choice: PageOptions) -> Iterator[Block]:
    """Yield the tables of each section; those that select on test come last."""
    command = choice.command("leaderboard", folder=folder, ranked=True)
    for section in board.sections:
        apart = f" ({SELECTION_MARK})" if section.selects_on_test else ""
        tables = section_tables(section, board)
        yield Block(f"Leaderboard{apart}", tables=tables, command=command, folded=True)
        pairs = pair_table(section, board)
        if pairs.rows:
            yield Block(f"Pairs of models{apart}", tables=[pairs], folded=True)


LARGEST_SVG = 300_000
"""Bytes; a picture of more is embedded as PNG."""
BY_DATA = ("errors", "regression", "workspace")
"""Figures that are drawn of each data set and protocol."""
MOST_CASES = 8
"""Data sets and protocols that have such figures."""


def _pictures(source: FigureSource, choice: PageOptions) -> list[Picture]:
    """Return the figures that the results are enough for, then those of each comparison."""
    general = [_picture(name, source, choice) for name in FIGURES if name not in BY_DATA]
    cases = [case for case in source.newest if not case.shown.selects_on_test]
    cases.sort(key=lambda case: (case.shown.kind != "measured", bool(case.name.condition)))
    by_data = [
        _picture(name, replace(source, cases=(case,)), choice, case.name)
        for case in cases[:MOST_CASES]
        for name in BY_DATA
        if name in FIGURES
    ]
    return [picture for picture in (*general, *by_data) if picture is not None]


def _picture(
    name: str, source: FigureSource, choice: PageOptions, case: CaseName | None = None
) -> Picture | None:
    """Return a figure; None where the results are not enough for it."""
    try:
        figure = FIGURES[name](source)
        media_type, content = "image/svg+xml", figure.picture(".svg")
        if len(content) > LARGEST_SVG:
            media_type, content = "image/png", figure.picture(".png")
    except (StiffBenchError, ArithmeticError, ValueError):  # must not cost the page
        return None
    dataset, protocol, options = "", "", Selection()
    if case is not None:
        dataset = case.dataset
        protocol = ", ".join(filter(None, (case.protocol, case.condition)))
        conditions = (case.condition,) if case.condition else ()
        options = Selection((), (dataset,), (case.protocol,), conditions)
    command = choice.command("figure", name, folder=source.folder, narrowed=options)
    return Picture(*(figure.title, figure.caption, media_type, content, command, dataset, protocol))


SUFFIXES = (".html", ".htm")


def write_report(folders: Sequence[Path], choice: PageOptions, output: Path, command: str) -> None:
    """Write the page of some folders of results, whole or not at all.

    Raises:
        ConfigError: the file's suffix is none of a page, a folder is named twice, a name has no
            results in one of them, or the metric cannot rank.
        StoreError: a folder holds no results or corrupt ones, or the file cannot be written.
    """
    if output.suffix.lower() not in SUFFIXES:
        raise unsupported_extension(output, SUFFIXES, "output")
    for number, folder in enumerate(folders):
        if folder.resolve() in {other.resolve() for other in folders[:number]}:
            raise ConfigError(f"{folder}: is named twice", "results")
    key = sort_key(choice.metric, choice.axis)
    parts = {str(one): blocks_of(StoredResults.read(one), choice, key) for one in folders}
    page = render_page(parts, command, datetime.now(UTC).strftime("%-d %b %Y"))
    with written_whole(output) as temporary:
        temporary.write_text(page, encoding="utf-8", newline="\n")
