"""Parse statements of a program, and return the places of their parts."""

from __future__ import annotations

from functools import cache

from lark import Lark, Token, Tree
from lark.exceptions import LarkError

from stiff_apply.programs.program_file import Number, StatementError

Part = Tree[Token] | Token
"""A part of a statement; a tree begins and ends with a token."""


@cache
def _parser(grammar: str) -> Lark:
    return Lark(grammar, parser="lalr")


def parsed_statement(
    grammar: str, text: str, start: int, valid: str, text_index: int = 0
) -> Tree[Token]:
    """Return the tree of a statement.

    Args:
        grammar: grammar of the language.
        text: the statement.
        start: its place in the program.
        valid: expected statement, for the error.
        text_index: number of the program's text.

    Raises:
        StatementError: the statement cannot be read.
    """
    try:
        return _parser(grammar).parse(text).children[0]  # type: ignore[return-value]
    except LarkError as error:
        raise StatementError(start, text, valid, text_index) from error


def part_place(part: Part, start: int) -> tuple[int, int]:
    """Return the place of a part of the statement at `start`, with its brackets."""
    first, last = part, part
    if isinstance(part, Tree):
        first, last = part.children[0], part.children[-1]
    return start + int(first.start_pos), start + int(last.end_pos)  # type: ignore[union-attr,arg-type]


def number_of(token: Token, start: int) -> Number:
    """Return a literal number of the statement at `start`."""
    return Number(float(token), *part_place(token, start))
