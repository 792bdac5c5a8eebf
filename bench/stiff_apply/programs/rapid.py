r"""Read ABB RAPID: targets of a module, and its targets, tools and work objects.

Lengths are in mm, joint angles in deg, orientations quaternions, w first. Each robtarget has a
configuration [cf1, cf4, cf6, cfx] (Technical reference manual: RAPID instructions, functions and
data types, "confdata"): with `ConfL\On`, the default, a controller stops if it does not fit.
"""

from __future__ import annotations

import math
import re
from collections.abc import Collection, Iterator, Sequence
from typing import Any

import numpy as np

from stiff_apply.programs.flow import (
    LAST,
    Call,
    Frame,
    Jump,
    Routine,
    Setting,
    Unknown,
    call_text,
    called,
    headed,
    lost_state,
)
from stiff_apply.programs.program import NEAR_ZERO, Goal, Language, Motion
from stiff_apply.programs.statements import (
    WORD,
    Declared,
    Names,
    Statement,
    without_comments,
    without_strings,
)
from stiff_apply.rotations import quaternion_rotations, quaternions
from stiff_protocols.contract.types import FloatArray

COMMENT = re.compile(r"\"(?:[^\"\r\n]|\"\")*\"|![^\r\n]*")
STRING = r"\"(?:[^\"\r\n]|\"\")*+\""
UNTIL = rf"(?:{STRING}|[^;\"])*?"
STATEMENT = re.compile(
    r"\s*+(?P<text>"
    r"(?P<routine>(?:LOCAL\s+)?(?:(?:PROC|TRAP)\s+\w+|FUNC\s+\w+\s+\w+)\b\s*(?:\([^)]*\))?)"
    r"|%%%[^%]*%%%|MODULE\s+\w+(?:\s*\([^)]*\))?|RECORD\s+\w+|(?:ELSE|ERROR|UNDO|BACKWARD|END(?:MODULE|PROC|FUNC"
    r"|TRAP|IF|FOR|WHILE|TEST|RECORD))\b(?!\s*:?=)"
    rf"|ELSEIF\b{UNTIL}\bTHEN\b|IF\b{UNTIL}(?:\bTHEN\b|;)|(?:FOR|WHILE)\b{UNTIL}\bDO\b"
    rf"|TEST\b{UNTIL}(?=\b(?:CASE|DEFAULT)\b)|CASE\b(?:{STRING}|[^:\"])*:|DEFAULT\s*:|[A-Z_]\w*\s*:(?!=)"
    rf"|(?:{STRING}|[^;\"])+;|[^\s]+)",
    re.IGNORECASE,
)
FLOW = {
    **{"ELSE": "else", "ELSEIF": "case", "ENDIF": "endif", "FOR": "loop", "WHILE": "loop"},
    **{"ENDFOR": "endloop", "ENDWHILE": "endloop", "TEST": "switch", "CASE": "case"},
    **{"DEFAULT": "else", "ENDTEST": "endif", "RETURN": "return", "EXIT": "return"},
    **dict.fromkeys(("ERROR", "UNDO", "BACKWARD"), "handler"),
    **{"RAISE": "return", "EXITCYCLE": "return", "RETRY": "retry", "TRYNEXT": "retry"},
}
DATA = re.compile(
    r"(?:(?:LOCAL|TASK)\s+)*(?P<store>CONST|PERS|VAR)\s+(?P<type>\w+)\s+(?P<name>\w+)"
    r"(?P<array>\s*\{[^}]*\})?\s*(?::=(?P<value>.*))?;",
    re.IGNORECASE | re.DOTALL,
)
ASSIGNMENT = re.compile(r"(?P<name>[A-Z_]\w*)[\w.{}\s,+*-]*:=", re.IGNORECASE)
MOTION = re.compile(
    r"(?P<word>(?P<family>Move|Trigg|Arc|Search|Paint|Disp|Spot|Cap|Laser)(?P<form>L|J|C|AbsJ|ExtJ)"
    r"(?P<more>DO|AO|GO|Sync|Start|End|IOs|[12])?|Ind[ACDR]Move|EGMMove[LC])(?=[\s\\])(?!\s*:?=)",
    re.IGNORECASE,
)
PLACES = {"move": 3, "trigg": 4, "arc": 5}
"""Word of a motion -> place of its tool among the arguments after the points, from 1."""
WRITER = re.compile(r"(?:Add|Incr|Decr|Clear|Read\w+|GetSysData|Bit\w+)\b", re.IGNORECASE)
"""Harmless instructions whose arguments get new values."""
SEARCH = re.compile(r"Search\w\s*(?:\\\w+\s*,)?[^,]*,\s*(\w+)", re.IGNORECASE)
HARMLESS = re.compile(
    r"(?:Set(?:DO|AO|GO|DataSearch)?|Reset|InvertDO|PulseDO|TP(?:Erase|Read\w+|Show|Write)|UI(?:MsgBox|Show)"
    r"|Wait(?:[ADG][IO]|Load|Rob|SyncTask|TestAndSet|Time|Until)"
    r"|AccSet|VelSet|PathAccLim|WorldAccLim|SpeedRefresh|SingArea|CirPathMode|GripLoad|MechUnitLoad"
    r"|Incr|Decr|Add|Clear|Clk(?:Start|Stop|Reset)|Open|Close|Rewind|BookErrNo|Break"
    r"|(?:Write|Read)(?:\w*Bin|Block|RawBytes|Var(?:Arr)?|CfgData|ErrData)|Write|Err(?:Log|Raise|Write)"
    r"|Stop(?:Move(?:Reset)?)?|StartMove(?:Retry)?|WZ\w+|(?:Store|Resto|Clear)Path"
    r"|Trigg(?:Equip|IO|Int|Speed|CheckIO|RampAO|Data\w+|Stop\w+)|I(?:Signal\w+|Delete|Enable"
    r"|Disable|Timer|Sleep|Watch|Error|Pers|VarValue)|CONNECT|ActUnit|DeactUnit|Load|UnLoad"
    r"|StartLoad|Save|MotionSup|Socket(?:Accept|Bind|Close|Connect|Create|Listen|Receive\w*|Send\w*)|ClearIOBuff|SystemStopAction|SkipWarn|ResetRetryCount|RemoveFile|ProcerrRecovery"
    r"|PathResol|GetSysData|ActEventBuffer|DeactEventBuffer|BitSet|BitClear|CorrCon|CorrDiscon|CorrClear"
    r"|CorrWrite)\b"
    r"|(?:ALIAS|LOCAL|TASK|CONST|PERS|VAR|MODULE|ENDMODULE|RECORD|ENDRECORD)\b",
    re.IGNORECASE,
)
SETTING = re.compile(
    r"(?P<word>PDisp|EOffs|Soft|ConfL|ConfJ|SyncMove)(?P<way>On|Off|Set|Act|Deact)?(?=[\s;\\])"
    r"[\s\\]*(?P<switch>On|Off)?\b",
    re.IGNORECASE,
)
STATE: dict[str, Any] = {
    **{LAST: None, "pdisp": "", "eoffs": "", "soft": "", "syncmove": "", "other": ""},
    **{"confl": True, "confj": True},
}
NEEDS = ("pdisp", "eoffs", "soft", "syncmove", "other")
CALL = re.compile(r"(?<![\w\\])([A-Z_]\w*)\s*\(", re.IGNORECASE)
ARGUMENTS = re.compile(r"(?:[^()]|\((?:[^()]|\([^()]*\))*\))*")
FUNCTIONS = re.compile(
    r"A(?:bs|rgName)|[AGD](?:In|Out)put(?:Dnum)?|A?(?:Cos|Sin|Tan2?)|Bit\w+|Byte(?:ToStr)?|ClkRead"
    r"|C(?:alc(?:Joint|Rob)T|JointT|RobT|Pos|Tool|WObj|Date|Time|orrRead|SpeedOverride)|Dim|DotProd"
    r"|Def(?:Acc|D)?Frame|Distance|(?:Dec|Hex)To(?:Dec|Hex)|\w+To(?:Dnum|Num|Str|Val|Byte)|Exp"
    r"|E(?:ulerZYX|ventType|xec(?:Handler|Level))|F(?:ile(?:Size|Time)|SSize)|Get(?:MecUnitName"
    r"|MotorTorque|NextMechUnit|NextSym|ServiceInfo|SignalOrigin|SysInfo|TaskName|Time)|IndInpos"
    r"|IndSpeed|Is(?:File|MechUnitActive|Pers|StopMoveAct|SyncMoveOn|SysId|Var)|MaxRobSpeed|MirPos"
    r"|Mod(?:Exist|Time)|N?Orient(?:ZYX)?|Offs|OpMode|ORobT|PathLevel|Pose(?:Inv|Mult|Vect)|Pow"
    r"|Present|ProgMemFree|PFRestart|Quad|RawBytesLen|Read(?:Bin|Dir|Motor|Num|Str|StrBin|Var)"
    r"|RelTool|RemainingRetries|Rob(?:Name|OS)|Round|RunMode|Socket(?:GetStatus|Peek)|Sqrt"
    r"|Str(?:Dig\w+|Find|Format|Len|Map|Match|Memb|Order|Part)|Task(?:RunMec|RunRob|sInSync)"
    r"|Test(?:AndSet|DI|SignRead)|Text\w+|Trigg?DataValid|Trunc|Type|ValidIO|VectMagn"
    r"|UI(?:AlphaEntry|ClientExist|D?numEntry|D?numTune|ListView|MessageBox)|AND|OR|NOT|XOR|DIV"
    r"|MOD|FROM|TO|STEP|OF",
    re.IGNORECASE,
)
"""Functions of the language; others may set the state and change their arguments."""
LITERALS = {"robtarget": [3, 4, 4, 6], "jointtarget": [6, 6]}
"""Type of a target -> counts of its numbers: position, quaternion, confdata, external axes."""
CLOSE = {"[": "]", "(": ")", "{": "}"}
KNOWN_FRAMES = dict.fromkeys(("tool0", "wobj0"), (0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0))
LARGEST_MM, UNIT_LENGTH_SLACK = 1e6, 1e-3
"""Limit of a frame's position, and tolerance of a quaternion's length, which is 1."""
UNUSED_AXIS = 9e8
"""External axes at or beyond this number (9E9) are not used."""


