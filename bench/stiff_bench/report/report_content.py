"""Content of the report page, from a folder of results."""

from __future__ import annotations

import shlex
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

from stiff_bench.analysis.answer import Answer
from stiff_bench.analysis.collected import (
    StoredResults,
    caveats_of,
    left_out_notes,
    same_name_other_data,
)
from stiff_bench.analysis.leaderboard import Leaderboard, build_leaderboard
from stiff_bench.analysis.leaderboard_tables import section_tables
from stiff_bench.analysis.scored_case import family_of
from stiff_bench.analysis.selection import EVERYTHING, Selection
from stiff_bench.analysis.sort_key import SortKey, sort_key
from stiff_bench.figures.figure_catalog import FIGURES
from stiff_bench.figures.figure_source import FigureSource
from stiff_bench.report.first_screen import FIRST_COLUMNS, first_screen
from stiff_bench.report.html_page import Block, Part, Picture, embedded, render_page
from stiff_bench.report.model_pairs import pair_table
from stiff_bench.report.run_blocks import failure_blocks, run_block
from stiff_bench.report.score_blocks import RequestedModels, data_block, data_hashes, score_block
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
    """Selection and ranking of a page.

    Without `axis`, models are ranked by the mean over the axes. `seed` is for the random draws.
    """

    selection: Selection = EVERYTHING
    metric: str = "norm"
    axis: str | None = None
    seed: int = 0

    def command(self, *words: str, folder: Path, ranked: bool = False) -> str:
        """Return a command line that begins with `words`.

        With `ranked`, it includes the options for ranking and random draws.
        """
        options: list[tuple[str, object]] = [("results", folder), *self.selection.options]
        if ranked:
            given = {"metric": self.metric, "axis": self.axis, "seed": self.seed}
            usual = {"metric": "norm", "axis": None, "seed": 0}
            options += [(name, value) for name, value in given.items() if value != usual[name]]
        words = (*words, *(word for name, value in options for word in (f"--{name}", str(value))))
        return shlex.join(["bench", *words])


