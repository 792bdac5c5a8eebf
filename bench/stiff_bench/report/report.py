"""From a folder of results to what the page says of it."""

from __future__ import annotations

import functools
from collections.abc import Iterator, Sequence
from dataclasses import replace
from importlib.metadata import version
from pathlib import Path

from stiff_bench.analysis.collected import (
    Contest,
    asked_for,
    chosen_contests,
    competitor_names,
    left_out_notes,
    same_name_other_data,
    stands_for,
)
from stiff_bench.analysis.leaderboard import Leaderboard, Section, caveats_of, presentation
from stiff_bench.analysis.sort_key import SortKey, sort_key
from stiff_bench.analysis.stored_leaderboard import StoredResults
from stiff_bench.analysis.verdict import Question
from stiff_bench.figures.source import FigureSource
from stiff_bench.report.content import Block, Page, Part
from stiff_bench.report.page import render_page
from stiff_bench.report.pairs import pair_block
from stiff_bench.report.pictures import picture_block
from stiff_bench.report.runs import Selection, failure_block, run_block
from stiff_bench.report.scores import board_block, data_block, score_block
from stiff_bench.store.database import read_data
from stiff_bench.tables.table import SELECTION_MARK
from stiff_bench.tables.units import counted
from stiff_protocols.contract.errors import ConfigError, StoreError, unknown_name
from stiff_protocols.contract.files import written_whole
from stiff_protocols.contract.plugin import kind_label


def check_choice(contests: Sequence[Contest], choice: Selection) -> None:
    """See that each word has results, and that the data sets and protocols meet somewhere.

    Args:
        contests: of all folders together.
        choice: what was asked for.

    Raises:
        ConfigError: a word has none, or they do not meet.
    """
    known = competitor_names(contests)
    for word in choice.models:
        if not _has_model(contests, word):
            raise ConfigError(f"--model: {unknown_name('model with results', word, known)}")
    if not chosen_contests(contests, datasets=choice.datasets, protocols=choice.protocols):
        raise ConfigError(
            f"--dataset {', '.join(choice.datasets)} --protocol {', '.join(choice.protocols)}: no "
            "data set of these has results under a protocol of these"
        )


def narrowed(contests: Sequence[Contest], choice: Selection) -> tuple[Selection, tuple[str, ...]]:
    """Return the words that one folder has results of, and those that it has not.

    Args:
        contests: of the folder.
        choice: what was asked for, see `check_choice`.
    """
    models = tuple(word for word in choice.models if _has_model(contests, word))
    datasets = tuple(word for word in choice.datasets if _has(contests, datasets=(word,)))
    protocols = tuple(word for word in choice.protocols if _has(contests, protocols=(word,)))
    here = replace(choice, models=models, datasets=datasets, protocols=protocols)
    asked = (*choice.models, *choice.datasets, *choice.protocols)
    present = {*models, *datasets, *protocols}
    return here, tuple(word for word in asked if word not in present)


def chosen_here(contests: Sequence[Contest], asked: Selection, here: Selection) -> list[Contest]:
    """Return the contests of a folder that were asked for; none where it lacks all of a kind."""
    for words, present in (
        (asked.models, here.models),
        (asked.datasets, here.datasets),
        (asked.protocols, here.protocols),
    ):
        if words and not present:
            return []
    return chosen_contests(contests, datasets=here.datasets, protocols=here.protocols)


def _has_model(contests: Sequence[Contest], word: str) -> bool:
    return any(stands_for(word, name) for name in competitor_names(contests))


def _has(
    contests: Sequence[Contest], *, datasets: Sequence[str] = (), protocols: Sequence[str] = ()
) -> bool:
    try:
        return bool(chosen_contests(contests, datasets=datasets, protocols=protocols))
    except ConfigError:
        return False


_HEADING = "Read this first"


def part_of(stored: StoredResults, asked: Selection, key: SortKey) -> Part:
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
            failure_block(chosen, choice.models),
            data_block(chosen),
            run_block(stored.runs, chosen, stored.provenance(board)),
        ],
    )


def _board(
    stored: StoredResults, chosen: Sequence[Contest], choice: Selection, key: SortKey
) -> tuple[Leaderboard | None, str]:
    """Return the leaderboard, or why there is none: one model alone, or no samples.

    Scores need neither other models nor samples.
    """
    try:
        return stored.board_of(chosen, models=choice.models, key=key, seed=choice.seed), ""
    except (ConfigError, StoreError) as error:
        return None, str(error)


def _summary(contests: Sequence[Contest], choice: Selection, lacking: Sequence[str]) -> Block:
    shown = [presentation(contest) for contest in contests]
    competitors = [
        one
        for contest in contests
        for name, one in contest.competitors.items()
        if asked_for(name, choice.models)
    ]
    n_results = sum(len(one.done) for one in competitors)
    failures = [failure for one in competitors for failure in one.failures.values()]
    n_skipped = sum(failure.status == "skipped" for failure in failures)
    kinds = dict.fromkeys(kind_label(one.kind, one.task) for one in shown)
    n_models = len({one.name for one in competitors})
    return Block(
        _HEADING,
        [
            f"{counted(n_results, 'result')} of {counted(n_models, 'model')} in "
            f"{counted(len(contests), 'contest')}; "
            f"{counted(len(failures) - n_skipped, 'cell')} failed, "
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
    board: Leaderboard | None, why_none: str, stored: StoredResults, choice: Selection
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


def _pairs(section: Section, heading: str, stored: StoredResults, choice: Selection) -> Block:
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


SUFFIXES = (".html", ".htm")


def write_report(folders: Sequence[Path], choice: Selection, output: Path, command: str) -> None:
    """Write the page of some folders of results, whole or not at all.

    Args:
        folders: each a part of the page.
        choice: what is shown of each.
        output: the file.
        command: the command line, for the record.

    Raises:
        ConfigError: the file's suffix is none of a page, a folder is named twice, a name has no
            results in any of them, or the metric cannot rank.
        StoreError: a folder holds no results or damaged ones, or the file cannot be written.
    """
    if output.suffix.lower() not in SUFFIXES:
        valid = ", ".join(SUFFIXES)
        raise ConfigError(
            f"--output {output}: suffix {output.suffix!r} is no page's (valid: {valid})"
        )
    for number, folder in enumerate(folders):
        if folder.resolve() in {other.resolve() for other in folders[:number]}:
            raise ConfigError(f"--results {folder}: is named twice")
    key = sort_key(choice.metric, choice.axis)
    stored = [StoredResults.read(folder) for folder in folders]
    check_choice([contest for one in stored for contest in one.contests], choice)
    parts = [part_of(one, choice, key) for one in stored]
    page = Page(command, version("stiffbench"), parts)
    with written_whole(output) as temporary:
        temporary.write_text(render_page(page), encoding="utf-8", newline="\n")
