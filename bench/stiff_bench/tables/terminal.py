"""Write tables for a terminal: never wider than it, and readable without colours.

A wide table is divided into blocks of columns below each other. Each block repeats the first
column. Texts of third parties are never interpreted as markup.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from typing import TYPE_CHECKING

from stiff_bench.console import one_line
from stiff_bench.tables.table import BEST_MARK, Column, Entry, Table, quantity

if TYPE_CHECKING:
    from rich.console import Console
    from rich.text import Text

SMALLEST_WIDTH, USUAL_WIDTH = 60, 100
"""Smallest supported width of a terminal, and width of an unknown terminal, in characters."""
LONG_TEXT = 24
"""Width in characters above which a text column may get line breaks."""
ONE_LINE = 10
"""Longest heading without line breaks, in characters."""
GAP = 2


def screen_text(
    tables: Sequence[Table], *, text: str = "", width: int | None = None, colors: bool | None = None
) -> str:
    """Return tables for a terminal, below a `text`.

    Args:
        tables: tables in their order.
        text: paragraph above the tables.
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
        force_jupyter=False,  # else a notebook shows each line as an output
    )
    usual = console.width if console.is_terminal else USUAL_WIDTH
    console.width = max(width or usual, SMALLEST_WIDTH)
    with console.capture() as capture:
        if text:
            print_lines(console, text, style="bold")
            console.print()
        for number, table in enumerate(tables):
            if number:
                console.print()
            print_table(console, table.visible_table())
    return "\n".join(line.rstrip() for line in capture.get().rstrip("\n").split("\n"))


def print_lines(console: Console, text: str, style: str = "") -> None:
    """Print a text with line breaks between words."""
    from rich.text import Text

    console.print(Text(one_line(text).replace("`", ""), style=style))


def print_table(console: Console, table: Table) -> None:
    """Print title, blocks of columns and notes.

    Numbers and names are not broken. A long text may be, and a name that fills the screen.
    """
    from rich import box
    from rich.cells import cell_len
    from rich.table import Table as RichTable
    from rich.text import Text

    if table.title:
        print_lines(console, table.title, style="bold")
    cells = [
        [_cell(column, cell) for column, cell in zip(table.columns, row, strict=True)]
        for row in table.rows
    ]
    headings, widths, least = table.headings(), list[int](), list[int]()
    for number, (column, heading) in enumerate(zip(table.columns, headings, strict=True)):
        words = [heading] if len(heading) <= ONE_LINE else heading.split()
        widths.append(max([*map(cell_len, words), *(row[number].cell_len for row in cells)]))
        may_break = column.kind == "text" and (number or widths[0] > console.width * 0.6)
        least.append(min(widths[number], LONG_TEXT) if may_break else widths[number])
    for block in _blocks(least, console.width):
        made = RichTable(
            box=box.SIMPLE_HEAD, show_edge=False, pad_edge=False, padding=(0, GAP - 1, 0, 0)
        )
        for number in block:
            is_fixed = least[number] == widths[number]
            made.add_column(
                Text(headings[number], style="bold", no_wrap=False),
                justify="left" if table.columns[number].kind == "text" else "right",
                width=widths[number] if is_fixed else None,
                min_width=least[number],
                no_wrap=is_fixed,
                overflow="fold",
            )
        for row in cells:
            made.add_row(*(row[number] for number in block))
        console.print()
        console.print(made)
    if table.notes:
        console.print()
    for note in table.notes:
        print_lines(console, note, style="dim")


def _blocks(widths: Sequence[int], width: int) -> Iterator[list[int]]:
    """Yield the column numbers of each block of at most `width` characters."""
    block, spare = [0], width - widths[0]
    for number, needed in enumerate(widths[1:], start=1):
        if len(block) > 1 and needed + GAP > spare:
            yield block
            block, spare = [0], width - widths[0]
        block.append(number)
        spare -= needed + GAP
    yield block


def _cell(column: Column, entry: Entry) -> Text:
    """Return a cell; the best of a column is bold, changes are coloured.

    The mark of the best is in front, so that numbers stay aligned.
    """
    from rich.text import Text

    text, number = one_line(column.text(entry)), quantity(entry)
    if number is None or number.order is None:
        return Text(text)
    if BEST_MARK in number.mark:
        return Text(f"{BEST_MARK} {text.removesuffix(BEST_MARK).rstrip()}", style="bold green")
    if column.is_change and number.order:
        return Text(text, style="green" if number.order < 0.0 else "red")
    return Text(text)
