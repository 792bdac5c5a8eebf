r"""Read ABB RAPID: targets of a module, and its targets, tools and work objects.

Lengths are in mm, joint angles in deg, orientations quaternions, w first. Each robtarget has a
configuration [cf1, cf4, cf6, cfx] (Technical reference manual: RAPID instructions, functions and
data types, "confdata"): with `ConfL\On`, the default, a controller stops if it does not fit.
"""

from __future__ import annotations

import math
import re
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from lark import Token, Tree

from stiff_apply.programs.program_file import (
    NEAR_ZERO,
    Frame,
    Language,
    LeftMotion,
    Number,
    StatementError,
    Target,
)
from stiff_apply.programs.statements import parsed_statement, part_place
from stiff_datasets.measured.rotations import quaternion_rotations, quaternions
from stiff_protocols.contract.types import FloatArray

REAL = r"[+-]?(\d+(\.\d*)?|\.\d+)(E[+-]?\d+)?"
GRAMMAR = r"""
start: motion | data
motion: MOTION option* ","? argument ("," argument)* ";"
data: NAME+ ":=" value ";"
argument: value option*
option: "\\" NAME (":=" value)?
?value: array | NUMBERS | NUMBER | NAME | EXPRESSION | OTHER
array: OPEN value ("," value)* CLOSE

OPEN: "["
CLOSE: "]"
NUMBERS.3: /\[\s*REAL(\s*,\s*REAL)*\s*\]/i
MOTION.3: /Move(L|J|AbsJ|C)\b/i
NUMBER.2: /[+-]?(\d+(\.\d*)?|\.\d+)(E[+-]?\d+)?(?=\s*[,\]\\;])/i
EXPRESSION.1: /[A-Z_]\w*\s*(\((?:[^()]|\([^()]*\))*\)|\{[^}]*\}|\.)[\w.]*/i
NAME: /[A-Z_]\w*/i
OTHER.-1: /[^\s\[\],;\\][^\[\],;\\]*/
COMMENT: /![^\r\n]*/
%ignore COMMENT
%ignore /\s+/
""".replace("REAL", REAL)
REST_OF_LINE = r"(?:\"(?:[^\"\r\n]|\"\")*+\"|![^\r\n]*+|[^;\"!])*+;"
STATEMENT = re.compile(
    r"![^\r\n]*+|\"(?:[^\"\r\n]|\"\")*+\""
    r"|(?:^|(?<=;))[ \t]*(?P<text>"
    rf"(?P<motion>(?:Move|Trigg|Arc|Search|Paint|Disp|Spot)(?:L|J|AbsJ|C)\w*)\b{REST_OF_LINE}"
    rf"|(?P<data>(?:(?:LOCAL|TASK)\s+)*(?:CONST|PERS|VAR)\s+"
    rf"(?P<type>robtarget|jointtarget|tooldata|wobjdata)\s+(?P<name>\w+)\s*:={REST_OF_LINE})"
    rf"|(?P<conf>Conf[LJ]\s*\\\s*(?:On|Off))\s*;"
    r"|(?P<assigned>\w++)[\w.{}]*+\s*+:="
    r"|(?P<harmless>(?:Set|Reset|Wait|TP|AccSet|VelSet|SingArea|Grip|Pulse|Incr|Decr|Clk|Conf|CONST"
    r"|PERS|VAR|LOCAL|TASK)\w*)\b"
    r"|(?P<flow>[A-Z_]\w*))",
    re.IGNORECASE | re.MULTILINE,
)
NUMBER = re.compile(REAL, re.IGNORECASE)
VALID_POSE = "[[x,y,z],[q1,q2,q3,q4],[cf1,cf4,cf6,cfx],[external axes]]"
VALID_JOINTS = "[[j1,..,j6],[external axes]]"
LITERALS = {"robtarget": VALID_POSE, "jointtarget": VALID_JOINTS}
KNOWN_FRAMES = {"tool0": (0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0)}
KNOWN_FRAMES["wobj0"] = KNOWN_FRAMES["tool0"]
LARGEST_MM, UNIT_LENGTH_SLACK = 1e6, 1e-3
"""Limit of a frame's position, and tolerance of a quaternion's length, which is 1."""


