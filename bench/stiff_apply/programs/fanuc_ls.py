"""Read FANUC TP programs as .ls text: motions of /MN with positions of /POS.

Lengths are in mm, angles in deg; W, P, R turn about the fixed axes X, Y, Z. Each position contains
the numbers of the user frame (UF) and the tool frame (UT); the frames themselves are in the
controller. CONFIG contains the wrist (F: joint 5 is positive, N: it is not), the elbow (U, D), the
shoulder (T, B) and full turns of joints 1, 4 and 6. These rules reproduce 16 poses of ROBOGUIDE for
an M-20iD/25 (GitHub LeroyDu56/robconv), which was checked by hand.
"""

from __future__ import annotations

import re
from collections.abc import Collection, Iterator, Sequence
from typing import Any

import numpy as np

from stiff_apply.programs.flow import LAST, Frame, Jump, Routine, Setting, Unknown, Value
from stiff_apply.programs.program import NEAR_ZERO, NO_FRAME, Goal, Language, Motion
from stiff_apply.programs.statements import Names, Number
from stiff_apply.rotations import euler_rotations
from stiff_protocols.contract.types import FloatArray

SECTION = re.compile(r"^/(MN|POS|END)\b", re.MULTILINE)
STATEMENT = re.compile(
    r"^[ \t]*\d*[ \t]*:?[ \t]*(?:(?:!|--|//)[^\r\n]*|(?P<text>[^\s;][^;]*?)?\s*;)", re.MULTILINE
)
POINT = r"@?(PR|P)\s*\[((?:[^\[\]]|\[[^\]]*\])*)\]"
MOTION = re.compile(rf"(?P<letter>[LJCAS])\s+{POINT}(?:\s*:?\s*{POINT})?(?P<rest>.*)", re.DOTALL)
ASSIGNED = re.compile(r"(?<!\w)P\s*\[\s*(\d*)(?:[^\[\]\n]|\[[^\]\n]*\])*\]\s*=")
NUMBERED = re.compile(r"\s*(\d+)\s*(?::.*)?", re.DOTALL)
INDEX = r"\[[^\]]*\]"
OPTION = re.compile(
    rf"[\s,:]*+(?:max_speed|WELD_SPEED|(?:\d++(?:\.\d*+)?|\.\d++|A?R{INDEX})\s*+"
    r"(?:%|mm/sec|cm/min|inch/min|deg/sec|m?sec)|FINE|(?:CNT|CR|CD|ACC|EV)\s*+(?:\d+%?|A?R"
    rf"{INDEX})|Wjnt|PTH|MROT|BREAK|Skip\s*,\s*LBL{INDEX}|(?:Arc|Weave)\s+(?:Start|End|Sine|Circle"
    rf"|Figure 8)\s*(?:{INDEX})?|(?:TB|TA|DB|TIME\s+BEFORE|TIME\s+AFTER|DISTANCE\s+BEFORE)\s*"
    r"[-+\d.]++\s*+(?:(?:sec|mm)\s*+)?,\s*+(?:P-SPS|POINT_LOGIC|CALL\s+\w+(?:\([^)]*\))?|\w+\[[^\]]*\]"
    r"=[^\s,]+))(?![\w.])",
    re.IGNORECASE,
)
POSITION = re.compile(
    r"^[ \t]*P[ \t]*\[\s*(\d+)\s*(?::\s*(?:\"[^\"]*\"|[^\]]*))?\s*\]\s*\{(?P<groups>[^}]*)\}",
    re.MULTILINE,
)
GROUP = re.compile(r"GP(\d+)\s*:((?:(?!GP\d+\s*:).)*)", re.DOTALL)
FRAME = re.compile(r"\b(UF|UT)\s*:\s*(\w+)")
AXIS = re.compile(
    r"\b([XYZWPR]|[JE]\d)\s*=\s*([+-]?(?:\d{1,15}+(?:\.\d*+)?|\.\d++)(?:E[+-]?\d{1,2})?)\s*+(?:mm|deg)",
    re.IGNORECASE,
)
CONFIG = re.compile(r"CONFIG\s*:\s*'([^']*)'")
HARMLESS = re.compile(
    r"(?:-+$|A?R\[|PR\[|SR\[|F\[|DO\[|RO\[|GO\[|AO\[|SO\[|UO\[|WO\[|FLG|TIMER|OVERRIDE|WAIT|MESSAGE"
    r"|UALM|PAUSE|PAYLOAD|COL (?:DETECT|GUARD)|SKIP\s+CONDITION|(?:TOOL_)?OFFSET\s+CONDITION"
    r"|VOFFSET\s+CONDITION|LOCK|UNLOCK|MONITOR|JOINT_MAX_SPEED|LINEAR_MAX_SPEED|Arc\s|Weave\s|RSR"
    r"|MAX_SPEED|STICK_DETECT|\$WAITTMOUT|\$PRIORITY|LINE_COUNT|PULSE)"
)
POSE = ("X", "Y", "Z", "W", "P", "R")
JOINTS = ("J1", "J2", "J3", "J4", "J5", "J6")
EXTERNAL = ("E1", "E2", "E3", "GP2 J1", "GP2 J2", "GP2 J3")
STATE: dict[str, Any] = {
    **{LAST: None, "other": "", "frame number": None, "tool number": None},
    **{"frame": Frame("UF[F]"), "tool": Frame("UT[F]")},
}
SHAPES = {"F": 1.0, "N": 0.0, "U": 1.0, "D": 0.0, "T": 1.0, "B": 0.0}
"""Letter of CONFIG -> number of the configuration."""


