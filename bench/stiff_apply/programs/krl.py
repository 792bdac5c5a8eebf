"""Read KUKA Robot Language: targets of a .src program and its .dat file.

Lengths are in mm, angles in deg; A, B, C turn about Z, the new Y and the new X. Status S and turn T
give the configuration in which a point-to-point motion reaches a pose (KUKA System Software,
operating and programming instructions for system integrators, "Status and turn").
"""

from __future__ import annotations

import re
from collections.abc import Iterator, Mapping, Sequence

import numpy as np
from lark import Token, Tree

from stiff_apply.programs.program_file import (
    NEAR_ZERO,
    NO_FRAME,
    Frame,
    Language,
    LeftMotion,
    Number,
    StatementError,
    Target,
)
from stiff_apply.programs.statements import parsed_statement, part_place
from stiff_datasets.measured.rotations import euler_rotations
from stiff_protocols.contract.types import BoolArray, FloatArray

GRAMMAR = r"""
start: motion | assignment | declaration
motion: MOTION goal ("," goal)* _TAIL?
assignment: VARIABLE "=" goal
declaration: "DECL"i? "GLOBAL"i? NAME VARIABLE "=" aggregate
goal: aggregate | VARIABLE | EXPRESSION
aggregate: OPEN (TYPE ":")? component ("," component)* CLOSE
component: NAME (NUMBER | EXPRESSION | aggregate)

OPEN: "{"
CLOSE: "}"
MOTION.3: /(S?PTP|S?LIN|S?CIRC|SPL)\b/i
TYPE.2: /[A-Z]\w*(?=\s*:)/i
NAME: /[A-Z]\w*/i
VARIABLE.1: /[A-Z$][\w$.]*(?=\s*(,|=|$)|\s+(C_|CA|WITH))/i
NUMBER.1: /[+-]?(\d+(\.\d*)?|\.\d+)(E[+-]?\d+)?(?=\s*[,}])/i
EXPRESSION: /[^\s,={}][^,={}]*/
_TAIL: /(C_|CA\b|WITH)[^{}]*/i
%ignore /[ \t]+/
"""
POSE, JOINTS = ("X", "Y", "Z", "A", "B", "C"), ("A1", "A2", "A3", "A4", "A5", "A6")
STATEMENT = re.compile(
    r"^[ \t]*(?P<text>"
    r"(?P<motion>(?:S?PTP|S?LIN|S?CIRC)(?:_REL)?\b|SPL\b)[^\r\n;]*"
    r"|\$(?P<frame>BASE|TOOL)[ \t]*=[^\r\n;]*"
    r"|BAS[ \t]*\([ \t]*#(?P<number>BASE|TOOL)[ \t]*,(?P<index>[^)\r\n]*)\)"
    r"|FDAT_ACT[ \t]*=[ \t]*(?P<fdat>\w+)"
    r"|(?P<assigned>\w+)[ \t]*=[^\r\n;]*"
    r"|(?P<flow>(?:IF|ELSE|ENDIF|FOR|ENDFOR|WHILE|ENDWHILE|LOOP|ENDLOOP|REPEAT|UNTIL|SWITCH|CASE"
    r"|DEFAULT|ENDSWITCH|GOTO|RETURN|DEF|DEFFCT|END|ENDFCT|INTERRUPT)\b"
    r"|\w+[ \t]*:(?!=)"
    r"|(?!BAS\b|WAIT\b|OUT\b|PULSE\b)\w+[ \t]*\([^\r\n]*))",
    re.IGNORECASE | re.MULTILINE,
)
DECLARATION = re.compile(
    r"^[ \t]*(?P<text>(?:DECL[ \t]+)?(?:GLOBAL[ \t]+)?"
    r"(?P<type>E6POS|POS|FRAME|E6AXIS|AXIS|FDAT)[ \t]+(?P<name>\w+)[ \t]*=[^\r\n;]*)",
    re.IGNORECASE | re.MULTILINE,
)
BITS = re.compile(r"'(?:([B])([01]{1,32})|([H])([0-9A-F]{1,8}))'\s*$", re.IGNORECASE)
"""S and T as 'B010' or 'H2'."""
WHOLE_POSE = "{X 0,Y 0,Z 0,A 0,B 0,C 0} or {A1 0,A2 0,A3 0,A4 0,A5 0,A6 0}"