@dataclass(frozen=True)
class _Data:
    """Declared data: the value, and the start of its statement."""

    kind: str
    value: Tree[Token] | Token
    start: int
    text: str


def read(texts: Sequence[str]) -> Iterator[Target | LeftMotion]:
    """Yield the motions of a module."""
    (text,) = texts
    data, assigned = _declarations(text)
    frames: dict[str, Frame] = {}
    binds, follows = {"L": True, "J": True}, False
    for match in STATEMENT.finditer(text):
        start, statement = match.start("text"), match["text"]
        if match["motion"]:
            for motion in _motions(match["motion"], statement, start, data, assigned, frames):
                if isinstance(motion, LeftMotion):
                    follows &= "helper" in motion.reason
                    yield motion
                    continue
                is_bound = binds["L" if motion.is_linear else "J"]
                config = motion.config if is_bound else ()
                yield motion._replace(config=config, follows=follows)
                follows = True
        elif match["conf"]:
            binds[match["conf"][4].upper()] = match["conf"].upper().endswith("ON")
        elif match["flow"]:
            follows = False


def _declarations(text: str) -> tuple[dict[str, _Data], set[str]]:
    """Return data by name, and the names that the program assigns."""
    data, assigned = {}, set[str]()
    for match in STATEMENT.finditer(text):
        if match["data"]:
            start, kind = match.start("text"), match["type"].lower()
            valid = LITERALS.get(kind, f"a literal {kind}")
            value = parsed_statement(GRAMMAR, match["data"], start, valid).children[-1]
            data[match["name"].lower()] = _Data(kind, value, start, match["data"])
        elif match["assigned"]:
            assigned.add(match["assigned"].lower())
    return data, assigned


def _motions(
    word: str,
    text: str,
    start: int,
    data: Mapping[str, _Data],
    assigned: set[str],
    frames: dict[str, Frame],
) -> Iterator[Target | LeftMotion]:
    """Yield the helper point and the target of a motion."""
    kind = word.lower()
    if kind not in ("movel", "movej", "moveabsj", "movec"):
        yield LeftMotion(start, text, f"{word} is not read (MoveL, MoveJ, MoveAbsJ and MoveC are)")
        return
    valid = f"{word} {VALID_JOINTS if kind == 'moveabsj' else 'p10'}, v100, z10, tool1;"
    tree = parsed_statement(GRAMMAR, text, start, valid)
    arguments = [*tree.find_pred(lambda node: node.data == "argument")]
    arguments.sort(key=lambda node: part_place(node.children[0], 0))
    if len(arguments) < 4 + (kind == "movec"):
        raise StatementError(start, text, valid)
    if kind == "movec":
        yield LeftMotion(start, text, "helper point of a circular motion")
    goal, last = arguments[1 if kind == "movec" else 0], arguments[-1]
    place = part_place(goal.children[0], start)
    value, offset, kind_of_data = goal.children[0], start, ""
    if isinstance(value, Token):
        name = str(value).strip()
        if value.type != "NAME":
            yield LeftMotion(start, text, f"target {name} is an expression")
            return
        declared = data.get(name.lower())
        if declared is None or name.lower() in assigned:
            reason = "is a variable" if declared is None else "is assigned in the program"
            yield LeftMotion(start, text, f"target {name} {reason}")
            return
        value, offset, kind_of_data = declared.value, declared.start, declared.kind
    has_joints = kind == "moveabsj"
    expected_kind = "jointtarget" if has_joints else "robtarget"
    if kind_of_data and kind_of_data != expected_kind:
        raise StatementError(start, text, f"a {expected_kind}, {LITERALS[expected_kind]}")
    rows = _rows(value, offset, text, expected_kind)
    tool_option = last.children[0]
    base = "wobj0"
    for option in last.children[1:]:
        if isinstance(option, Tree) and str(option.children[0]).lower() == "wobj":
            base = str(option.children[1]).strip()
    yield Target(
        start,
        start + len(text),
        *place,
        is_linear=kind == "movel",
        follows=False,
        has_joints=has_joints,
        numbers=rows[0] if has_joints else (*rows[0], *rows[1]),
        config=() if has_joints or kind == "movec" else rows[2],
        base=_frame(base, "wobjdata", data, frames),
        tool=_frame(str(tool_option).strip(), "tooldata", data, frames),
    )


