"""From a folder of results to what the page says of it."""

from __future__ import annotations

import functools
from collections.abc import Iterator, Sequence

from stiff_bench.collected import Contest, asked_for, left_out_notes, same_name_other_data
from stiff_bench.contest_choice import caveats_of, presentation
from stiff_bench.estimates import Question
from stiff_bench.figures.figure_source import FigureSource
from stiff_bench.leaderboard import Leaderboard, Section
from stiff_bench.report.board_tables import board_block
from stiff_bench.report.commands import Choice
from stiff_bench.report.content import Block, Part
from stiff_bench.report.failures import failure_block
from stiff_bench.report.narrowed import chosen_here, narrowed
from stiff_bench.report.pair_tables import pair_block
from stiff_bench.report.pictures import picture_block
from stiff_bench.report.run_tables import run_block
from stiff_bench.report.scores import data_block, score_block
from stiff_bench.sort_key import SortKey
from stiff_bench.store import read_data
from stiff_bench.stored_leaderboard import StoredResults
from stiff_bench.tables import SELECTION_MARK
from stiff_bench.words import counted
from stiff_protocols.errors import ConfigError, StoreError
from stiff_protocols.plugin import kind_label

_HEADING = "Read this first"


def part_of(stored: StoredResults, asked: Choice, key: SortKey) -> Part:
    """Return all that the page says of one folder.

    Args:
        stored: its results.
        asked: what the page shows; words that only other folders have results of are left out, and
            said.
        key: what it ranks by.

    Raises:
        StoreError: a file of the folder is damaged.
    """
    choice, lacking = narrowed(stored.contests, asked)
    chosen = chosen_here(stored.contests, asked, choice)
    folder = stored.folder
    notes = [f"No result of {word} here." for word in lacking]
    if not chosen:
        said = "Nothing that was asked for has results here."
        return Part(str(folder), [Block(_HEADING, [said], notes=notes)])
    board, why_none = _board(stored, chosen, choice, key)
    return Part(
        str(folder),
        [
            _summary(chosen, choice, notes),
            *_ranking(board, why_none, stored, choice),
            picture_block(FigureSource(folder, tuple(chosen), choice.models), choice),
            score_block(chosen, choice.models, key.metric.key),
            failure_block(stored, chosen, choice.models),
            data_block(chosen),
            run_block(stored.runs, chosen, stored.provenance(board)),
        ],
    )


def _board(
    stored: StoredResults, chosen: Sequence[Contest], choice: Choice, key: SortKey
) -> tuple[Leaderboard | None, str]:
    """Return the leaderboard, or why there is none: one model alone, or no samples.

    Scores need neither other models nor samples.
    """
    try:
        return stored.board_of(chosen, models=choice.models, key=key, seed=choice.seed), ""
    except (ConfigError, StoreError) as error:
        return None, str(error)


def _summary(contests: Sequence[Contest], choice: Choice, lacking: Sequence[str]) -> Block:
    shown = [presentation(contest) for contest in contests]
    competitors = [
        one
        for contest in contests
        for name, one in contest.competitors.items()
        if asked_for(name, choice.models)
    ]
    n_results = sum(len(one.done) for one in competitors)
    reasons = [reason for one in competitors for reason in one.reasons.values()]
    n_skipped = sum(reason.startswith("skipped: ") for reason in reasons)
    kinds = dict.fromkeys(kind_label(one.kind, one.task) for one in shown)
    n_models = len({one.name for one in competitors})
    return Block(
        _HEADING,
        [
            f"{counted(n_results, 'result')} of {counted(n_models, 'model')} in "
            f"{counted(len(contests), 'contest')}; "
            f"{counted(len(reasons) - n_skipped, 'cell')} failed, "
            f"{counted(n_skipped, 'cell')} skipped. Data: {', '.join(kinds)}."
        ],
        notes=[
            *lacking,
            *caveats_of(contests),
            *same_name_other_data(contests),
            *left_out_notes(contests),
        ],
    )


def _ranking(
    board: Leaderboard | None, why_none: str, stored: StoredResults, choice: Choice
) -> Iterator[Block]:
    """Yield the leaderboard and the pairs of each section; those that select on test come last."""
    if board is None:
        yield Block("Leaderboard", [f"No ranks: {why_none.removesuffix('.')}."])
        return
    command = choice.command("leaderboard", folder=stored.folder, ranked=True)
    for section in board.sections:
        apart = f" ({SELECTION_MARK})" if section.selects_on_test else ""
        yield board_block(section, board, heading=f"Leaderboard{apart}", command=command)
        yield _pairs(section, f"Pairwise comparisons{apart}", stored, choice)


def _pairs(section: Section, heading: str, stored: StoredResults, choice: Choice) -> Block:
    """Return the comparisons, or why there are none: they need the samples, ranks do not."""
    folder = stored.folder
    try:
        return pair_block(
            section,
            heading=heading,
            folder=folder,
            data_of=functools.cache(functools.partial(read_data, folder)),
            question=Question(seed=choice.seed),
        )
    except StoreError as error:
        return Block(heading, [f"No comparisons: {error}."])
