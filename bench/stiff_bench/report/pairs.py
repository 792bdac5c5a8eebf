"""The pairwise comparisons of a leaderboard's section as tables of the page. Here SI becomes mm."""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Iterator, Mapping, Sequence, Set
from dataclasses import dataclass, replace
from itertools import combinations
from pathlib import Path

import numpy as np

from stiff_bench.analysis.collected import Contest, split_sizes
from stiff_bench.analysis.comparison_text import VERDICTS
from stiff_bench.analysis.leaderboard import Section, presentation
from stiff_bench.analysis.verdict import Question, SharedErrors, Verdict, decide_pairs
from stiff_bench.report.content import Block, Cell, Kind, PageTable, Tone
from stiff_bench.report.runs import shell_words
from stiff_bench.report.scores import page_table
from stiff_bench.store.names import ContestName, grouped
from stiff_bench.store.newest import Slot
from stiff_bench.store.samples import StoredData
from stiff_bench.tables.render import TextTable
from stiff_bench.tables.units import MM, counted, marked, percent
from stiff_protocols.contract.record import CellResult
from stiff_protocols.contract.types import FloatArray
from stiff_protocols.scoring.bootstrap import (
    PoseErrors,
    pose_errors,
    resampled_means,
)
from stiff_protocols.scoring.metrics import norm_errors


@dataclass(frozen=True)
class Pair:
    """Two models in one contest, by the mean length of the error.

    Attributes:
        name: of the contest.
        a, b: names.
        n_splits: that both have.
        difference: mean error of A less that of B, m.
        p_value: over splits where there are several, else over poses.
        verdict: of all estimates together.
        of_fits: the verdict is of the fitted models alone: one split, or all scored together.
    """

    name: ContestName
    a: str
    b: str
    n_splits: int
    difference: float
    p_value: float
    verdict: Verdict
    of_fits: bool


def n_pairs(contest: Contest, models: Sequence[str]) -> int:
    """Return how many pairs of these models have results in a contest."""
    present = sum(1 for name in models if name in contest.competitors)
    return present * (present - 1) // 2


def compared_pairs(
    contest: Contest, models: Sequence[str], data: StoredData, question: Question
) -> Iterator[Pair]:
    """Yield all pairs of these models that share a split and at least two poses of a contest."""
    present = [name for name in models if name in contest.competitors]
    pairs = [
        (a, b, slots)
        for a, b in combinations(present, 2)
        if (slots := tuple(contest.shared_slots([a, b])))
    ]
    for slots, of_slots in grouped(pairs, lambda pair: pair[2]).items():
        together = [(a, b) for a, b, _ in of_slots]
        yield from _of_slots(contest, together, slots, data, question)


@dataclass(frozen=True)
class _Errors:
    """A model's errors on the shared splits: by split, (J,) m, and by pose."""

    of_splits: FloatArray
    of_poses: PoseErrors


def _of_slots(
    contest: Contest,
    pairs: Sequence[tuple[str, str]],
    slots: Sequence[Slot],
    data: StoredData,
    question: Question,
) -> Iterator[Pair]:
    names = list(dict.fromkeys(name for pair in pairs for name in pair))
    errors = {name: _errors(contest.results(name, slots), data) for name in names}
    if len(errors[names[0]].of_poses.poses) < 2:
        return
    by_split = len(slots) > 1 and not presentation(contest).pooled
    of_poses = [one.of_poses for one in errors.values()]
    shared = SharedErrors(
        of_splits=np.column_stack([e.of_splits for e in errors.values()]) if by_split else None,
        test_share=split_sizes(contest.results(names[0], slots), len(data.samples)).test_share,
        of_poses=of_poses,
        drawn=resampled_means(of_poses, seed=question.seed),
    )
    columns = [(names.index(a), names.index(b)) for a, b in pairs]
    decisions = decide_pairs(shared, columns, question, correct=False) or []
    for (a, b), decision in zip(pairs, decisions, strict=True):
        yield Pair(
            name=contest.name,
            a=a,
            b=b,
            n_splits=len(slots),
            difference=_difference(errors[a], errors[b], by_split),
            p_value=decision.p_value,
            verdict=decision.verdict,
            of_fits=not by_split,
        )


def _errors(results: Sequence[CellResult], data: StoredData) -> _Errors:
    found = [result.prediction for result in results if result.prediction is not None]
    each = [norm_errors(prediction) for prediction in found]
    poses = data.samples.pose_id[np.concatenate([prediction.rows for prediction in found])]
    return _Errors(
        np.array([errors.mean() for errors in each]),
        pose_errors(poses, np.concatenate(each)[:, None]),
    )


def _difference(a: _Errors, b: _Errors, by_split: bool) -> float:
    if by_split:
        return float(a.of_splits.mean() - b.of_splits.mean())
    return float(a.of_poses.mean[0] - b.of_poses.mean[0])


MOST_PAIRS = 10_000
"""So many comparisons are computed for a section: some seconds."""
MOST_MODELS = 40
"""So many models are compared with each other."""
_MIRRORED: Mapping[Verdict, Verdict] = {"a": "b", "b": "a"}