class _Reader:
    """Reads positions first, then statements."""

    def __init__(self, texts: Sequence[str], harmless: Collection[str]) -> None:
        text = texts[0]
        self.harmless = {name.lower() for name in harmless}
        sections = {match[1]: match for match in SECTION.finditer(text)}
        begin = sections["MN"].end() if "MN" in sections else 0
        end = sections["POS"].start() if "POS" in sections else len(text)
        self.positions = {int(match[1]): match for match in POSITION.finditer(text, end)}
        self.assigned = {int(number or -1) for number in ASSIGNED.findall(text, 0, end)}
        if -1 in self.assigned:
            self.assigned = {*self.positions}
        self.labels = re.findall(r":\s*LBL\[\s*(\d+)", text[begin:end])
        self.names, self.text, routine = Names(), text[:end], Routine("", entry="file")
        for match in STATEMENT.finditer(text, begin, end):
            if match["text"]:
                routine.items += self.items(match["text"], match.start("text"))
        self.routines, self.state = {"": routine}, dict(STATE)
        if re.search(r"LINE_TRACK_SCHEDULE_NUMBER\s*:\s*[1-9]", text[:begin]):
            self.state["other"] = Unknown("the program follows a conveyor: LINE_TRACK")

    def items(self, text: str, start: int) -> Iterator[Any]:
        """Yield the items of a statement."""
        unknown = Unknown(f"not read: {' '.join(text.split())[:50]}")
        word = re.match(r"\w*", text)[0].upper()  # type: ignore[index]
        if match := MOTION.fullmatch(text):
            yield self._motion(match, start)
            for call in re.findall(r"\bCALL\s+\w+", match["rest"]):
                yield from self.items(call, start)
        elif re.match(r"(IF\b.*\bTHEN|ELSE|ENDIF|ENDFOR|END|ABORT)\s*$", text, re.DOTALL):
            words = {"END": "return", "ABORT": "return", "ENDFOR": "endloop"}
            yield Jump(words.get(word, word.lower()))
        elif word == "FOR":
            yield Jump("loop")
        elif word in ("IF", "SELECT", "ELSE") or text.startswith("="):
            yield Jump("if")
            action = re.split(r",(?![^\[(]*[\])])", text)[-1].strip()
            yield from (
                self.items(action, start) if action != text else [Setting({"other": unknown})]
            )
            yield Jump("endif")
        elif label := re.match(r"LBL\[\s*(\d+)", text):
            yield Jump("label", label[1])
        elif word == "JMP":
            label = re.search(r"LBL\[\s*(\d+)\s*\]", text)
            ways = [label[1]] if label else self.labels
            yield from (Jump("branch", way) for way in ways[1:])
            yield from (Jump("goto", way) for way in ways[:1])
        elif match := re.match(r"U(FRAME|TOOL)_NUM\s*=\s*(.*)", text, re.DOTALL):
            side, key = ("frame", "UF") if match[1] == "FRAME" else ("tool", "UT")
            number = match[2] if match[2].isdigit() else None
            frame = _frame(key, match[2]) if number else unknown
            yield Setting({side: frame, f"{side} number": number})
        elif match := re.match(r"U(FRAME|TOOL)\[\s*([^\]]*?)\s*\]\s*=", text):
            key = "UF" if match[1] == "FRAME" else "UT"
            number = match[2].partition(":")[0]
            yield Setting({f"{key}[{number}]" if number.isdigit() else f"{key}*": unknown})
        elif word in ("CALL", "RUN"):
            name = re.match(r"\w+\s*(\w*)", text)
            if name and name[1].lower() not in self.harmless:
                keys = {"frame": unknown, "tool": unknown}
                yield Setting({**keys, "frame number": None, "tool number": None})
        elif not (
            HARMLESS.match(text)
            or re.match(r"P\[", text)
            or any(text.lower().startswith(name) for name in self.harmless)
        ):
            yield Setting({**dict.fromkeys(("UF*", "UT*", "frame", "tool", "other"), unknown)})
        if not re.match(r"LBL|JMP|IF|SELECT|ELSE|=", text):
            yield from (Jump("branch", label) for label in re.findall(r"LBL\[\s*(\d+)", text))

    def _motion(self, match: re.Match[str], start: int) -> Motion:
        """Return a motion with its points."""
        letter, options = match["letter"], match["rest"]
        kind = {"J": "joint", "L": "linear"}.get(letter, "circle")
        motion = Motion(start, start + match.end(), "", kind, needs=("other",))
        points = [(match[2], match[3]), *([(match[4], match[5])] if match[4] else [])]
        place = 0
        while option := OPTION.match(options, place):
            place = option.end()
        if moved := re.search(r"[^\s,;:]+", options[place:]):
            motion.reason = f"moved by {moved[0]}, or not read"
        elif letter in "AS" or len(points) != 1 + (letter == "C"):
            motion.reason = "arc motions are not read" if letter in "AS" else "cannot be read"
        motion.goals = tuple(self._goal(*point) for point in points)
        for name, index in points:
            number = NUMBERED.fullmatch(index)
            position = self.positions.get(int(number[1])) if number and name == "P" else None
            if position is None:
                continue
            frames = dict(FRAME.findall(_first_group(position)[0]))
            for side, key in (("frame", "UF"), ("tool", "UT")):
                written = frames.get(key, "F")
                frame = _frame(key, written) if written.isdigit() else Value(side)
                expected = written if written.isdigit() else None
                if motion.expects.setdefault(f"{side} number", expected) != expected:
                    motion.reason = motion.reason or f"its points have different {side}s"
                motion.base, motion.tool = (
                    (frame, motion.tool) if side == "frame" else (motion.base, frame)
                )
        return motion

    def _goal(self, name: str, index: str) -> Goal:
        """Return a point of /POS."""
        number = NUMBERED.fullmatch(index)
        if name == "PR" or not number:
            return Goal(reason=f"target {name}[{index}] is a register or a variable")
        if int(number[1]) not in self.positions or int(number[1]) in self.assigned:
            cause = "assigned in the program" if int(number[1]) in self.assigned else "not in /POS"
            return Goal(reason=f"P[{number[1]}] is {cause}")
        position = self.positions[int(number[1])]
        if "*" in position["groups"]:
            return Goal(reason=f"P[{number[1]}] has numbers that are not set")
        text, place = _first_group(position)
        axes = {
            axis[1].upper(): Number(float(axis[2]), place + axis.start(2), place + axis.end(2))
            for axis in AXIS.finditer(text)
        }
        has_joints = "J1" in axes
        names = JOINTS if has_joints else POSE
        if missing := [axis for axis in names if axis not in axes]:
            return Goal(reason=f"P[{number[1]}] has no number {missing[0]}")
        other_axes = {
            f"GP{group[1]} {axis[1]}": float(axis[2])
            for group in GROUP.finditer(position["groups"])
            for axis in (AXIS.finditer(group[2]) if group[1] != "1" else ())
        }
        own_axes = {
            axis: axes[axis].value for axis in axes if axis[0] == "E" or axis in ("J7", "J8")
        }
        external = tuple((own_axes | other_axes).get(axis, np.nan) for axis in EXTERNAL)
        if strange := (own_axes.keys() | other_axes.keys()) - {*EXTERNAL}:
            return Goal(reason=f"P[{number[1]}] moves {min(strange)}, too")
        config = () if has_joints else _config(text, place)
        if "'" in text and not (config or has_joints):
            return Goal(reason="the configuration of the position is not read")
        return Goal(tuple(axes[axis] for axis in names), has_joints, config, external)