class _Reader:
    """Reads names first, then statements."""

    def __init__(self, texts: Sequence[str], harmless: Collection[str]) -> None:
        self.names, self.routines = Names(), {"": Routine("", entry="file")}
        self.frames: dict[tuple[str, str, str], Any] = {}
        self.harmless = {name.lower() for name in harmless}
        self.changing = set[str]()
        self.constants, self.passed = set[tuple[str, str]](), list[tuple[str, str, str]]()
        self.state, self.text = STATE, without_comments(texts[0], COMMENT)
        statements = [*self._by_routine(self.text)]
        for routine, start, statement in statements:
            self._note_names(routine.name, start, statement)
        for scope, name, call in self.passed:
            place = scope if self.names.is_local(scope, name) else ""
            if (place, name.lower()) not in self.constants:
                self.names.assign(scope, name, None, f"may be changed by {call}")
        self.names.finish()
        for routine, start, statement in statements:
            routine.items += self._items(routine.name, start, statement)

    def _by_routine(self, text: str) -> Iterator[tuple[Routine, int, str]]:
        """Yield statements with their routines; "" is outside of routines."""
        now = self.routines[""]
        for match in STATEMENT.finditer(f"{text}\n;"):
            statement, start = match["text"], match.start("text")
            if head := match["routine"]:
                name = re.split(r"[\s(]+", head.partition("(")[0].strip())[-1].lower()
                is_trap = re.match(r"(LOCAL\s+)?TRAP\b", head, re.IGNORECASE)
                now = Routine(name, entry="interrupt" if is_trap else "called")
                now = self.routines.setdefault(name, now)
                if re.search(r"\b(INOUT|VAR|PERS)\b", head, re.IGNORECASE):
                    self.changing.add(name)
                for part in re.split(r"[,|\\]", head.partition("(")[2].rstrip(") ")):
                    words = part.partition("{")[0].split()
                    self.names.declare_parameter(name, words[-1] if words else "")
            elif re.fullmatch(r"END(PROC|FUNC|TRAP)", statement, re.IGNORECASE):
                now = self.routines[""]
            else:
                yield now, start, statement

    def _note_names(self, routine: str, start: int, statement: str) -> None:
        """Note what a statement does to names."""
        if match := DATA.match(statement):
            declared = None
            if match["value"] and not match["array"]:
                value = Statement(match["value"], start + match.start("value"))
                declared = Declared(match["type"].lower(), value, (value.values or ((),))[0])
            self.names.declare(routine, match["name"], declared)
            self.names.note_sources(match["name"], match["value"] or "")
            if match["store"].upper() == "CONST":
                self.constants.add((routine, match["name"].lower()))
            return
        text = statement[_compact(statement) :]
        if match := ASSIGNMENT.match(text):
            self.names.assign(routine, match["name"], None, "is assigned in the program")
            self.names.note_sources(match["name"], text[match.end() :])
        first = re.match(r"[%\w]*", text)[0]  # type: ignore[index]
        patterns = (MOTION, SETTING, HARMLESS)
        is_known = match or first.lower() in self.routines or first.upper() in FLOW
        is_known = is_known or any(pattern.match(text) for pattern in patterns)
        arguments = ""
        if first.lower() in self.changing or WRITER.match(text) or not is_known:
            arguments = text[len(first) :]
        elif search := SEARCH.match(text):
            arguments = search[1]
        for name, end in self._functions(statement):
            if name in self.changing or name not in self.routines:
                arguments += ARGUMENTS.match(statement, end)[0]  # type: ignore[index]
        for name in {word.lower() for word in WORD.findall(text)} & self.routines.keys():
            for parameter in self.names.parameters[name]:
                self.names.note_sources(parameter, text)
        self.passed += [(routine, word, first or text[:20]) for word in WORD.findall(arguments)]

    def _items(self, routine: str, start: int, statement: str) -> Iterator[Any]:
        """Yield the items of a statement."""
        word = re.match(r"\w*", statement)[0].upper()  # type: ignore[index]
        short = " ".join(statement.split())[:60]
        if compact := _compact(statement):
            yield from self._calls(statement[:compact])
            yield Jump("if")
            yield from self._items(routine, start + compact, statement[compact:])
            yield Jump("endif")
            return
        calls = self._calls(statement)
        if word in ("IF", *FLOW) and not ASSIGNMENT.match(statement):
            yield from headed(FLOW.get(word, "if"), calls)
            return
        yield from calls
        if match := MOTION.match(statement):
            yield self._motion(routine, start, statement, match)
            if not match["family"] or match["form"].lower() == "extj":
                yield Setting({"other": Unknown(f"moved by {match['word']}")})
            if (match["more"] or "").lower() == "sync":
                name = re.split('"', f'{statement}""')[1]
                if name.lower() in self.routines:
                    yield from called(name.lower(), is_sure=False)
                elif name.lower() not in self.harmless:
                    yield Setting(lost_state(STATE, call_text(f"not read: {short}", name)))
            return
        if ASSIGNMENT.match(statement) or DATA.match(statement) or not statement.strip(" ;"):
            return
        if label := re.fullmatch(r"([A-Z_]\w*)\s*:", statement, re.IGNORECASE):
            yield Jump("label", label[1].lower())
        elif word == "GOTO":
            yield Jump("goto", statement[4:].strip(" ;\r\n\t").lower())
        elif match := SETTING.match(statement):
            key, way = match["word"].lower(), (match["way"] or match["switch"] or "").lower()
            ways = {"on": True, "off": False} if key[:4] == "conf" else {"off": "", "deact": ""}
            yield Setting({key: ways.get(way, Unknown(f"moved by {short}"))})
        elif word and word.lower() in self.routines:
            yield Call(word.lower())
        elif not HARMLESS.match(statement) and word.lower() not in self.harmless:
            point = Statement(statement[len(word) :].rstrip(" ;\r\n\t"), start + len(word))
            goals = [self._goal(routine, point, value, "") for value in point.values[:2]]
            if routine and not all(goal.reason for goal in goals):
                reason = f"{word} is not read"
                yield Motion(start, start + len(statement), routine, "linear", reason=reason)
            yield Setting(lost_state(STATE, call_text(f"not read: {short}", word.capitalize())))

    def _functions(self, statement: str) -> Iterator[tuple[str, int]]:
        """Yield the functions that a statement calls, and the places of their arguments."""
        for call in CALL.finditer(without_strings(statement)):
            name = call[1].lower()
            if name in self.routines or not (FUNCTIONS.fullmatch(name) or call.start() == 0):
                yield name, call.end()

    def _calls(self, statement: str) -> Iterator[Any]:
        """Yield calls of functions of this file, and what unknown ones may do."""
        for name, end in self._functions(statement):
            if name in self.routines:
                yield from called(name, is_sure=False)
            elif name not in self.harmless:
                cause = f"not read: {statement[end - len(name) - 1 :][:40]}"
                yield Setting(lost_state(STATE, call_text(cause, name)))

    def _motion(self, routine: str, start: int, text: str, match: re.Match[str]) -> Motion:
        """Return a motion with its points."""
        form, family = (match["form"] or "").lower(), (match["family"] or "").lower()
        kind = "circle" if form == "c" else "joint" if form.endswith("j") else "linear"
        motion = Motion(start, start + len(text), routine, kind, needs=NEEDS)
        more = (match["more"] or "").lower()
        is_read = family in PLACES and form != "extj" and more not in ("sync", "ios")
        statement = Statement(text[match.end() :].rstrip(" ;\r\n\t"), start + match.end())
        values = [*statement.values]
        while values and statement.word(values[0]).startswith("\\"):
            values.pop(0)  # MoveL \Conc, p10, ...
        n_points = 1 + (kind == "circle")
        if not is_read or len(values) < n_points + PLACES[family]:
            motion.reason = f"{match['word']} {'cannot be' if is_read else 'is not'} read"
            return motion
        expected = "robtarget"
        if form == "absj":
            expected, motion.needs = "jointtarget", NEEDS[2:]
        else:
            motion.config_key = "confj" if kind == "joint" else "confl"
        points = values[:n_points]
        motion.goals = tuple(self._goal(routine, statement, point, expected) for point in points)
        tool, *options = _words(statement, values[n_points + PLACES[family] - 1])
        named = dict(
            option.lower().replace("?", ":=", 1).partition(":=")[::2]  # \WObj?WObj: if it is given
            for option in options
        )
        if "corr" in named:
            motion.reason = "moved by \\Corr"
        motion.tool = self._frame(routine, tool, "tooldata")
        motion.base = self._frame(routine, named.get("wobj", "wobj0"), "wobjdata")
        return motion

    def _goal(self, routine: str, statement: Statement, value: Any, expected: str) -> Goal:
        """Return a point: an array of numbers, or a name that has one."""
        name, *_ = _words(statement, value)
        kind, literal = expected, value[:1]
        if name != "[..]":
            declared, cause = self.names.find(routine, name)
            if declared is None:
                cause = cause if WORD.fullmatch(name) else "is an expression"
                return Goal(reason=f"target {name} {cause}")
            statement, literal, kind = declared.statement, declared.value, declared.kind
        rows = [statement.numbers(row, "[") or [] for row in statement.group(literal, "[") or ()]
        kind, sizes = kind or "robtarget", [len(row) for row in rows]
        if kind != (expected or kind) or kind not in LITERALS or sizes != LITERALS[kind]:
            return Goal(reason=f"not a literal {expected}")
        axes = tuple(np.nan if abs(axis.value) > UNUSED_AXIS else axis.value for axis in rows[-1])
        if kind == "jointtarget":
            return Goal(tuple(rows[0]), True, (), axes)
        length = math.hypot(*(number.value for number in rows[1]))
        if not abs(length - 1.0) <= UNIT_LENGTH_SLACK:
            return Goal(reason=f"its quaternion has the length {length:.4g}, not 1")
        return Goal((*rows[0], *rows[1]), False, tuple(rows[2]), axes)

    def _frame(self, routine: str, name: str, kind: str) -> Any:
        """Return a tool or work object by name."""
        key = (routine if self.names.is_local(routine, name) else "", name.lower(), kind)
        if key[1] in KNOWN_FRAMES:
            return Frame(name, KNOWN_FRAMES[key[1]])
        if key not in self.frames:
            declared, cause = self.names.find(routine, name)
            if not WORD.fullmatch(name):
                self.frames[key] = Unknown(f"{kind} {name} is an expression")
            elif declared is None and not self.names.is_used(routine, name):
                self.frames[key] = Frame(name)  # of another module
            elif declared is None or declared.kind != kind:
                self.frames[key] = Unknown(f"{kind} {name} {cause or f'is not {kind}'}")
            else:
                self.frames[key] = _frame_of(name, declared)
        return self.frames[key]