def pair_block(
    section: Section,
    *,
    heading: str,
    folder: Path,
    data_of: Callable[[str], StoredData],
    question: Question,
) -> Block:
    """Return a matrix of all pairs and a list of them by protocol."""
    asked = list(section.marks)[:MOST_MODELS]
    pairs, n_left_out = _pairs(section, asked, data_of, question)
    compared = {name for pair in pairs for name in (pair.a, pair.b)}
    models = [name for name in asked if name in compared]
    if not pairs:
        return Block(heading, ["No two models share a split with at least two poses."])
    command = shell_words("bench", "compare", pairs[0].a, pairs[0].b, "--results", str(folder))
    shown = [_named(section, model) for model in models]
    return Block(
        heading,
        [
            "Mean length of the 3-D error, each pair of models in each contest (a data set under a "
            "protocol and condition), on the splits that both have."
        ],
        [_matrix(pairs, models, shown), _list(pairs, section, command)],
        notes=[*_notes(section, question, asked, compared, n_left_out), *section.caveats],
    )


def _pairs(
    section: Section,
    models: Sequence[str],
    data_of: Callable[[str], StoredData],
    question: Question,
) -> tuple[list[Pair], int]:
    """Return the pairs in as many contests as `MOST_PAIRS` allows, and how many contests lack."""
    pairs: list[Pair] = []
    left = MOST_PAIRS
    for number, field in enumerate(section.fields):
        left -= n_pairs(field.contest, models)
        if left < 0:
            return pairs, len(section.fields) - number
        data = data_of(field.name.data_sha256)
        pairs += compared_pairs(field.contest, models, data, question)
    return pairs, 0


def _named(section: Section, model: str) -> str:
    return marked(model, section.marks[model])


def _matrix(pairs: Sequence[Pair], models: Sequence[str], shown: Sequence[str]) -> PageTable:
    counts: dict[tuple[str, str], Counter[Verdict]] = {}
    for pair in pairs:
        other_way = _MIRRORED.get(pair.verdict, pair.verdict)
        counts.setdefault((pair.a, pair.b), Counter())[pair.verdict] += 1
        counts.setdefault((pair.b, pair.a), Counter())[other_way] += 1
    n_most = max(count.total() for count in counts.values())
    rows: list[tuple[Cell, ...]] = []
    for number, (row, name) in enumerate(zip(models, shown, strict=True), 1):
        cells = (
            _matrix_cell(counts.get((row, column)), n_most, row == column) for column in models
        )
        rows.append((Cell(f"{number} {name}", f"{number:06d}"), *cells))
    kinds: list[Kind] = ["number"] * len(models)
    return PageTable(
        caption="Pairwise: contests in which the row is better, and in which it is worse",
        header=("model", *(str(number) for number in range(1, len(models) + 1))),
        kinds=("text", *kinds),
        rows=tuple(rows),
        notes=(
            "Columns have the rows' numbers. 5 : 1 means that the row is better in 5 contests and "
            f"the column in 1; in the others of {n_most}, or of as many as stand beside it, they "
            "are equivalent or cannot be told apart.",
        ),
        widget=False,
    )


def _matrix_cell(count: Counter[Verdict] | None, n_most: int, is_diagonal: bool) -> Cell:
    if count is None:
        return Cell("" if is_diagonal else "-", "")
    won, lost = count["a"], count["b"]
    tone: Tone = "better" if won > lost else "worse" if lost > won else ""
    fewer = f" of {count.total()}" if count.total() < n_most else ""
    return Cell(f"{won} : {lost}{fewer}", str(won - lost), tone)


def _list(pairs: Sequence[Pair], section: Section, command: str) -> PageTable:
    rows = [
        [
            *(marked(name, section.mark_under(protocol, name)) for name in (a, b)),
            protocol,
            str(len(found)),
            *(str(sum(one.verdict == verdict for one in found)) for verdict in VERDICTS),
            f"{MM * np.mean([one.difference for one in found]):+.4f}",
        ]
        for (a, b, protocol), found in grouped(
            pairs, lambda pair: (pair.a, pair.b, pair.name.protocol)
        ).items()
    ]
    header = ("A", "B", "protocol", "contests", *VERDICTS.values(), "mean A - B [mm]")
    table = TextTable("Pairs by protocol: number of contests with each verdict", header, rows, ())
    made = page_table(table, command=command)
    return replace(
        made, notes=(*made.notes, "The command beneath shows one pair, contest by contest.")
    )


def _notes(
    section: Section,
    question: Question,
    asked: Sequence[str],
    compared: Set[str],
    n_left_out: int,
) -> Iterator[str]:
    level, alpha = percent(question.confidence), f"{1.0 - question.confidence:.2g}"
    yield (
        f"better: p < {alpha} and no interval reaches zero, neither over splits (corrected t) nor "
        "over poses (bootstrap). Where there is one split, or all are scored together, p is "
        "Wilcoxon's over poses, and the verdict is of these fits, not of another training. "
        f"equivalent: the difference is below {MM * question.rope:g} mm with {level} probability. "
        "Not told apart does not mean equal."
    )
    yield (
        "Each contest is a test of its own, p is not corrected for their number, nor for the "
        "number of pairs: of many pairs without a difference some are called better by chance. The "
        "place in the leaderboard is corrected. Bounds over poses are percentiles of the draws; "
        "`bench compare` computes BCa bounds, so that close calls may differ."
    )
    if alone := [name for name in asked if name not in compared]:
        yield f"Without a result to compare: {', '.join(alone)}."
    n_models = len(section.marks)
    if n_models > MOST_MODELS:
        yield f"The first {MOST_MODELS} of {n_models} models are compared; --model names others."
    if n_left_out:
        yield (
            f"{counted(n_left_out, 'contest')} of {len(section.fields)} not compared: there are "
            f"more than {MOST_PAIRS} pairs; --dataset, --protocol and --model name fewer."
        )
