"""Write tables for a terminal: never wider than it, and readable without colours.

A wide table is divided into blocks of columns below each other. Each block repeats the first
column. Texts of third parties are never interpreted as markup.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from itertools import groupby
from textwrap import fill
from typing import TYPE_CHECKING, Any

from stiff_bench.console import one_line
from stiff_bench.tables.table import BEST_MARK, Column, Entry, Table, quantity

if TYPE_CHECKING:
    from rich.console import Console

SMALLEST_WIDTH, USUAL_WIDTH = 60, 100
"""Smallest supported width of a terminal, and width of an unknown terminal, in characters."""
LONG_TEXT = 24
"""Width in characters above which a text column may get line breaks."""
ONE_LINE = 10
"""Longest heading without line breaks, in characters."""
GAP = 2
BETTER, WORSE = "green", "red"


def screen_console(width: int | None = None, *, colors: bool | None = None) -> Console:
    """Return a console that keeps its text for `screen_of`.

    Args:
        width: width in characters; None: width of the terminal.
        colors: True for colours; None: as the terminal of standard output supports.
    """
    from rich.console import Console

    console = Console(
        force_terminal=colors or None,
        color_system="standard" if colors else "auto" if colors is None else None,
        highlight=False,
        markup=False,
        emoji=False,
        legacy_windows=False,
        force_jupyter=False,  # else a notebook shows each line as an output
    )
    usual = console.width if console.is_terminal else USUAL_WIDTH
    console.width = max(width or usual, SMALLEST_WIDTH)
    console.begin_capture()
    return console


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
    return "\n".join(line.rstrip() for line in console.end_capture().rstrip("\n").split("\n"))


def print_lines(console: Console, text: str, style: str = "") -> None:
    """Print a text with line breaks between words."""
    from rich.text import Text

    console.print(Text(one_line(text).replace("`", ""), style=style))


def print_table(console: Console, table: Table) -> None:
    """Print title, blocks of columns and notes."""
    if table.title:
        print_lines(console, table.title, style="bold")
    widths = [_width(table, number) for number in range(len(table.columns))]
    least = [_least_width(table, number, widths, console.width) for number in range(len(widths))]
    for block in _blocks(table, least, console.width):
        console.print()
        console.print(_rich_table(table, widths, least, block))
    if table.notes:
        console.print()
    for note in table.notes:
        print_lines(console, note, style="dim")


def _width(table: Table, number: int) -> int:
    """Return the width of a column in characters: its longest cell or word of the heading."""
    from rich.cells import cell_len

    column = table.columns[number]
    heading = table.heading(column)
    words = [*column.group.split(), *([heading] if len(heading) <= ONE_LINE else heading.split())]
    cells = [_cell_text(column, row[number]) for row in table.rows]
    return max(map(cell_len, [*words, *cells]), default=1)


def _least_width(table: Table, number: int, widths: Sequence[int], width: int) -> int:
    """Return the width to which a column may be narrowed; names only if they fill the screen."""
    may_be_narrower = table.columns[number].kind == "text" and (number or widths[0] > width * 0.6)
    return min(widths[number], LONG_TEXT) if may_be_narrower else widths[number]


def _blocks(table: Table, least: Sequence[int], width: int) -> Iterator[list[int]]:
    """Yield the column numbers of each block; a group that fits a block is not divided."""
    if not least:
        return
    block, spare = [0], width - least[0]
    numbers = range(1, len(least))
    for _, members in groupby(numbers, lambda number: table.columns[number].group or number):
        group = [*members]
        is_whole = sum(least[number] + GAP for number in group) <= width - least[0]
        for part in [group] if is_whole else [[number] for number in group]:
            needed = sum(least[number] + GAP for number in part)
            if len(block) > 1 and needed > spare:
                yield block
                block, spare = [0], width - least[0]
            block += part
            spare -= needed
    yield block


def _rich_table(
    table: Table, widths: Sequence[int], least: Sequence[int], block: Sequence[int]
) -> Any:
    from rich import box
    from rich import table as rich_table
    from rich.text import Text

    made = rich_table.Table(box=box.SIMPLE_HEAD, show_edge=False, padding=(0, GAP - 1, 0, 0))
    made.pad_edge = False
    above = ""
    for number in block:
        column = table.columns[number]
        group = "" if column.group == above else column.group
        above = column.group or above
        lines = filter(None, (group, table.heading(column)))
        made.add_column(
            Text("\n".join(fill(line, widths[number]) for line in lines), style="bold"),
            justify="left" if column.kind == "text" else "right",
            min_width=least[number],
            no_wrap=least[number] == widths[number],
            overflow="fold",
        )
    for row in table.rows:
        cells = [_cell(table.columns[number], row[number]) for number in block]
        if table.best_first and row is table.rows[0]:
            cells[0].stylize(f"bold {BETTER}")
        made.add_row(*cells)
    return made


def _is_best(entry: Entry) -> bool:
    number = quantity(entry)
    return number is not None and BEST_MARK in number.mark


def _cell_text(column: Column, entry: Entry) -> str:
    """Return a cell as text; the mark of the best is in front, so that numbers stay aligned."""
    text = one_line(column.text(entry))
    return f"{BEST_MARK} {text.removesuffix(BEST_MARK).rstrip()}" if _is_best(entry) else text


def _cell(column: Column, entry: Entry) -> Any:
    """Return a cell; the best of a column is bold, changes are coloured."""
    from rich.text import Text

    number = quantity(entry)
    style = ""
    if _is_best(entry):
        style = f"bold {BETTER}"
    elif number is not None and column.by_sign and number.order:
        style = BETTER if number.order * column.by_sign > 0.0 else WORSE
    return Text(_cell_text(column, entry), style=style)