def _rows(value: Tree[Token] | Token, start: int, text: str, kind: str) -> list[list[Number]]:
    """Return the rows of numbers of a robtarget or jointtarget."""
    rows = [_numbers(row, start) for row in _inner(value)]
    counts = [6, 6] if kind == "jointtarget" else [3, 4, 4, 6]
    if [len(row) for row in rows] != counts:
        raise StatementError(start, text, LITERALS[kind])
    if kind == "robtarget":
        _check_quaternion([number.value for number in rows[1]], start, text)
    return rows


def _check_quaternion(values: Sequence[float], start: int, text: str) -> None:
    length = math.hypot(*values)
    if not abs(length - 1.0) <= UNIT_LENGTH_SLACK:  # also rejects NaN
        raise StatementError(start, text, f"a quaternion of length 1, here {length:.4g}")


def _inner(value: Tree[Token] | Token) -> list[Tree[Token] | Token]:
    """Return the items of an array without brackets; [] for another value."""
    return value.children[1:-1] if isinstance(value, Tree) else []


def _numbers(value: Tree[Token] | Token, start: int) -> list[Number]:
    """Return the numbers of a literal list; [] for another value."""
    if isinstance(value, Tree) or value.type != "NUMBERS":
        return []
    place, _ = part_place(value, start)
    return [
        Number(float(number[0]), place + number.start(), place + number.end())
        for number in NUMBER.finditer(value)
    ]


def _frame(name: str, kind: str, data: Mapping[str, _Data], frames: dict[str, Frame]) -> Frame:
    """Return a tool or work object by name; without values if it is not in the module."""
    key = name.lower()
    if key in KNOWN_FRAMES:
        return Frame(name, KNOWN_FRAMES[key])
    if key not in frames:
        declared = data.get(key)
        is_literal = declared is not None and declared.kind == kind
        frames[key] = Frame(name, _frame_values(declared) if is_literal and declared else ())
    return frames[key]


def _frame_values(declared: _Data) -> tuple[float, ...]:
    """Return position and quaternion of literal tooldata or wobjdata."""
    items = _inner(declared.value)
    poses = [
        np.array([number.value for row in _inner(item) for number in _numbers(row, 0)])
        for item in items
        if isinstance(item, Tree) and len(_inner(item)) == 2
    ]
    is_tool_data = declared.kind == "tooldata"
    robot_holds = str(items[0]).strip().upper()
    sizes = [7] if is_tool_data else [7, 7]
    if [len(pose) for pose in poses] != sizes or robot_holds != (
        "TRUE" if is_tool_data else "FALSE"
    ):
        valid = "a tool on the robot" if is_tool_data else "a work object that does not move"
        raise StatementError(declared.start, declared.text, f"{valid}, all numbers literal")
    position, turn = np.zeros(3), np.eye(3)
    for pose in poses:
        if not np.abs(pose).max() <= LARGEST_MM:
            valid = f"numbers within +-{LARGEST_MM:g}"
            raise StatementError(declared.start, declared.text, valid)
        _check_quaternion(pose[3:].tolist(), declared.start, declared.text)
        position = position + turn @ pose[:3]
        turn = turn @ quaternion_rotations(pose[None, 3:])[0]
    return (*position.tolist(), *quaternions(turn[None])[0].tolist())


def configurations(signs: FloatArray, angles: FloatArray) -> FloatArray:
    """Return (n, 4) cf1, cf4, cf6 and cfx.

    The first three are quarters of a turn of joints 1, 4 and 6, counted from zero; cfx is 4 if the
    wrist centre is behind axis 1, plus 2 if it is behind the lower arm, plus 1 if joint 5 is
    negative.
    """
    quarters = np.floor(angles[:, [0, 3, 5]] / (0.5 * np.pi) + NEAR_ZERO)
    shape = (signs < 0.0) @ np.array([4.0, 2.0, 1.0])
    return np.column_stack([quarters, shape])


LANGUAGE = Language(
    name="RAPID",
    companion="",
    metres=1e-3,
    radians=float(np.pi / 180.0),
    n_turns=4,
    decimals=(4, 5, 9),
    read=read,
    to_rotations=quaternion_rotations,
    configurations=configurations,
    config_names=("cf1", "cf4", "cf6", "cfx"),
    config_of_linear=True,
)
