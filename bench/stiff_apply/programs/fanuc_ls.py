"""Read FANUC TP programs as .ls text: motions of /MN with positions of /POS.

Lengths are in mm, angles in deg; W, P, R turn about the fixed axes X, Y, Z. Each position contains
the numbers of the user frame (UF) and the tool frame (UT); the frames themselves are in the
controller. CONFIG contains the wrist (F: joint 5 is positive, N: it is not), the elbow (U, D), the
shoulder (T, B) and full turns of joints 1, 4 and 6. These rules reproduce 16 poses of ROBOGUIDE for
an M-20iD/25 (GitHub LeroyDu56/robconv), which was checked by hand.
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
from stiff_apply.programs.statements import number_of, parsed_statement, part_place
from stiff_datasets.measured.rotations import euler_rotations
from stiff_protocols.contract.types import FloatArray

GRAMMAR = r"""
start: motion | position
motion: LETTER goal REST?
goal: NAME "[" INDEX (":" TEXT?)? "]"
position: NAME "[" INDEX (":" TEXT?)? "]" "{" group+ "}"
group: "GP" INDEX ":" field ("," field)*
field: FRAME ":" INDEX | "CONFIG" ":" CONFIG | AXIS "=" (NUMBER | UNKNOWN) UNIT

LETTER.2: /[LJCAS](?=\s)/
NAME.2: /PR|P/
FRAME.2: /UF|UT/
AXIS.2: /[XYZWPR]|[JE]\d/
INDEX.1: /\d+|F/
TEXT: /"[^"]*"|[^\]"]+/
CONFIG.2: /'[^']*'/
NUMBER.2: /[+-]?(\d+(\.\d*)?|\.\d+)(E[+-]?\d+)?/i
UNKNOWN: /\*+/
UNIT.2: /mm|deg/
REST: /[^;]+/
%ignore /\s+/
"""
MOTION = re.compile(
    r"^[ \t]*\d*[ \t]*:[ \t]*(?P<text>(?P<motion>[LJCAS])[ \t]+(?:P|PR)[ \t]*\[[^;]*)(?=;)"
    r"|^[ \t]*\d*[ \t]*:[ \t]*(?P<flow>IF|SELECT|JMP|LBL|CALL|RUN|FOR|ENDFOR|ELSE|ENDIF|SKIP)\b",
    re.MULTILINE,
)
POSITION = re.compile(r"^[ \t]*(?P<text>P[ \t]*\[[^\]]*\][ \t]*\{[^}]*\})", re.MULTILINE)
POSE = ("X", "Y", "Z", "W", "P", "R")
JOINTS = ("J1", "J2", "J3", "J4", "J5", "J6")
VALID = "P[1]{ GP1: UF : 0, UT : 1, CONFIG : 'N U T, 0, 0, 0', X = 0.000 mm, .. R = 0.000 deg };"
MOVED = re.compile(r"\b(Offset|Tool_Offset|INC|VOFFSET)\b", re.IGNORECASE)
SHAPES = {"F": 1.0, "N": 0.0, "U": 1.0, "D": 0.0, "T": 1.0, "B": 0.0}
"""Letter of CONFIG -> number of the configuration."""


def read(texts: Sequence[str]) -> Iterator[Target | LeftMotion]:
    """Yield the motions of a program."""
    (text,) = texts
    body = text.find("/POS")
    positions = dict(_positions(text, max(body, 0)))
    follows = False
    for match in MOTION.finditer(text, 0, body if body >= 0 else len(text)):
        if match["flow"]:
            follows = False
            continue
        for motion in _motions(match["motion"], match["text"], match.start("text"), positions):
            if isinstance(motion, LeftMotion):
                follows &= "helper" in motion.reason
                yield motion
            else:
                yield motion._replace(follows=follows)
                follows = True


def _positions(text: str, start: int) -> Iterator[tuple[str, tuple[Tree[Token], int]]]:
    """Yield the numbers of positions, each with the fields of its first group."""
    for match in POSITION.finditer(text, start):
        place = match.start("text")
        tree = parsed_statement(GRAMMAR, match["text"], place, VALID)
        groups = [*tree.find_data("group")]
        first = next((group for group in groups if group.children[0] == "1"), groups[0])
        yield str(tree.children[1]), (first, place)


def _motions(
    letter: str, text: str, start: int, positions: Mapping[str, tuple[Tree[Token], int]]
) -> Iterator[Target | LeftMotion]:
    """Yield the helper point and the target of a motion."""
    statement = text.strip()
    if letter == "A":
        yield LeftMotion(start, statement, "arc motion (its points are also helper points)")
        return
    if letter == "C":
        yield LeftMotion(start, statement, "helper point of a circular motion")
        points = [*re.finditer(r":[ \t]*(P[ \t]*\[[^\]]*\])", text)]
        if not points:
            raise StatementError(
                start, statement, "C P[1] and, in the next line, : P[2] 100mm/sec FINE"
            )
        last = points[-1]
        tree = parsed_statement(GRAMMAR, f"L {last[1]} ", start, "C P[1] : P[2] 100mm/sec FINE")
        goal_place = start + last.start(1), start + last.end(1)
    else:
        tree = parsed_statement(GRAMMAR, text, start, "L P[1] 100mm/sec FINE ;")
        goal_place = start + text.index("P"), start + text.index("]") + 1
    goal = tree.children[1]
    name, index = (str(part) for part in goal.children[:2])  # type: ignore[union-attr]
    moved = MOVED.search(text)
    if name == "PR" or moved:
        reason = f"moved by {moved[1]}" if moved else f"target PR[{index}] is a register"
        yield LeftMotion(start, statement, reason)
        return
    if index not in positions:
        yield LeftMotion(start, statement, f"P[{index}] is not in /POS")
        return
    group, place = positions[index]
    fields = {str(field.children[0]): field.children for field in group.find_data("field")}
    has_joints = "J1" in fields
    names = JOINTS if has_joints else POSE
    numbers = []
    for axis in names:
        token = fields[axis][1] if axis in fields else None
        if not isinstance(token, Token) or token.type != "NUMBER":
            yield LeftMotion(start, statement, f"P[{index}] has no number {axis}")
            return
        numbers.append(number_of(token, place))
    yield Target(
        start,
        start + len(text),
        *goal_place,
        is_linear=letter == "L",
        follows=False,
        has_joints=has_joints,
        numbers=numbers,
        config=() if has_joints or letter == "C" else _config(group, place),
        base=_frame("UF", fields),
        tool=_frame("UT", fields),
    )


def _frame(name: str, fields: Mapping[str, Sequence[Tree[Token] | Token]]) -> Frame:
    """Return the frame of a number: 0 is world or flange, others are in the controller."""
    number = str(fields[name][1]) if name in fields else "?"
    return Frame(f"{name} {number}", NO_FRAME if number == "0" else ())


def _config(group: Tree[Token], place: int) -> list[Number]:
    """Return wrist, elbow and shoulder of CONFIG as `SHAPES`, and three full turns."""
    for field in group.find_data("field"):
        token = field.children[0]
        if isinstance(token, Token) and token.type == "CONFIG":
            start, _ = part_place(token, place)
            numbers = [
                Number(
                    SHAPES[letter[0]] if letter[0] in SHAPES else float(letter[0]), *letter.span()
                )
                for letter in re.finditer(r"[FNUDTB]|[+-]?\d+", token)
            ]
            numbers = [n._replace(start=start + n.start, end=start + n.end) for n in numbers]
            return numbers if len(numbers) == 6 else []
    return []


def configurations(signs: FloatArray, angles: FloatArray) -> FloatArray:
    """Return (n, 6) wrist (1: F), elbow (1: U), shoulder (1: T), and turns of joints 1, 4, 6."""
    shape = np.column_stack([signs[:, 2] > 0.0, signs[:, 1] > 0.0, signs[:, 0] > 0.0])
    turns = np.floor((angles[:, [0, 3, 5]] + np.pi) / (2.0 * np.pi) + NEAR_ZERO)
    return np.hstack([shape.astype(np.float64), turns])


LANGUAGE = Language(
    name="FANUC TP",
    companion="",
    metres=1e-3,
    radians=float(np.pi / 180.0),
    n_turns=3,
    decimals=(3, 5, 5),
    read=read,
    to_rotations=lambda turns: euler_rotations("xyz", turns),
    configurations=configurations,
    config_names=("F", "U", "T", "turn 1", "turn 4", "turn 6"),
    config_of_linear=True,
)
