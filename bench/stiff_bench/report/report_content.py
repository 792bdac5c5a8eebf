"""From a folder of results to what the page says of it."""

from __future__ import annotations

import shlex
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path

from stiff_bench.analysis.collected import (
    StoredResults,
    left_out_notes,
    same_name_other_data,
)
from stiff_bench.analysis.leaderboard import (
    Leaderboard,
    build_leaderboard,
    caveats_of,
)
from stiff_bench.analysis.leaderboard_tables import section_tables
from stiff_bench.analysis.scored_case import correction_text
from stiff_bench.analysis.selection import EVERYTHING, Selection
from stiff_bench.analysis.sort_key import SortKey, sort_key
from stiff_bench.figures.figure_catalog import FIGURES
from stiff_bench.figures.figure_source import FigureSource
from stiff_bench.report.html_page import Block, Picture, render_page
from stiff_bench.report.model_pairs import pair_table
from stiff_bench.report.run_blocks import failure_block, run_block
from stiff_bench.report.score_blocks import Asked, data_block, score_block
from stiff_bench.store.samples import StoredData
from stiff_bench.tables.metric_table import SELECTION_MARK, number_format
from stiff_bench.tables.units import PRINTED, counted, first_few
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

    def command(self, *words: str, folder: Path, ranked: bool = False) -> str:
        """Return a command line that begins with `words`; `ranked`: it ranks, and draws poses."""
        options: list[tuple[str, object]] = [("results", folder), *self.selection.options]
        if ranked:
            given = {"metric": self.metric, "axis": self.axis, "seed": self.seed}
            usual = {"metric": "norm", "axis": None, "seed": 0}
            options += [(name, value) for name, value in given.items() if value != usual[name]]
        words = (*words, *(word for name, value in options for word in (f"--{name}", str(value))))
        return shlex.join(["bench", *words])


def blocks_of(stored: StoredResults, choice: PageOptions, key: SortKey) -> list[Block]:
    """Return all that the page says of one folder.

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
    board, why_none = None, ""
    shown = StoredResults(folder, chosen, stored.runs)
    try:  # scores need neither other models nor samples
        board = build_leaderboard(shown, key, Selection(selection.models), seed=choice.seed)
    except (ConfigError, StoreError) as error:
        why_none = f"No ranking: {str(error).removesuffix('.')}."
    asked = {
        case: [one for name, one in case.competitors.items() if selection.takes(name)]
        for case in chosen
    }
    data_of = shown.data_of
    pictures = _pictures(FigureSource(folder, chosen, selection.models), choice)
    first = pictures.pop(FIRST_FIGURE, None)
    return [
        _summary(_verdict(board) if board else why_none, asked, data_of),
        data_block(chosen, data_of),
        *([Block("Error by model", pictures=[first])] if first else []),
        *(_ranking(board, folder, choice) if board else ()),
        score_block(asked, key.metric.key),
        *([Block("Figures", pictures=[*pictures.values()])] if pictures else []),
        failure_block(asked),
        run_block(stored.runs, chosen, board.provenance if board else ()),
    ]


def _verdict(board: Leaderboard) -> str:
    """Return which model is best, and which are not significantly worse.

    Whether models differ is what `ScoredCase.verdicts` says, as in all tables of the page.
    """
    section, key = board.sections[0], board.key
    if section.ranked.empty:
        return "No ranking: no two models have all results."
    first, *others = section.ranked.index
    like_best = section.ranked["like_best"]
    models, n_cases = counted(len(section.ranked), "model"), len(section.cases)
    if n_cases == 1:
        (case,) = section.cases
        unit, factor = PRINTED[key.metric.unit]
        value = f"{factor * case.mean(first):{number_format(key.metric)}} {unit}".rstrip()
        best = "largest" if key.sign < 0.0 else "smallest"
        text = f"{first} has the {best} {key.metric.label} of {models}: {value}."
    else:
        text = (
            f"{first} ranks first of {models} by {key.text}: mean rank "
            f"{section.ranked['mean_rank'].iloc[0]:.2f} over {n_cases} comparisons."
        )
    if key.is_cost or not others:
        return text
    correction = correction_text(section.cases)
    if alike := [model for model in others if like_best[model] == n_cases]:
        who = "No significant difference from it"
        if n_cases > 1:
            who = "Tied with the best in every comparison"
        return f"{text} {who} ({correction}): {first_few(alike)}."
    if all(like_best[others] == 0):  # NaN: no test applies
        losers = "All others are" if len(others) > 1 else f"{others[0]} is"
        than = " than the best in every comparison" if n_cases > 1 else ""
        return f"{text} {losers} significantly worse{than} ({correction})."
    return text


def _summary(verdict: str, asked: Asked, data_of: Callable[[str], StoredData]) -> Block:
    cases, competitors = [*asked], [one for of_case in asked.values() for one in of_case]
    n_results = sum(len(one.done) for one in competitors)
    failures = [failure for one in competitors for failure in one.failures.values()]
    n_skipped = sum(failure.status == "skipped" for failure in failures)
    kinds = dict.fromkeys(case.shown.kind for case in cases)
    n_models = len({one.name for one in competitors})
    return Block(
        "Summary",
        [
            verdict,
            f"{counted(n_results, 'result')} of {counted(n_models, 'model')} in "
            f"{counted(len(cases), 'comparison')}; {len(failures) - n_skipped} failed, "
            f"{n_skipped} skipped. Data: {', '.join(kinds)}.",
        ],
        notes=[*caveats_of(cases), *same_name_other_data(cases, data_of), *left_out_notes(cases)],
    )


def _ranking(board: Leaderboard, folder: Path, choice: PageOptions) -> Iterator[Block]:
    """Yield the tables of each section; those that select on test come last."""
    command = choice.command("leaderboard", folder=folder, ranked=True)
    for section in board.sections:
        apart = f" ({SELECTION_MARK})" if section.selects_on_test else ""
        yield Block(f"Leaderboard{apart}", tables=section_tables(section, board), command=command)
        pairs = pair_table(section, board)
        if pairs.rows:
            yield Block(f"Pairs of models{apart}", tables=[pairs])


FIRST_FIGURE = "scores"
LARGEST_SVG = 300_000
"""Bytes; a picture of more is embedded as PNG."""


def _pictures(source: FigureSource, choice: PageOptions) -> dict[str, Picture]:
    """Return name -> each figure that the results are enough for."""
    pictures = {}
    for name, gather in FIGURES.items():
        try:
            figure = gather(source)
            media_type, content = "image/svg+xml", figure.picture(".svg")
            if len(content) > LARGEST_SVG:
                media_type, content = "image/png", figure.picture(".png")
        except (StiffBenchError, ArithmeticError, ValueError):  # must not cost the page
            continue
        command = choice.command("figure", name, folder=source.folder)
        pictures[name] = Picture(figure.title, figure.caption, media_type, content, command)
    return pictures


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
    with written_whole(output) as temporary:
        temporary.write_text(render_page(parts, command), encoding="utf-8", newline="\n")
