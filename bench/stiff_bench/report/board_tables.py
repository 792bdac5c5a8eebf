"""The tables of a leaderboard, ready for the page."""

from __future__ import annotations

from stiff_bench.leaderboard import Leaderboard, Section
from stiff_bench.leaderboard_tables import section_tables
from stiff_bench.report.content import Block
from stiff_bench.report.sorting import page_table


def board_block(section: Section, board: Leaderboard, *, heading: str, command: str) -> Block:
    """Return ranks, scores by protocol, critical differences and costs of one section."""
    first, *others = section_tables(section, board, ())
    return Block(
        heading,
        tables=[page_table(first, command=command), *(page_table(text) for text in others)],
    )
