"""Read statements: their tokens with places, the nesting of brackets, and the scope of names."""

from __future__ import annotations

import re
from collections import defaultdict
from collections.abc import Iterator, Sequence
from functools import cache
from typing import Any, NamedTuple

from lark import Lark, Token, Transformer
from lark.exceptions import LarkError

GRAMMAR = r"""
start: values
values: value ("," value)*
value: item*
item: INDEX | "(" values ")" -> round | "[" values "]" -> square | "{" values "}" -> curly
INDEX: "w"
"""
"""Nesting of a statement, of which each word and number is written as "w"."""
TOKEN = re.compile(r'"[^"\r\n]*"|[\[\](){},]|[^\s\[\](){},"]+|"')
NUMBER = re.compile(
    r"[+-]?(\d+(\.\d*)?|\.\d+)(E[+-]?\d+)?|'(?:B(?P<two>[01]{1,31})|H(?P<sixteen>[0-9A-F]{1,7}))'",
    re.IGNORECASE,
)
"""A number; KRL also has 'B010' and 'H2'."""
STRING = re.compile(r"\"[^\"\r\n]*\"")
WORD = re.compile(r"[A-Za-z_$]\w*")
LARGEST = 1e100
"""Larger numbers are neither lengths nor angles; squares of smaller ones are finite."""


def without_comments(text: str, comment: re.Pattern[str]) -> str:
    """Return a text with blanks in place of comments; `comment` matches strings, too."""
    return comment.sub(lambda match: match[0] if match[0][0] == '"' else " " * len(match[0]), text)


def without_strings(text: str) -> str:
    """Return a text with blanks in place of its strings."""
    return STRING.sub(lambda match: " " * len(match[0]), text)


class Number(NamedTuple):
    """A number in a program: its value and its place in the text."""

    value: float
    start: int
    end: int


class Group(NamedTuple):
    """A pair of brackets, and the values between its commas."""

    bracket: str
    values: tuple[Any, ...]


class _Nesting(Transformer[Token, Any]):
    """Turn a tree into values: each is a tuple of places of words and of groups."""

    def start(self, children: list[Any]) -> Any:
        return children[0]

    values = value = tuple

    def item(self, children: list[Any]) -> Any:
        return children[0]

    def INDEX(self, token: Token) -> int:
        return int(token.start_pos or 0)

    def round(self, children: list[Any]) -> Group:
        return Group("(", children[0])

    def square(self, children: list[Any]) -> Group:
        return Group("[", children[0])

    def curly(self, children: list[Any]) -> Group:
        return Group("{", children[0])


@cache
def _parser() -> Lark:
    return Lark(GRAMMAR, parser="lalr", transformer=_Nesting())


@cache
def _nesting(shape: str) -> tuple[Any, ...] | None:
    """Return the values of a shape such as "w{ww,ww},w"; None if its brackets do not close."""
    try:
        return _parser().parse(shape)  # type: ignore[return-value]
    except LarkError:
        return None


class Statement:
    """The values of a text between commas, with their places.

    Attributes:
        values: each is a tuple of numbers of tokens and of groups; () if brackets do not close.
    """

    def __init__(self, text: str, start: int) -> None:
        """Read a text that begins at the place `start`."""
        self.text, self.start = text, start
        self.tokens = [*TOKEN.finditer(text)]
        words = [token[0] for token in self.tokens]
        shape = "".join(word if word in "[](){}," else "w" for word in words)
        nesting = _nesting(shape)
        self.is_closed = nesting is not None
        self.values: tuple[Any, ...] = nesting or ()

    @property
    def only_value(self) -> Sequence[Any]:
        """Return the value of a text without commas outside of brackets; () for another text."""
        return self.values[0] if len(self.values) == 1 else ()

    def number(self, value: Sequence[Any]) -> Number | None:
        """Return the literal number that a value is; None for another value."""
        if len(value) != 1 or not isinstance(value[0], int):
            return None
        token = self.tokens[value[0]]
        match = NUMBER.fullmatch(token[0])
        if match is None:
            return None
        if match.lastgroup:
            number = float(int(match[match.lastgroup], 2 if match["two"] else 16))
        else:
            number = float(token[0])
        if not abs(number) < LARGEST:
            return None
        return Number(number, self.start + token.start(), self.start + token.end())

    def word(self, value: Sequence[Any]) -> str:
        """Return the words of a value up to its first bracket, without spaces."""
        words = []
        for item in value:
            if not isinstance(item, int):
                break
            words.append(self.tokens[item][0])
        return "".join(words)

    def name(self, value: Sequence[Any]) -> str:
        """Return a value that is a name, with a literal index if it has one; "" for another."""
        text = self.word(value)
        if len(value) == 2 and isinstance(value[1], Group) and value[1].bracket in "[":
            indices = [self.number(index) for index in value[1].values]
            if len(indices) == 1 and indices[0] and WORD.fullmatch(text):
                return f"{text}[{indices[0].value:g}]"
        is_name = all(isinstance(item, int) for item in value)
        return text if is_name and re.fullmatch(r"[A-Za-z_$][\w$.]*", text) else ""

    def parts(self) -> Iterator[tuple[str, int]]:
        """Yield the texts between the commas outside of brackets, with their places."""
        depth, begin = 0, 0
        for token in (*self.tokens, None):
            text = token[0] if token else ","
            depth += (text in "[({") - (text in "])}")
            if text == "," and not depth:
                end = token.start() if token else len(self.text)
                yield self.text[begin:end], self.start + begin
                begin = end + 1

    def group(self, value: Sequence[Any], bracket: str, word: str = "") -> tuple[Any, ...] | None:
        """Return the values of a value that is only a group, after a word; None for another."""
        if len(value) != 1 + bool(word) or not isinstance(value[-1], Group):
            return None
        is_group = value[-1].bracket == bracket and self.word(value).lower() == word
        return value[-1].values if is_group else None

    def numbers(self, value: Sequence[Any], bracket: str, word: str = "") -> list[Number] | None:
        """Return the literal numbers in brackets; None if there is another value."""
        values = self.group(value, bracket, word)
        numbers = [self.number(inner) for inner in values or [()]]
        return None if None in numbers else numbers  # type: ignore[return-value]