def _words(statement: Statement, value: Any) -> list[str]:
    """Return the words of a value between backslashes, with its groups as "[..]"."""
    texts = [
        statement.tokens[item][0]
        if isinstance(item, int)
        else f"{item.bracket}..{CLOSE[item.bracket]}"
        for item in value
    ]
    return "".join(texts).split("\\")


def _compact(statement: str) -> int:
    """Return where the instruction of a one-line IF begins; 0: it is none."""
    if not re.match(r"IF\b", statement, re.I) or re.search(r"\bTHEN\s*$", statement, re.I):
        return 0
    depth, is_operand = 0, False
    for token in re.finditer(rf"{STRING}|[\w.$]+|[^\s\w]", statement[2:]):
        text = token[0]
        if text in "([{" or text in ")]}":
            depth += 1 if text in "([{" else -1
            is_operand = text in ")]}"
        elif re.match(r"[\w\"$]", text):
            is_operator = text.upper() in ("AND", "OR", "NOT", "XOR", "DIV", "MOD")
            if is_operand and not is_operator and not depth:
                return token.start() + 2
            is_operand = not is_operator
        else:
            is_operand = False
    return 0


def _frame_of(name: str, declared: Declared) -> Any:
    """Return position and quaternion of literal tooldata or wobjdata."""
    statement, is_tool = declared.statement, declared.kind == "tooldata"
    values = statement.group(declared.value, "[") or ()
    words = [statement.word(value).upper() for value in values]
    poses, valid = [], "a tool on the robot" if is_tool else "a work object that does not move"
    for value in values:
        rows = [statement.numbers(row, "[") or [] for row in statement.group(value, "[") or ()]
        if [len(row) for row in rows] == [3, 4]:
            poses.append([number.value for row in rows for number in row])
    expected = ["TRUE"] if is_tool else ["FALSE", "TRUE"]
    if len(poses) != (1 if is_tool else 2) or words[: len(expected)] != expected:
        return Unknown(f"{declared.kind} {name} is not {valid}, all numbers literal")
    position, turn = np.zeros(3), np.eye(3)
    for pose in np.array(poses):
        length = float(np.linalg.norm(pose[3:]))
        if not np.abs(pose).max() <= LARGEST_MM or not abs(length - 1.0) <= UNIT_LENGTH_SLACK:
            return Unknown(f"{declared.kind} {name} has a number beyond the limits")
        position = position + turn @ pose[:3]
        turn = turn @ quaternion_rotations(pose[None, 3:])[0]
    return Frame(name, (*position.tolist(), *quaternions(turn[None])[0].tolist()))


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
    metres=1e-3,
    radians=float(np.pi / 180.0),
    n_turns=4,
    motion=re.compile(r"\bMove(?:L|J|C|AbsJ)\b(?=[\s\\])(?!\s*:?=)", re.I),
    decimals=(4, 5),
    reader=_Reader,
    to_rotations=quaternion_rotations,
    configurations=configurations,
    config_names=("cf1", "cf4", "cf6", "cfx"),
    config_of_linear=True,
    external_names=("eax_a", "eax_b", "eax_c", "eax_d", "eax_e", "eax_f"),
)
