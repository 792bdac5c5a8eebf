"""Read URScript: targets of a .script program, in m and rad, with rotation vectors.

A pose p[x, y, z, rx, ry, rz] places the tool frame of `set_tcp` in the robot's base frame
(Universal Robots, script manual, module motion). It has no configuration: the arm keeps the
configuration of the previous joint angles.
"""

from __future__ import annotations

import re
from collections import Counter
from collections.abc import Iterator, Mapping, Sequence

from lark import Token, Tree

from stiff_apply.programs.program_file import (
    NO_FRAME,
    Frame,
    Language,
    LeftMotion,
    Number,
    StatementError,
    Target,
)
from stiff_apply.programs.statements import number_of, parsed_statement, part_place
from stiff_datasets.measured.rotations import vector_rotations

GRAMMAR = r"""
start: call | assignment
call: CALL argument ("," argument)* ")"
assignment: SCOPE? NAME "=" value
argument: (NAME "=")? value
?value: pose | joints | NUMBER | NAME | EXPRESSION | OTHER
pose: POSE_OPEN value ("," value)* CLOSE
joints: OPEN value ("," value)* CLOSE

SCOPE.3: /(global|local)\b/
CALL.3: /(movel|movej|movep|movec|set_tcp)\s*\(/
POSE_OPEN.3: /p\s*\[/
OPEN: "["
CLOSE: "]"
NUMBER.2: /[+-]?(\d+(\.\d*)?|\.\d+)(e[+-]?\d+)?(?=\s*[,\])]|\s*$)/i
EXPRESSION.1: /[A-Za-z_]\w*\s*(\((?:[^()]|\([^()]*\))*\)|\[[^\]]*\])/
NAME: /[A-Za-z_]\w*/
OTHER.-1: /[^\s\[\],()=][^\[\],()=]*/
%ignore /\s+/
"""
CALLS = r"\((?:[^()#\r\n]|\((?:[^()#\r\n]|\([^()#\r\n]*+\))*+\))*+\)"
STATEMENT = re.compile(
    r"^[ \t]*(?P<text>"
    rf"(?P<motion>(?:move|servo|speed|force|path_)(?:[a-z]\w*)?)[ \t]*{CALLS}"
    rf"|(?P<tcp>set_tcp[ \t]*{CALLS})"
    r"|(?P<data>(?:(?:global|local)[ \t]+)?(?P<name>\w+)[ \t]*=(?!=)[^#\r\n]*)"
    r"|(?P<flow>(?:if|elif|else|end|while|for|def|thread|return|break|goto)\b"
    r"|(?!set_|sleep|sync|textmsg|popup|write_|stop)\w+[ \t]*\())",
    re.MULTILINE,
)
VALID = "p[x,y,z,rx,ry,rz] in m and rad, or [q1,..,q6] in rad"


def _parsed(text: str, start: int) -> Tree[Token]:
    """Return the tree of a statement; StatementError if it cannot be read."""
    return parsed_statement(GRAMMAR, text, start, f"e.g. movel({VALID}, a=1.2, v=0.25)")


def read(texts: Sequence[str]) -> Iterator[Target | LeftMotion]:
    """Yield the motions of a program."""
    (text,) = texts
    data = dict(_declarations(text))
    tool, follows = Frame("set_tcp", ()), False
    for match in STATEMENT.finditer(text):
        start, statement = match.start("text"), match["text"]
        if match["motion"]:
            for motion in _motions(match["motion"], statement, start, data):
                if isinstance(motion, LeftMotion):
                    follows &= "helper" in motion.reason
                    yield motion
                else:
                    yield motion._replace(tool=tool, follows=follows)
                    follows = True
        elif match["tcp"]:
            value = _value(_parsed(statement, start).children[1])
            numbers = _numbers(value, start) if isinstance(value, Tree) else None
            if isinstance(value, Tree) and numbers is None:
                raise StatementError(start, statement, "set_tcp(p[x,y,z,rx,ry,rz])")
            tool = Frame("set_tcp", tuple(number.value for number in numbers or ()))
        elif match["flow"]:
            follows = False


def _declarations(text: str) -> Iterator[tuple[str, tuple[Tree[Token], int]]]:
    """Yield names assigned only once, with their literal pose or joint angles."""
    matches = [match for match in STATEMENT.finditer(text) if match["data"]]
    counts = Counter(match["name"] for match in matches)
    for match in matches:
        literal = re.search(r"=\s*(p\s*)?\[", match["data"])
        if counts[match["name"]] == 1 and literal:
            start = match.start("text")
            value = _parsed(match["data"], start).children[-1]
            if isinstance(value, Tree):
                yield match["name"], (value, start)


def _motions(
    word: str, text: str, start: int, data: Mapping[str, tuple[Tree[Token], int]]
) -> Iterator[Target | LeftMotion]:
    """Yield the helper point and the target of a motion."""
    if word not in ("movel", "movej", "movep", "movec"):
        reason = f"{word} is not read (movel, movej, movep and movec are)"
        yield LeftMotion(start, text, reason)
        return
    arguments = _parsed(text, start).children[1:]
    if word == "movec":
        yield LeftMotion(start, text, "helper point of a circular motion")
    if len(arguments) <= (word == "movec"):
        raise StatementError(start, text, f"{word}({VALID}, ...)")
    value = _value(arguments[word == "movec"])
    place, offset = part_place(value, start), start
    if isinstance(value, Token):
        name = value.strip()
        if value.type != "NAME" or name not in data:
            reason = "a variable" if value.type == "NAME" else "an expression"
            yield LeftMotion(start, text, f"target {name} is {reason}")
            return
        value, offset = data[name]
    numbers = _numbers(value, offset)
    if numbers is None:
        yield LeftMotion(start, text, "the target has an expression")
        return
    if len(numbers) != 6:
        raise StatementError(start, text, f"6 numbers, {VALID}")
    yield Target(
        start,
        start + len(text),
        *place,
        is_linear=word in ("movel", "movep"),
        follows=False,
        has_joints=value.data == "joints",
        numbers=numbers,
        config=(),
        base=Frame("base", NO_FRAME),
        tool=Frame("set_tcp", ()),
    )


def _value(argument: Tree[Token] | Token) -> Tree[Token] | Token:
    """Return the value of an argument of a call."""
    return argument.children[-1] if isinstance(argument, Tree) else argument


def _numbers(value: Tree[Token] | Token, start: int) -> list[Number] | None:
    """Return the numbers of a pose or of joint angles; None if one is an expression."""
    tokens = value.children[1:-1] if isinstance(value, Tree) else []
    numbers = []
    for token in tokens:
        if isinstance(token, Tree) or token.type != "NUMBER":
            return None
        numbers.append(number_of(token, start))
    return numbers


LANGUAGE = Language(
    name="URScript",
    companion="",
    metres=1.0,
    radians=1.0,
    n_turns=3,
    decimals=(7, 7, 7),
    read=read,
    to_rotations=vector_rotations,
    configurations=None,
)