def _parsed(text: str, start: int, text_index: int = 0) -> Tree[Token]:
    """Return the tree of a statement; StatementError if it cannot be read."""
    valid = f"e.g. LIN {WHOLE_POSE}"
    return parsed_statement(GRAMMAR, text.rstrip(), start, valid, text_index)


def read(texts: Sequence[str]) -> Iterator[Target | LeftMotion]:
    """Yield the motions of a program; texts are the .src and, if it exists, the .dat."""
    data = dict(_declarations(texts[1])) if len(texts) > 1 else {}
    base, tool = Frame("$BASE", ()), Frame("$TOOL", ())
    follows, assigned = False, set[str]()
    for match in STATEMENT.finditer(texts[0]):
        start, text, kind = match.start("text"), match["text"], match.lastgroup
        if match["motion"]:
            for motion in _motions(match["motion"].upper(), text, start, data, assigned):
                if isinstance(motion, LeftMotion):
                    yield motion
                    follows &= "helper" in motion.reason
                else:
                    yield motion._replace(base=base, tool=tool, follows=follows)
                    follows = True
        elif match["frame"]:
            frame = _frame(text, start)
            base, tool = (frame, tool) if match["frame"].upper() == "BASE" else (base, frame)
        elif match["number"]:
            name = match["number"].upper()
            frame = _numbered(name, match["index"].strip())
            base, tool = (frame, tool) if name == "BASE" else (base, frame)
        elif match["fdat"]:
            base, tool = _inline_form(match["fdat"].upper(), data)
        elif match["assigned"]:
            assigned.add(match["assigned"].upper())
        elif kind:
            follows = False


def _motions(
    word: str,
    text: str,
    start: int,
    data: Mapping[str, tuple[Tree[Token], int]],
    assigned: set[str],
) -> Iterator[Target | LeftMotion]:
    """Yield the helper point and the target of a motion."""
    if word.endswith("_REL"):
        raise StatementError(start, text, f"{word} is relative; give absolute targets")
    tree = _parsed(text, start)
    goals = [child for child in tree.children if isinstance(child, Tree)]
    is_circular = "CIRC" in word
    if is_circular and len(goals) > 1:
        yield LeftMotion(start, text, "helper point of a circular motion")
    goal = goals[1] if is_circular and len(goals) > 1 else goals[0]
    content = goal.children[0]
    text_index, offset, place = 0, start, part_place(content, start)
    if isinstance(content, Token):
        name = content.upper()
        if content.type == "EXPRESSION":
            yield LeftMotion(start, text, f"target {content.strip()} is an expression")
            return
        if name in assigned or name not in data:
            reason = "is assigned in the program" if name in assigned else "is a variable"
            yield LeftMotion(start, text, f"target {content} {reason}")
            return
        (content, offset), text_index = data[name], 1
    numbers, config, reason = _numbers(content, offset, text_index)
    if reason:
        yield LeftMotion(start, text, reason)
        return
    has_joints = numbers[0][0] == "A1"
    yield Target(
        start,
        start + len(text),
        *place,
        is_linear=word in ("LIN", "SLIN"),
        follows=False,
        has_joints=has_joints,
        numbers=[number for _, number in numbers],
        config=() if has_joints or is_circular or word == "SPL" else config,
        base=Frame("", NO_FRAME),
        tool=Frame("", NO_FRAME),
        text_index=text_index,
    )


def _numbers(
    aggregate: Tree[Token], start: int, text_index: int
) -> tuple[list[tuple[str, Number]], list[Number], str]:
    """Return the named numbers of a target, S and T, and the reason if there are none."""
    values: dict[str, Token] = {}
    for component in aggregate.find_data("component"):
        first, last = component.children
        if isinstance(first, Token) and isinstance(last, Token):
            values[first.upper()] = last
    names = JOINTS if "A1" in values else POSE
    missing = [name for name in names if name not in values]
    if missing:
        return [], [], f"the target has no {', '.join(missing)}"
    for name in names:
        if values[name].type != "NUMBER":
            return [], [], f"{name} {values[name].strip()} is an expression"
    numbers = [(name, _number(values[name], start)) for name in names]
    config = [values[name] for name in ("S", "T") if name in values]
    if len(config) < 2 or not all(token.type == "NUMBER" or BITS.match(token) for token in config):
        return numbers, [], ""
    status, turn = (_number(values[name], start) for name in ("S", "T"))
    if not abs(status.value) < 2**31 or not abs(turn.value) < 2**31:
        return numbers, [], ""
    status = status._replace(value=float(int(status.value) & 7))
    return numbers, [status, turn], ""