def _frame(key: str, number: str) -> Any:
    """Return the frame of a number: 0 is world or flange, others are in the controller."""
    name = f"{key}[{int(number)}]"
    return Frame(name, NO_FRAME) if int(number) == 0 else Value(name)


def _first_group(position: re.Match[str]) -> tuple[str, int]:
    """Return the text of the first motion group of a position, with its place."""
    for group in GROUP.finditer(position["groups"]):
        if group[1] == "1":
            return group[2], position.start("groups") + group.start(2)
    return "", 0


def _config(text: str, place: int) -> tuple[Number, ...]:
    """Return wrist, elbow and shoulder of CONFIG as `SHAPES`, and three full turns."""
    if not (config := CONFIG.search(text)):
        return ()
    start = place + config.start(1)
    numbers = tuple(
        Number(
            SHAPES[part[0]] if part[0] in SHAPES else float(part[0]),
            start + part.start(),
            start + part.end(),
        )
        for part in re.finditer(r"[FNUDTB]|[+-]?\d+", config[1])
    )
    return numbers if len(numbers) == 6 else ()


def configurations(signs: FloatArray, angles: FloatArray) -> FloatArray:
    """Return (n, 6) wrist (1: F), elbow (1: U), shoulder (1: T), and turns of joints 1, 4, 6."""
    shape = np.column_stack([signs[:, 2] > 0.0, signs[:, 1] > 0.0, signs[:, 0] > 0.0])
    turns = np.floor((angles[:, [0, 3, 5]] + np.pi) / (2.0 * np.pi) + NEAR_ZERO)
    return np.hstack([shape.astype(np.float64), turns])


LANGUAGE = Language(
    name="FANUC TP",
    metres=1e-3,
    radians=float(np.pi / 180.0),
    n_turns=3,
    motion=re.compile(r"^[ \t]*\d*[ \t]*:[ \t]*(?:GP\d+\W*)?[LJCAS][ \t]+@?PR?[ \t]*\[", re.M),
    decimals=(3, 5),
    reader=_Reader,
    to_rotations=lambda turns: euler_rotations("xyz", turns),
    configurations=configurations,
    config_names=("F", "U", "T", "turn 1", "turn 4", "turn 6"),
    config_of_linear=True,
    external_names=EXTERNAL,
)
