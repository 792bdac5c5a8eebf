"""Write tables for a terminal: never wider than it, and readable without colours.

A wide table is divided into blocks of columns below each other. Each block repeats the first
column. Texts of third parties are never interpreted as markup.
"""

from __future__ import annotations

import io
import os
from collections.abc import Iterator, Sequence
from itertools import groupby
from typing import TYPE_CHECKING, Any

from stiff_bench.console import one_line
from stiff_bench.store.names import OPTION_MARK
from stiff_bench.tables.table import BEST_MARK, Column, Entry, Table, quantity

if TYPE_CHECKING:
    from rich.console import Console

SMALLEST_WIDTH, USUAL_WIDTH = 60, 100
"""Smallest supported width of a terminal, and width of an unknown terminal, in characters."""
LONG_TEXT = 24
"""Width in characters above which a text column may get line breaks; names are broken last."""
ONE_LINE = 10
"""Longest heading without line breaks, in characters."""
GAP = 2
BETTER, WORSE = "green", "red"


def screen_console(width: int | None = None, *, colors: bool | None = None) -> Console:
    """Return a console that writes into memory.

    Args:
        width: width in characters; None: width of the terminal.
        colors: True for colours; None: as the terminal of standard output supports.
    """
    from rich.console import Console

    terminal = Console(soft_wrap=False)
    has_colors = terminal.is_terminal and terminal.color_system is not None
    if colors is None:
        colors = has_colors and "NO_COLOR" not in os.environ
    characters = width or (terminal.width if terminal.is_terminal else USUAL_WIDTH)
    return Console(
        file=io.StringIO(),
        width=max(characters, SMALLEST_WIDTH),
        force_terminal=colors,
        color_system="standard" if colors else None,
        no_color=not colors,
        highlight=False,
        markup=False,
        emoji=False,
        legacy_windows=False,
        force_jupyter=False,  # else a notebook shows each line as an output
    )


def screen_text(tables: Sequence[Table], *, text: str = "", console: Console | None = None) -> str:
    """Return tables for a terminal, below a `text`."""
    console = console or screen_console()
    if text:
        print_lines(console, text, style="bold")
        console.print()
    for number, table in enumerate(tables):
        if number:
            console.print()
        print_table(console, table.visible_table())
    return screen_of(console)


def screen_of(console: Console) -> str:
    """Return the text printed on a console of `screen_console`."""
    assert isinstance(console.file, io.StringIO)
    return "\n".join(line.rstrip() for line in console.file.getvalue().rstrip("\n").split("\n"))


def print_lines(console: Console, text: str, style: str = "") -> None:
    """Print a text with line breaks between words."""
    from rich.text import Text

    console.print(Text(one_line(text).replace("`", ""), style=style))


def print_table(console: Console, table: Table) -> None:
    """Print title, blocks of columns and notes."""
    if table.title:
        print_lines(console, table.title, style="bold")
    for block in _blocks(table, console.width):
        console.print()
        console.print(_rich_table(table, block))
    if table.notes:
        console.print()
    for note in table.notes:
        print_lines(console, note, style="dim")


def _blocks(table: Table, width: int) -> Iterator[dict[int, int]]:
    """Yield the columns of each block: widths in characters by column number."""
    widths = [_column_width(table, number) for number in range(len(table.columns))]
    if not widths:
        return
    spare = width - sum(widths) - GAP * len(widths)
    texts = [n for n in range(1, len(widths)) if table.columns[n].kind == "text"]
    for number in (
        *sorted(texts, key=lambda n: -widths[n]),
        0,
    ):  # the widest text column is narrowed first
        if spare < 0 and widths[number] > LONG_TEXT:
            narrower = max(LONG_TEXT, widths[number] + spare)
            spare += widths[number] - narrower
            widths[number] = narrower
    block = {0: widths[0]}
    numbers = range(1, len(widths))
    for _, of_group in groupby(numbers, lambda number: table.columns[number].group or number):
        group = [*of_group]
        needed = sum(widths[number] + GAP for number in group)
        room = width - sum(block.values()) - GAP * len(block)
        if len(block) > 1 and needed > room and needed <= width - widths[0] - GAP:
            yield block  # a group that fits a block is not divided
            block = {0: widths[0]}
        for number in group:
            room = width - sum(block.values()) - GAP * len(block)
            if len(block) > 1 and widths[number] + GAP > room:
                yield block
                block = {0: widths[0]}
            block[number] = min(widths[number], width - widths[0] - 2 * GAP)
    yield block


def _column_width(table: Table, number: int) -> int:
    """Return the width of a column: its longest cell or word of the heading."""
    from rich.cells import cell_len

    column = table.columns[number]
    heading = table.heading(column)
    words = [*column.group.split(), *([heading] if len(heading) <= ONE_LINE else heading.split())]
    cells = [one_line(column.text(row[number])) for row in table.rows]
    if any(_is_best(row[number]) for row in table.rows):
        cells = [cell if BEST_MARK in cell else f"{cell} {BEST_MARK}" for cell in cells]
    return max(map(cell_len, [*words, *cells]), default=1)


def _rich_table(table: Table, block: dict[int, int]) -> Any:
    from rich import box
    from rich import table as rich_table
    from rich.text import Text

    made = rich_table.Table(box=box.SIMPLE_HEAD, show_edge=False, padding=(0, GAP - 1, 0, 0))
    made.pad_edge = False
    above = ""
    for number, width in block.items():
        column = table.columns[number]
        group = "" if column.group == above else column.group
        above = column.group or above
        heading = "\n".join(filter(None, (group, table.heading(column))))
        made.add_column(
            Text(heading, style="bold"),
            justify="right" if column.kind == "number" else "left",
            width=width,
            overflow="fold",
        )
    for row in table.rows:
        cells = [_cell(table.columns[n], row[n], width) for n, width in block.items()]
        if table.best_first and row is table.rows[0]:
            cells[0].stylize(f"bold {BETTER}")
        made.add_row(*cells)
    return made


def _is_best(entry: Entry) -> bool:
    number = quantity(entry)
    return number is not None and BEST_MARK in number.mark


def _cell(column: Column, entry: Entry, width: int) -> Any:
    """Return a cell; the best of a column is bold, changes are coloured."""
    from rich.text import Text

    text = one_line(column.text(entry))
    if column.kind == "text" and len(text) > width:
        text = text.replace(OPTION_MARK, f"\n{OPTION_MARK}")
    number = quantity(entry)
    style = ""
    if _is_best(entry):  # mark in front, so that numbers stay aligned
        text = f"{BEST_MARK} {text.removesuffix(BEST_MARK).rstrip()}"
        style = f"bold {BETTER}"
    elif number is not None and column.by_sign and number.order:
        style = BETTER if number.order * column.by_sign > 0.0 else WORSE
    return Text(text, style=style)
