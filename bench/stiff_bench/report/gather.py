"""From a folder of results to what the page says of it."""

from __future__ import annotations

import functools
from collections.abc import Iterator, Sequence
from pathlib import Path

from stiff_bench.collected import (
    Contest,
    chosen_contests,
    collect,
    competitor_names,
    left_out_notes,
    same_name_other_data,
    stands_for,
)
from stiff_bench.contest_choice import presentation
from stiff_bench.estimates import Question
from stiff_bench.figures.figure_source import FigureSource
from stiff_bench.leaderboard import Leaderboard, build_leaderboard
from stiff_bench.report.board_tables import board_block
from stiff_bench.report.commands import Choice
from stiff_bench.report.content import Block, Part
from stiff_bench.report.failures import failure_block
from stiff_bench.report.pair_tables import pair_block
from stiff_bench.report.pictures import picture_block
from stiff_bench.report.run_tables import run_block
from stiff_bench.report.scores import data_block, score_block
from stiff_bench.result_source import sources
from stiff_bench.sort_key import SortKey, sort_key
from stiff_bench.store import read_manifests
from stiff_bench.stored_data import read_data
from stiff_bench.tables import SELECTION_MARK
from stiff_bench.words import counted
from stiff_protocols.errors import ConfigError, unknown_name
from stiff_protocols.plugin import kind_label
from stiff_protocols.record import RunManifest


def part_of(folder: Path, choice: Choice) -> Part:
    """Return all that the page says of one folder.

    Raises:
        ConfigError: a name has no results, or the metric cannot rank.
        StoreError: the folder holds no results, a file of it is damaged, or two models share no
            split.
    """
    key = sort_key(choice.metric, choice.axis)
    contests = collect(folder)
    runs = list(read_manifests(folder))
    _check_models(contests, choice.models)
    chosen = chosen_contests(contests, datasets=choice.datasets, protocols=choice.protocols)
    board, why_none = _board(chosen, runs, key, folder, choice)
    return Part(
        str(folder),
        [
            _summary(chosen, choice),
            *_ranking(board, why_none, folder, choice),
            picture_block(FigureSource(folder, tuple(chosen), choice.models), choice),
            score_block(chosen, choice.models, key.metric.key),
            failure_block(folder, chosen, choice.models),
            data_block(chosen),
            run_block(runs, chosen, _provenance(folder, contests, runs, board)),
        ],
    )


def _check_models(contests: Sequence[Contest], words: Sequence[str]) -> None:
    known = competitor_names(contests)
    for word in words:
        if not any(stands_for(word, name) for name in known):
            raise ConfigError(f"--model: {unknown_name('model with results', word, known)}")


def _board(
    chosen: Sequence[Contest],
    runs: Sequence[RunManifest],
    key: SortKey,
    folder: Path,
    choice: Choice,
) -> tuple[Leaderboard | None, str]:
    """Return the leaderboard, or why there is none: one model alone still has scores."""
    try:
        asked = {cell for run in runs for cell in run.cells}
        return (
            build_leaderboard(
                chosen, models=choice.models, key=key, folder=folder, asked=asked, seed=choice.seed
            ),
            "",
        )
    except ConfigError as error:
        return None, str(error)


def _summary(contests: Sequence[Contest], choice: Choice) -> Block:
    shown = [presentation(contest) for contest in contests]
    competitors = [
        one
        for contest in contests
        for name, one in contest.competitors.items()
        if not choice.models or any(stands_for(word, name) for word in choice.models)
    ]
    n_results = sum(len(one.done) for one in competitors)
    n_failed = sum(len(one.reasons) for one in competitors)
    kinds = dict.fromkeys(kind_label(one.kind, one.task) for one in shown)
    n_models = len({one.name for one in competitors})
    caveats = [note for one in shown for note in (*one.caveats, one.warning)]
    return Block(
        "Read this first",
        [
            f"{counted(n_results, 'result')} of {counted(n_models, 'model')} in "
            f"{counted(len(contests), 'contest')}; {counted(n_failed, 'cell')} failed or skipped. "
            f"Data: {', '.join(kinds)}."
        ],
        notes=[
            *filter(None, dict.fromkeys(caveats)),
            *same_name_other_data(contests),
            *left_out_notes(contests),
        ],
    )


def _ranking(
    board: Leaderboard | None, why_none: str, folder: Path, choice: Choice
) -> Iterator[Block]:
    """Yield the leaderboard and the pairs of each section; those that select on test come last."""
    if board is None:
        yield Block("Leaderboard", [f"No ranks: {why_none}."])
        return
    command = choice.command("leaderboard", folder=folder, ranked=True)
    data_of = functools.cache(functools.partial(read_data, folder / "data"))
    for section in board.sections:
        apart = f" ({SELECTION_MARK})" if section.selects_on_test else ""
        yield board_block(section, board, heading=f"Leaderboard{apart}", command=command)
        yield pair_block(
            section,
            heading=f"Pairwise comparisons{apart}",
            folder=folder,
            data_of=data_of,
            question=Question(seed=choice.seed),
        )


def _provenance(
    folder: Path,
    contests: Sequence[Contest],
    runs: Sequence[RunManifest],
    board: Leaderboard | None,
) -> list[str]:
    n_counting = sum(contest.n_results for contest in contests)
    ranked = [] if board is None else [*sources(folder, runs, board.run_ids)]
    return [f"{n_counting} results and failures of the folder count.", *ranked]
