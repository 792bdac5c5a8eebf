"""Read KUKA Robot Language: a .src program, its .dat file, and frames of `$config.dat` next to it.

Lengths are in mm, angles in deg; A, B, C turn about Z, the new Y and the new X. Status S and turn T
give the configuration in which a point-to-point motion reaches a pose (KUKA System Software,
operating and programming instructions for system integrators, "Status and turn").
"""

from __future__ import annotations

import re
from collections.abc import Collection, Iterator, Sequence
from dataclasses import replace
from typing import Any

import numpy as np

from stiff_apply.programs.flow import (
    LAST,
    Frame,
    Jump,
    Routine,
    Setting,
    Unknown,
    Value,
    call_text,
    called,
    headed,
    lost_state,
)
from stiff_apply.programs.program import NEAR_ZERO, NO_FRAME, Goal, Language, Motion
from stiff_apply.programs.statements import (
    WORD,
    Declared,
    Names,
    Number,
    Statement,
    without_comments,
    without_strings,
)
from stiff_apply.rotations import euler_rotations
from stiff_protocols.contract.types import BoolArray, FloatArray

POSE, JOINTS = ("X", "Y", "Z", "A", "B", "C"), ("A1", "A2", "A3", "A4", "A5", "A6")
EXTERNAL = ("E1", "E2", "E3", "E4", "E5", "E6")
COMMENT = re.compile(r"\"[^\"\r\n]*\"|;[^\r\n]*|^[ \t]*&[^\r\n]*", re.MULTILINE)
FLOW = {
    **{"IF": "if", "ELSE": "else", "ENDIF": "endif", "SWITCH": "switch", "CASE": "case"},
    **{"DEFAULT": "else", "ENDSWITCH": "endif", "EXIT": "break", "RETURN": "return"},
    **dict.fromkeys(("FOR", "WHILE", "LOOP", "REPEAT"), "loop"),
    **dict.fromkeys(("ENDFOR", "ENDWHILE", "ENDLOOP", "UNTIL"), "endloop"),
    "RESUME": "return",
}
DEFINITION = re.compile(
    r"(GLOBAL\s+)?(?:DEF|DEFFCT\s+[\w\[\],]+)\s+(\w+)\s*\(([^)]*)\)", re.IGNORECASE
)
DECLARATION = re.compile(
    r"(?:(?:DECL|GLOBAL|CONST)\s+)*(?:(?<=\s)\w+|INT|REAL|BOOL|CHAR|FRAME|E6POS|E3POS|POS|E6AXIS"
    r"|E3AXIS|AXIS|FDAT|LDAT|PDAT)\s+(?P<names>[A-Z_$][\w$]*\b.*)",
    re.IGNORECASE,
)
MOTION = re.compile(r"(?P<word>S?PTP|S?LIN|S?CIRC|SPL)(?P<rel>_REL)?\b(?!\s*=)", re.I)
WITH = re.compile(r"\bWITH\b", re.IGNORECASE)
ACTION = re.compile(r"(?:GLOBAL\s+)?(?:INTERRUPT|TRIGGER)\b.*\bDO\s+(?=\S)", re.IGNORECASE)
APPROXIMATION = re.compile(r"(?:\s*\bC_(?:DIS|PTP|ORI|VEL|SPL)\b)+\s*$", re.IGNORECASE)
ASSIGNMENT = re.compile(r"(?P<base>\$?\w+)(?P<part>\[[^\]=]*\])?(?P<field>[.\[][\w$.\[\],]*)?\s*=")
HARMLESS = re.compile(
    r"(?:DEFDAT|ENDDAT|STRUC|ENUM|SIGNAL|IMPORT|WAIT|HALT|CONTINUE|PULSE"
    r"|OUT|ANOUT|ANIN|DIGIN|CONFIRM|BRAKE|TRIGGER|INTERRUPT|GLOBAL\s+INTERRUPT|TIME_BLOCK"
    r"|CONST_VEL|ON_ERROR_PROCEED|CHANNEL|CWRITE|CREAD|SWRITE|SREAD|COPEN|CCLOSE|END(?:FCT)?"
    r"|(?:ENDSPLINE|SPLINE|PTP_SPLINE))\b",
    re.IGNORECASE,
)
HARMLESS_VARIABLE = re.compile(
    r"\$(?:VEL|ACC|APO|ORI_TYPE|CIRC_|COLLMON|TORQMON|ADVANCE|OV_|OUT|ANOUT|TIMER|FLAG|CYCFLAG|BWDSTART|H_POS"
    r"|LOAD|JERK|GEAR_JERK|LOOP_|CMD|PRO_|SPL_|RED_VEL|IOSYS|STOPNOAPROX|VC_|COUNT_I|CP_VEL)",
    re.IGNORECASE,
)
FRAME_NAME = re.compile(r"\$(?:BASE|TOOL)\b|(?:BASE|TOOL)_DATA\b|FDAT_ACT\b", re.IGNORECASE)
CALL = re.compile(r"(?<![\w$.#])([A-Za-z]\w*)\s*\(")
FUNCTIONS = frozenset(
    "BAS ABS SIN COS TAN ACOS ASIN ATAN2 SQRT INV_POS INVERSE FORWARD B_AND B_OR B_EXOR B_NOT "
    "STRLEN STRCOPY STRADD STRCLEAR STRCOMP STRFIND STRDECLLEN STRTOINT STRTOREAL STRTOBOOL "
    "VARSTATE GET_SYSTEM_DATA IR_STOPM USER IF WHILE UNTIL FOR AND OR NOT EXOR SWITCH CASE RETURN "
    "SET_OPT_FILTER MSGNOTIFY CWRITE CREAD SWRITE SREAD COPEN CCLOSE PULSE SIGNUM ROUND TRUNC "
    "EK EO EB SVEL_CP SVEL_JOINT STOOL STOOL2 SBASE SIPO_MODE SLOAD SAPO SAPO_PTP".split()
)
STATE: dict[str, Any] = {
    **{LAST: None, "mode": "#BASE", "root": "$ROBROOT"},
    **{"base": Frame("$BASE"), "tool": Frame("$TOOL")},
    **dict.fromkeys(
        ("fdat base", "fdat tool", "fdat mode"),
        Unknown("BAS(..) sets the frames of FDAT_ACT, which are not set before"),
    ),
}
"""State at the start: frames are in the controller."""
NEEDS = ("mode", "root")
TABLE = re.compile(r"(BASE|TOOL)_DATA\[\d+\]")
OF_DATA = {"STOOL": "tool", "STOOL2": "tool", "SBASE": "base", "SIPO_MODE": "mode"}
"""Function of inline forms -> what it takes from frame data."""


