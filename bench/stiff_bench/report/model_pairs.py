"""Table of all pairs of models, with cases won and lost.

Leaderboards count the same verdicts as "tied with best".
"""

from __future__ import annotations

from collections import Counter
from itertools import permutations

from stiff_bench.analysis.leaderboard import Leaderboard, Section
from stiff_bench.analysis.scored_case import correction_text
from stiff_bench.analysis.verdict import Verdict
from stiff_bench.tables.table import Column, Entry, Name, Quantity, Table

MOST_PAIRS = 10_000
"""Largest number of comparisons per section, which take some seconds."""
MOST_MODELS = 40
"""Largest number of models in the table."""


def pair_table(section: Section, board: Leaderboard) -> Table:
    """Return a table of verdicts, with a row and a column per model."""
    counts, n_left_out = _counts(section)
    models = [name for name in section.models if any(name in pair for pair in counts)]
    numbers = [str(number) for number in range(1, len(models) + 1)]
    rows: list[list[Entry]] = [
        [
            Name(f"{number} {row}", section.answer.mark(row)),
            *(_difference(counts.get((row, column))) for column in models),
        ]
        for number, row in zip(numbers, models, strict=True)
    ]
    notes = [
        "5 : 1 in a row: better than the column's model in 5 comparisons, worse in 1; "
        f"{correction_text(section.cases)}."
    ]
    if len(section.models) > MOST_MODELS:
        notes.append(
            f"The first {MOST_MODELS} of {len(section.models)} models; select others with --model."
        )
    if n_left_out:
        notes.append(
            f"{n_left_out} of {len(section.cases)} data sets and protocols are left out: more "
            f"than {MOST_PAIRS} comparisons."
        )
    return Table(
        f"Pairs of models, {board.key.text}: comparisons won and lost",
        [
            Column("model", "text"),
            *(Column(number, format=_won_and_lost, by_sign=1) for number in numbers),
        ],
        rows,
        notes,
    )


def _counts(section: Section) -> tuple[dict[tuple[str, str], Counter[Verdict]], int]:
    """Return (row, column) -> verdicts, and the number of cases beyond `MOST_PAIRS`."""
    counts: dict[tuple[str, str], Counter[Verdict]] = {}
    compared_models, n_remaining = section.models[:MOST_MODELS], MOST_PAIRS
    for number, scored in enumerate(section.cases):
        pairs = list(permutations((name for name in compared_models if name in scored.scores), 2))
        n_remaining -= len(pairs) // 2
        if n_remaining < 0:
            return counts, len(section.cases) - number
        verdicts = scored.verdicts(pairs) if pairs else None
        for pair, verdict in zip(pairs, verdicts or (), strict=False):
            counts.setdefault(pair, Counter())[verdict] += 1
    return counts, 0


def _difference(count: Counter[Verdict] | None) -> Quantity | None:
    """Return wins minus losses of the row against the column, and both numbers."""
    if count is None:
        return None
    return Quantity(count["a"] - count["b"], share=(count["a"], count["b"]))


def _won_and_lost(difference: Quantity) -> str:
    return " : ".join(map(str, difference.share or ()))