def _number(token: Token, start: int) -> Number:
    """Return a number; S and T may be written as 'B010' or 'H2'."""
    bits = BITS.match(token)
    value = float(token) if not bits else int(bits[2], 2) if bits[1] else int(bits[4], 16)
    place, end = part_place(token, start)
    return Number(float(value), place, end - len(token) + len(token.rstrip()))


def _frame(text: str, start: int) -> Frame:
    """Return the frame that `$BASE = ...` or `$TOOL = ...` sets."""
    tree = _parsed(text, start)
    content = tree.children[1].children[0]  # type: ignore[union-attr]
    if isinstance(content, Token):
        name = content.strip()
        return Frame(name, NO_FRAME if name.upper() in ("$NULLFRAME", "$WORLD") else ())
    numbers, _, reason = _numbers(content, 0, 0)
    if reason or numbers[0][0] != "X":
        raise StatementError(start, text, f"a literal frame {WHOLE_POSE.partition(' or')[0]}")
    return Frame(text.partition("=")[0].strip(), tuple(number.value for _, number in numbers))


def _numbered(name: str, index: str) -> Frame:
    """Return the frame of `BAS(#BASE, index)`, which is in the controller."""
    return Frame(f"{name}_DATA[{index}]", NO_FRAME if index in ("0", "-1") else ())


def _inline_form(name: str, data: Mapping[str, tuple[Tree[Token], int]]) -> tuple[Frame, Frame]:
    """Return base and tool of an inline form's frame data."""
    numbers = {"BASE_NO": "?", "TOOL_NO": "?"}
    if name in data:
        for component in data[name][0].find_data("component"):
            numbers[str(component.children[0]).upper()] = str(component.children[1]).strip()
    if numbers.get("IPO_FRAME", "").upper() == "#TCP":
        raise StatementError(data[name][1], f"{name}: IPO_FRAME #TCP", "a tool on the robot", 1)
    return _numbered("BASE", numbers["BASE_NO"]), _numbered("TOOL", numbers["TOOL_NO"])


def _declarations(text: str) -> Iterator[tuple[str, tuple[Tree[Token], int]]]:
    """Yield the names of a .dat file's targets, each with its aggregate and place."""
    for match in DECLARATION.finditer(text):
        start = match.start("text")
        tree = _parsed(match["text"], start, 1)
        yield match["name"].upper(), (tree.children[-1], start)  # type: ignore[misc]


def matches(written: FloatArray, low: FloatArray, high: FloatArray) -> BoolArray:
    """Test status and turn; bits that differ between `low` and `high` are ignored."""
    free = low.astype(np.int64) ^ high.astype(np.int64)
    return np.asarray(((written.astype(np.int64) ^ low.astype(np.int64)) & ~free) == 0)


def configurations(signs: FloatArray, angles: FloatArray) -> FloatArray:
    """Return (n, 2) status and turn.

    Bit 0 of the status: the wrist centre is behind axis 1. Bit 1: joint 3 is at or above the angle
    of the straight arm. Bit 2: joint 5 is negative. Bit i of the turn: joint i + 1 is
    negative. Bits 3 and 4 of the status do not choose a configuration and are not compared.
    """
    shoulder, elbow, wrist = signs.T
    status = (shoulder < 0) + 2 * (elbow >= 0) + 4 * (wrist < 0)
    turn = (angles < -NEAR_ZERO) @ (1 << np.arange(angles.shape[1]))
    return np.column_stack([status, turn]).astype(np.float64)


LANGUAGE = Language(
    name="KRL",
    companion=".dat",
    metres=1e-3,
    radians=float(np.pi / 180.0),
    n_turns=3,
    decimals=(4, 5, 5),
    read=read,
    to_rotations=lambda turns: euler_rotations("ZYX", turns),
    configurations=configurations,
    matches=matches,
    config_names=("S", "T"),
)