class _Reader:
    """Reads names first, then statements.

    Texts are the .src, the .dat and `$config.dat`; "" for a missing one.
    """

    def __init__(self, texts: Sequence[str], harmless: Collection[str]) -> None:
        self.functions = FUNCTIONS | {name.upper() for name in harmless}
        self.names, self.routines = Names(takes_single=True), {"": Routine("", entry="file")}
        self.state, self.spline = dict(STATE), dict[str, Any]()
        self.inputs: dict[str, list[bool]] = {}
        for index, text in enumerate(texts[1:], 1):
            for start, line in _lines(without_comments(text, COMMENT)):
                self._declare_data(start, line, index)
        self.text = without_comments(texts[0], COMMENT)
        lines = [*self._by_routine(self.text)]
        for routine, start, line in lines:
            self._note_names(routine.name, start, line)
        self.names.finish()
        for routine, start, line in lines:
            routine.items += self._items(routine.name, start, line)

    def _by_routine(self, text: str) -> Iterator[tuple[Routine, int, str]]:
        """Yield statements with their routines."""
        now = self.routines[""]
        for start, line in _lines(text):
            if match := DEFINITION.match(line):
                name, parts = match[2].upper(), [part for part in match[3].split(",") if part]
                entry = "file" if len(self.routines) == 1 or match[1] else "called"
                now = self.routines.setdefault(name, Routine(name, entry=entry))
                self.inputs[name] = [":IN" in part.upper().replace(" ", "") for part in parts]
                for part in parts:
                    parameter = re.split(r"[:\[]", part)[0].strip()
                    self.names.declare_parameter(name, parameter)
            elif re.fullmatch(r"END(FCT)?", line, re.IGNORECASE):
                now = self.routines[""]
            elif not re.match(r"EXT(FCT)?P?\b", line, re.IGNORECASE):
                yield now, start, line

    def _declare_data(self, start: int, line: str, index: int) -> None:
        """Note a value of a .dat file; of `$config.dat` only frames."""
        name, equals, text = line.partition("=")
        name = name.split()[-1].upper() if name.split() else ""
        kind = next((word for word in line.upper().split() if word == "FDAT"), "")
        if not equals:
            return
        statement = Statement(text.rstrip(), start + len(line) - len(text))
        value = statement.only_value
        if TABLE.fullmatch(name):
            frame = self._frame("", name, statement, value)
            self.state[name] = frame._replace(name=name) if isinstance(frame, Frame) else frame
        elif index == 1 or kind:
            self.names.declare("", name, Declared(kind, statement, value, index))

    def _note_names(self, routine: str, start: int, line: str) -> None:
        """Note what a statement does to names."""
        if action := ACTION.match(line):
            self._note_names(routine, start + action.end(), line[action.end() :])
            return
        if match := DECLARATION.match(line):
            for name in match["names"].partition("=")[0].split(","):
                self.names.declare(routine, re.split(r"[\[\s]", name.strip())[0])
            line, start = match["names"], start + match.start("names")
        if match := ASSIGNMENT.match(line):
            text, name = line[match.end() :], match["base"]
            statement = Statement(text, start + match.end())
            value = statement.only_value
            is_whole = statement.group(value, "{") and not match["part"] and not match["field"]
            is_local = self.names.is_local(routine, name)
            literal = Declared("", statement, value) if is_whole and is_local else None
            self.names.assign(routine, name, literal, "is assigned in the program")
            self.names.note_sources(name, text)
        for call in CALL.finditer(without_strings(line)):
            name, inputs = call[1].upper(), self.inputs.get(call[1].upper(), [])
            if name in FUNCTIONS - {"SREAD", "CREAD"}:
                continue
            for parameter in self.names.parameters[name]:
                self.names.note_sources(parameter, line[call.end() :])
            for number, argument in enumerate(re.split(r"[,()]", line[call.end() :])):
                word = re.split(r"[.\[]", argument.strip())[0]
                if WORD.fullmatch(word) and not (number < len(inputs) and inputs[number]):
                    self.names.assign(routine, word, None, f"may be changed by {name}(..)")

    def _items(self, routine: str, start: int, line: str) -> Iterator[Any]:
        """Yield the items of a statement."""
        word = re.match(r"[$\w]*", line)[0].upper()  # type: ignore[index]
        where = f"not read: {' '.join(line.split())[:60]}"
        if match := MOTION.match(line):
            yield from self._calls(WITH.split(line)[0][match.end() :], where)
            yield self._motion(routine, start, line, match)
            return
        if word in ("SPLINE", "PTP_SPLINE", "ENDSPLINE"):
            self.spline = self._with(routine, start, line)
            return
        if action := ACTION.match(line):
            if call := CALL.match(line, action.end()):
                self.routines.get(call[1].upper(), Routine("")).entry = "interrupt"
            yield Jump("if")
            yield from self._items(routine, start + action.end(), line[action.end() :])
            yield Jump("endif")
            return
        calls = self._calls(line, where)
        if word in FLOW:
            yield from headed(FLOW[word], calls)
            return
        yield from calls
        if word == "GOTO":
            yield Jump("goto", line.split()[-1].upper())
        elif label := re.fullmatch(r"(\w+)\s*:", line):
            yield Jump("label", label[1].upper())
        elif word == "BAS":
            yield from self._bas(line, where)
        elif match := ASSIGNMENT.match(line):
            yield from self._assignment(routine, start, line, match, where)
        elif not (DECLARATION.match(line) or HARMLESS.match(line) or CALL.match(line)):
            yield self._lost(where)

    def _lost(self, cause: str) -> Setting:
        """Return the effect of an unknown statement."""
        return Setting(lost_state(STATE, cause))

    def _calls(self, line: str, where: str) -> Iterator[Any]:
        """Yield calls of routines of this file, and what unknown ones may do."""
        for match in CALL.finditer(without_strings(line)):
            name = match[1].upper()
            if name in self.routines:
                yield from called(name, match.start() == 0)
                if not all(self.inputs[name]) and FRAME_NAME.search(line, match.end()):
                    yield self._lost(where)
            elif name not in self.functions and not name.startswith("EKI_"):
                yield self._lost(call_text(where, name))

    def _bas(self, line: str, where: str) -> Iterator[Any]:
        """Yield the effect of BAS(#..)."""
        match = re.match(r"BAS\s*\(\s*#\s*(\w+)\s*,?\s*([^)]*?)\s*\)", line, re.IGNORECASE)
        command, number = (match[1].upper(), match[2]) if match else ("", "")
        if command in ("BASE", "TOOL"):
            key = f"{command}_DATA[{number}]"
            value: Any = Unknown(where)
            if re.fullmatch(r"\d+|-1", number):
                value = Frame(key, NO_FRAME) if number in ("0", "-1") else Value(key)
            yield Setting({command.lower(): value})
        elif command in ("FRAMES", "CP_PARAMS", "PTP_PARAMS"):
            yield Setting({key: Value(f"fdat {key}") for key in ("base", "tool", "mode")})
        elif command == "INITMOV":
            yield Setting({key: STATE[key] for key in ("base", "tool", "mode")})
        elif not re.match(r"(VEL|ACC)_|(OV_PRO|(PTP|CP)_DAT)$", command):
            yield self._lost(where)

    def _assignment(
        self, routine: str, start: int, line: str, match: re.Match[str], where: str
    ) -> Iterator[Any]:
        """Yield the effect of an assignment on the state."""
        base, part, field = match["base"].upper(), match["part"] or "", match["field"]
        statement = Statement(line[match.end() :].rstrip(), start + match.end())
        value = statement.only_value
        if base in ("$BASE", "$TOOL", "BASE_DATA", "TOOL_DATA"):
            key = base[1:].lower()
            frame, is_read = self._frame(routine, base, statement, value), not part
            if base[0] != "$":
                is_read = bool(TABLE.fullmatch(base + part))
                key = base + part if is_read else f"{base}*"
                frame = frame._replace(name=key) if isinstance(frame, Frame) else frame
            yield Setting({key: frame if is_read and not field else Unknown(where)})
        elif base == "FDAT_ACT":
            frames = None if field or part else self._fdat(routine, statement, value)
            frames = frames or dict.fromkeys(("base", "tool", "mode"), Unknown(where))
            yield Setting({f"fdat {key}": frame for key, frame in frames.items()})
        elif base == "$IPO_MODE":
            yield Setting({"mode": _mode(statement.word(value))})
        elif base[0] == "$" and not HARMLESS_VARIABLE.match(base):
            yield self._lost(where)

    def _frame(self, routine: str, side: str, statement: Statement, value: Any) -> Any:
        """Return the frame that a value is."""
        cause = Unknown(f"not read: {side}={' '.join(statement.text.split())[:50]}")
        name = statement.name(value).upper()
        if name in ("$NULLFRAME", "$WORLD"):
            return Frame(name, NO_FRAME)
        if TABLE.fullmatch(name):
            return Value(name)
        if statement.word(value).upper() in OF_DATA:
            return self._of_data(routine, statement, value) or cause
        declared, _ = self.names.literal(routine, statement, value)
        components = _components(declared.statement, declared.value) if declared else {}
        numbers = [components.get(name) for name in POSE]
        if not all(isinstance(number, Number) for number in numbers):
            return cause
        return Frame(side, tuple(number.value for number in numbers))  # type: ignore[union-attr]

    def _of_data(self, routine: str, statement: Statement, value: Any) -> Any:
        """Return what a function of `OF_DATA` takes from frame data; None: not literal."""
        function = statement.word(value)
        arguments = statement.group(value, "(", function.lower()) or [()]
        name = re.sub(r"\.(BASE_NO|TOOL_NO|IPO_FRAME)$", "", statement.name(arguments[0]).upper())
        data = self._fdat(routine, Statement(name, 0), (0,)) if name else None
        return data and data[OF_DATA[function.upper()]]

    def _fdat(self, routine: str, statement: Statement, value: Any) -> dict[str, Any] | None:
        """Return base, tool and mode of an inline form's frame data; None: not literal."""
        declared, _ = self.names.literal(routine, statement, value)
        components = _components(declared.statement, declared.value) if declared else {}
        base, tool = components.get("BASE_NO"), components.get("TOOL_NO")
        if not isinstance(base, Number) or not isinstance(tool, Number):
            return None
        frames: dict[str, Any] = {"mode": _mode(str(components.get("IPO_FRAME", "#BASE")))}
        for side, number in (("base", base.value), ("tool", tool.value)):
            key = f"{side.upper()}_DATA[{number:g}]"
            frames[side] = Frame(key, NO_FRAME) if number <= 0 else Value(key)
        return frames

    def _with(self, routine: str, start: int, line: str) -> dict[str, Any]:
        """Return frames and mode of a WITH clause."""
        match, values = WITH.search(line), dict[str, Any]()
        if match is None:
            return values
        clause = Statement(APPROXIMATION.sub("", line)[match.end() :], start + match.end())
        for part, place in clause.parts():
            key, _, text = (word.strip() for word in part.partition("="))
            statement = Statement(text, place + len(part) - len(text))
            value = statement.only_value
            if key.upper() in ("$BASE", "$TOOL"):
                values[key[1:].lower()] = self._frame(routine, key, statement, value)
            elif key.upper() == "$IPO_MODE" and statement.word(value).upper() in OF_DATA:
                mode = self._of_data(routine, statement, value)
                values["mode"] = mode or Unknown(f"not read: {text}")
            elif key.upper() == "$IPO_MODE":
                values["mode"] = _mode(text)
            elif not HARMLESS_VARIABLE.match(key):
                values["mode"] = Unknown(f"not read: WITH {part.strip()[:40]}")
        if not clause.is_closed:
            values["mode"] = Unknown("the brackets of WITH do not close")
        return values

    def _motion(self, routine: str, start: int, line: str, match: re.Match[str]) -> Motion:
        """Return a motion with its points."""
        word, place = match["word"].upper(), match.end()
        is_circle = "CIRC" in word
        kind = "circle" if is_circle else "joint" if word.endswith("PTP") else "linear"
        frames = self.spline | self._with(routine, start, line)
        mode = frames.pop("mode", None)
        motion = Motion(start, start + len(line), routine, kind, needs=NEEDS, **frames)
        if match["rel"]:
            motion.is_relative = not is_circle
            motion.reason = "is relative to the target before"
            return motion
        main = WITH.split(line, maxsplit=1)[0][place:]
        statement = Statement(APPROXIMATION.sub("", main), start + place)
        values = [*statement.values]
        if is_circle and len(values) == 3 and statement.word(values[2]).upper().startswith("CA"):
            values.pop()
            motion.ends_at_goal = False
        if len(values) != 1 + is_circle:
            motion.reason = "cannot be read"
        elif isinstance(mode, Unknown):
            motion.reason = mode.cause
        motion.needs = NEEDS[1:] if mode else NEEDS
        motion.goals = tuple(self._goal(routine, statement, value) for value in values)
        if word == "SPL":
            motion.goals = tuple(replace(goal, config=()) for goal in motion.goals)
        return motion

    def _goal(self, routine: str, statement: Statement, value: Any) -> Goal:
        """Return a point: an aggregate, or a name that has one."""
        text_index = 0
        if statement.group(value, "{") is None:
            name = statement.name(value)
            if not name or "." in name:
                text = " ".join(statement.text.split())[:60]
                return Goal(reason=f"target {text} is an expression")
            declared, cause = self.names.find(routine, name)
            if declared is None:
                return Goal(reason=f"target {name} {cause}")
            statement, value, text_index = declared.statement, declared.value, declared.text_index
        components = _components(statement, value)
        has_joints = not components.keys().isdisjoint(JOINTS)
        names = JOINTS if has_joints else POSE
        for name, number in components.items():
            if isinstance(number, str) and (name in names or name in EXTERNAL):
                return Goal(reason=f"{name} {number} is an expression")
        numbers: Any = tuple(map(components.get, names))
        if not any(numbers):
            return Goal(reason="the target has no position")
        axes: Any = map(components.get, EXTERNAL)
        external = tuple(axis.value if axis else np.nan for axis in axes)
        config: Any = tuple(components[name] for name in ("S", "T") if name in components)
        if not all(isinstance(part, Number) and abs(part.value) < 2**31 for part in config) or (
            len(config) == 1
        ):
            return Goal(reason="S and T are not two literal numbers")
        if has_joints or not config:
            return Goal(numbers, has_joints, (), external, text_index)
        status, turn = config
        status = status._replace(value=float(int(status.value) & 7))
        return Goal(numbers, False, (status, turn), external, text_index)