def part_of(stored: StoredResults, choice: PageOptions, key: SortKey) -> Part:
    """Return the content of the page for one folder.

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
        raise ConfigError(f"no result in {folder} matches all of {words}; select less")
    answer, board, reasons = None, None, []
    selected_results = StoredResults(folder, chosen, stored.runs)
    names = set(selection.models_of(chosen))
    try:  # scores need neither other models nor samples
        board = build_leaderboard(
            selected_results, key, Selection(selection.models), seed=choice.seed
        )
    except (ConfigError, StoreError) as error:
        reasons.append(f"No ranking: {str(error).removesuffix('.')}.")
    scored = [case for section in board.sections for case in section.cases] if board else []
    try:
        answer = Answer.of(selected_results, key, chosen, names, seed=choice.seed, scored=scored)
    except (ConfigError, StoreError) as error:
        reasons.insert(0, f"No answer: {str(error).removesuffix('.')}.")
    requested_models = {
        case: [model for name, model in case.competitors.items() if selection.takes(name)]
        for case in chosen
    }
    data_of = selected_results.data_of
    left_out = answer.left_out if answer else {}
    return Part(
        _facts(selected_results, requested_models),
        first_screen(answer) if answer else None,
        reason=" ".join(reasons),
        notes=[
            *caveats_of(chosen),
            *same_name_other_data(chosen, data_of),
            *left_out_notes(chosen),
            *(f"Not in the answer: {name} ({reason})." for name, reason in left_out.items()),
        ],
        blocks=[
            *_figure_block(FigureSource(folder, chosen, selection.models), answer, choice),
            *failure_blocks(requested_models),
            data_block(chosen, data_of),
            *(_ranking(board, folder, choice) if board else ()),
            score_block(requested_models, key.metric.key),
            run_block(stored.runs, chosen, board.provenance if board else (), data_hashes(chosen)),
        ],
    )


def _facts(stored: StoredResults, requested_models: RequestedModels) -> str:
    """Return folder, date of the newest run, and counts, in one line."""
    cases, competitors = (
        [*requested_models],
        [model for of_case in requested_models.values() for model in of_case],
    )
    failures = [failure for model in competitors for failure in model.failures.values()]
    n_skipped = sum(failure.status == "skipped" for failure in failures)
    n_failed = len(failures) - n_skipped
    numbers = {
        "model": len({model.name for model in competitors}),
        "data set": len({family_of(case.name) for case in cases}),
        "protocol": len({case.name.protocol for case in cases}),
        "fit": sum(len(model.done) for model in competitors) + n_failed,
    }
    dates = [run.started[: len("2026-01-01")] for run in stored.runs if run.started]
    skipped = [f"{n_skipped} skipped"] if n_skipped else []
    counts = [counted(number, thing) for thing, number in numbers.items()]
    return " · ".join(
        [
            stored.folder.name or str(stored.folder),
            *([max(dates)] if dates else []),
            ", ".join([*counts, f"{n_failed} failed", *skipped]),
        ]
    )


def _ranking(board: Leaderboard, folder: Path, choice: PageOptions) -> Iterator[Block]:
    """Yield the tables of each section; sections that select on test data are last."""
    command = choice.command("leaderboard", folder=folder, ranked=True)
    for section in board.sections:
        apart = f" ({SELECTION_MARK})" if section.selects_on_test else ""
        tables = section_tables(section, board)
        yield Block(f"Leaderboard{apart}", tables=tables, command=command, is_detail=True)
        pairs = pair_table(section, board)
        if pairs.rows:
            yield Block(f"Pairs of models{apart}", tables=[pairs], is_detail=True)


OF_ONE_CASE = ("errors", "regression", "workspace")
"""Figures that are drawn for each data set and protocol."""
MOST_CASES = FIRST_COLUMNS
"""Number of data sets and protocols with figures of their own."""


def _figure_block(
    source: FigureSource, answer: Answer | None, choice: PageOptions
) -> Iterator[Block]:
    """Yield the figures of all results, then the figures of each matrix column."""
    once = [name for name in FIGURES if name not in OF_ONE_CASE]
    pictures = [_picture(name, source, choice) for name in once]
    columns = answer.columns if answer else ()
    for column in columns[:MOST_CASES]:
        case = column.cases[0].case
        selection = Selection(
            choice.selection.models,
            (case.name.dataset,),
            (case.name.protocol,),
            (case.name.condition,) if case.name.condition else (),
        )
        plan = ", ".join(filter(None, (column.protocol, column.condition)))
        of_case = replace(source, cases=(case,))
        for name in OF_ONE_CASE:
            if name in FIGURES:
                picture = _picture(name, of_case, replace(choice, selection=selection))
                pictures.append(picture and picture._replace(dataset=column.dataset, protocol=plan))
    drawn = [picture for picture in pictures if picture]
    notes = []
    if len(columns) > MOST_CASES:
        notes.append(
            f"The first {MOST_CASES} of {len(columns)} data sets and protocols have their "
            "own figures; draw others with `bench figure`, --dataset and --protocol."
        )
    if drawn:
        yield Block("Figures", pictures=drawn, notes=notes)


def _picture(name: str, source: FigureSource, choice: PageOptions) -> Picture | None:
    """Return a figure; None if the results are not sufficient."""
    try:
        command = choice.command("figure", name, folder=source.folder)
        return embedded(FIGURES[name](source), command)
    except (StiffBenchError, ArithmeticError, ValueError):  # the page is still written
        return None


SUFFIXES = (".html", ".htm")


def write_report(folders: Sequence[Path], choice: PageOptions, output: Path, command: str) -> None:
    """Write the page of some folders of results, completely or not at all.

    Raises:
        ConfigError: the file's extension is not supported, a folder is given twice, a name has no
            results in a folder, or the metric cannot rank.
        StoreError: a folder has no results or corrupt results, or the file cannot be written.
    """
    if output.suffix.lower() not in SUFFIXES:
        raise unsupported_extension(output, SUFFIXES, "output")
    for number, folder in enumerate(folders):
        if folder.resolve() in {earlier_folder.resolve() for earlier_folder in folders[:number]}:
            raise ConfigError(f"{folder}: given twice; give each folder once", "results")
    key = sort_key(choice.metric, choice.axis)
    parts = {str(path): part_of(StoredResults.read(path), choice, key) for path in folders}
    with written_whole(output) as temporary:
        temporary.write_text(render_page(parts, command), encoding="utf-8", newline="\n")