class Declared(NamedTuple):
    """A literal value of a name: its kind, statement, the value in it, and number of the text."""

    kind: str
    statement: Statement
    value: Sequence[Any]
    text_index: int = 0


class Names:
    """Names with literal values, by routine; a name that is assigned is a variable.

    Attributes:
        parameters: names of the parameters of each routine.
        takes_single: true if a name without a declared value has the value of its only assignment.
    """

    def __init__(self, takes_single: bool = False) -> None:
        self.takes_single = takes_single
        self._values: dict[tuple[str, str], Declared | None] = {}
        self._assigned: dict[tuple[str, str], list[tuple[Declared | None, str]]] = {}
        self._sources = defaultdict[str, set[str]](set)
        self.parameters = defaultdict[str, list[str]](list)

    def declare(self, routine: str, name: str, value: Declared | None = None) -> None:
        """Declare a name of a routine ("": of the file), with its literal value if it has one.

        A second declaration with a value makes it a variable.
        """
        key = (routine, name.lower())
        if self._values.get(key) is not None:
            self.assign(routine, name, None, "is declared twice")
        self._values[key] = value

    def declare_parameter(self, routine: str, name: str) -> None:
        """Declare a parameter of a routine; its value is not known."""
        self.declare(routine, name)
        self.assign(routine, name, None, "is a parameter")
        self.parameters[routine].append(name)

    def assign(self, routine: str, name: str, value: Declared | None, cause: str) -> None:
        """Note that a name is assigned, or may be; `cause` says how."""
        self._assigned.setdefault((routine, name.lower()), []).append((value, cause))

    def note_sources(self, name: str, text: str) -> None:
        """Note that the value of a name depends on the names in a text."""
        self._sources[name.lower()].update(word.lower() for word in WORD.findall(text))

    def finish(self) -> None:
        """Move assignments of names of the file from routines to the file."""
        for (routine, name), changes in [*self._assigned.items()]:
            if routine and (routine, name) not in self._values:
                self._assigned.setdefault(("", name), []).extend(changes)

    def is_local(self, routine: str, name: str) -> bool:
        """Return whether a name is declared in a routine."""
        return (routine, name.lower()) in self._values

    def is_used(self, routine: str, name: str) -> bool:
        """Return whether a name is declared or assigned in the file."""
        keys = {("", name.lower()), (routine, name.lower())}
        return not keys.isdisjoint(self._values) or not keys.isdisjoint(self._assigned)

    def find(self, routine: str, name: str) -> tuple[Declared | None, str]:
        """Return the literal value of a name in a routine, or else the cause why it has none."""
        name = name.lower()
        base = re.split(r"[\[.]", name)[0]
        scope = routine if self.is_local(routine, base) else ""
        declared = self._values.get((scope, name))
        changes = [*self._assigned.get((scope, base), [])]
        if self.takes_single and declared is None and len(changes) == 1 and changes[0][0]:
            return changes[0][0], ""
        if declared is None or changes:
            return None, changes[0][1] if changes else "is a variable"
        return declared, ""

    def literal(
        self, routine: str, statement: Statement, value: Sequence[Any]
    ) -> tuple[Declared | None, str]:
        """Return a value, or of a value that is a name the literal value, or the cause."""
        name = statement.name(value)
        return self.find(routine, name) if name else (Declared("", statement, value), "")

    def mentioned(self, text: str) -> Iterator[str]:
        """Yield the names in a text, and the names that their values depend on."""
        names, queue = set[str](), [word.lower() for word in WORD.findall(text)]
        while queue:
            if (name := queue.pop()) not in names:
                names.add(name)
                queue += self._sources.get(name, ())
                yield name