def _lines(text: str) -> Iterator[tuple[int, str]]:
    """Yield the statements of a text, with their places."""
    for match in re.finditer(r"[^\s][^\r\n]*", text):
        yield match.start(), match[0].rstrip()


def _mode(word: str) -> Any:
    return "#BASE" if word.upper() == "#BASE" else Unknown(f"the tool is not on the robot: {word}")


def _components(statement: Statement, value: Any) -> dict[str, Number | str]:
    """Return the components of an aggregate: numbers, or the texts of other values."""
    components: dict[str, Number | str] = {}
    for inner in statement.group(value, "{") or ():
        words = [statement.tokens[item] for item in inner if isinstance(item, int)]
        while len(words) > 2 and (words[0][0].endswith(":") or words[1][0] == ":"):
            words = words[1 + (words[1][0] == ":") :]  # its type: {E6POS: X 0}
        name = words[0][0].upper() if words else "?"
        number = statement.number(inner[-1:]) if len(words) == 2 else None
        components[name] = number or statement.word(inner)[len(name) :]
    return components


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
    metres=1e-3,
    radians=float(np.pi / 180.0),
    n_turns=3,
    motion=re.compile(
        r"(?<![\w$.#])(?:S?PTP|S?LIN|S?CIRC|SPL)(?:_REL)?(?:[ \t]+[A-Z$]|[ \t]*[{(])", re.I
    ),
    decimals=(4, 5),
    reader=_Reader,
    to_rotations=lambda turns: euler_rotations("ZYX", turns),
    configurations=configurations,
    companions=("*.dat", "$config.dat"),
    matches=matches,
    config_names=("S", "T"),
    external_names=EXTERNAL,
)
