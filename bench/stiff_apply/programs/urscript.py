"""Read URScript: targets of a .script program, in m and rad, with rotation vectors.

A pose p[x, y, z, rx, ry, rz] places the tool frame of `set_tcp` in the robot's base frame
(Universal Robots, script manual, module motion). It has no configuration: the arm keeps the
configuration of the previous joint angles.
"""

from __future__ import annotations

import re
from collections.abc import Collection, Iterator, Sequence
from typing import Any

from stiff_apply.programs.flow import (
    LAST,
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
from stiff_apply.programs.program import NO_FRAME, Goal, Language, Motion
from stiff_apply.programs.statements import (
    WORD,
    Declared,
    Names,
    Statement,
    without_comments,
    without_strings,
)
from stiff_apply.rotations import vector_rotations

COMMENT = re.compile(r"\"[^\"\r\n]*\"|#[^\r\n]*")
BREAK = re.compile(r"\"[^\"\r\n]*\"|[\[({]|[\])}]|[\r\n;]+|$")
NEXT = re.compile(
    r"\s*(?:(?:move|servo|speed|optimove)[a-z]*\s*\(|set_tcp\s*\(|(?:def|thread|end|if|elif|else"
    r"|while|global|local|return)\b)"
)
"""Begin of a statement: brackets before it were not closed."""
PART = re.compile(r"\"[^\"]*\"|\w+|[^\s\w]")
"""A word, a bracket or another character of a line."""
OPERATORS = ("and", "or", "not", "xor")
HEAD = re.compile(r"(?P<word>if|elif|else|while|for|def|thread|sec|switch|case|default)\b")
FLOW = {
    **{"if": "if", "elif": "case", "else": "else", "while": "loop", "for": "loop"},
    **{"switch": "switch", "case": "case", "default": "else", "break": "break"},
    **{"continue": "continue", "return": "return", "halt": "return"},
}
ASSIGNMENT = re.compile(
    r"(?:(?P<scope>global|local)\s+)?(?P<name>\w+)(?P<part>(?:\[[^\]]*\]|\.\w+)*)\s*=(?!=)"
)
MOTION = re.compile(
    r"(?P<word>(?:move|servo|speed|optimove)[a-z])\s*(?P<arguments>\(.*)", re.DOTALL
)
KINDS = {"movel": "linear", "movep": "linear", "movec": "circle", "movej": "joint"}
JOINT_MOTIONS = ("servoj", "speedj", "optimovej")
POINTS = ("pose", "q", "pose_via", "pose_to")
"""Names of the arguments that are points."""
CALL = re.compile(r"(?<![\w.])([A-Za-z_]\w*)\s*\(")
FUNCTIONS = re.compile(
    r"get_(?:(?:actual|target)_(?:joint|tcp|tool_flange|payload|waypoint)\w*|(?:inverse|forward)_kin\w*"
    r"|tcp_(?:force|offset)|tool_(?:accelerometer_reading|current)|joint_(?:temp|torques)|steptime"
    r"|controller_temp|conveyor_tick_count|gravity|flag|list_length|freedrive_status|jacobian\w*"
    r"|(?:mass|coriolis)_\w+|euromap_\w+)|is_(?:steady|within_safety_limits)"
    r"|[gs]et_(?:(?:standard|configurable|tool)_)?(?:digital|analog)_\w+"
    r"|set_(?:tool_(?:voltage|communication|output_mode)|flag|(?:target_)?payload|payload_(?:mass|cog)"
    r"|gravity|conveyor_tick_count|input_actions\w+|(?:runstate|euromap|gp|safety_mode|baselight)_\w+)"
    r"|(?:read|write)_(?:input|output|port)_\w+|(?:socket|rtde|modbus|encoder)_\w+|rpc_factory"
    r"|pose_(?:add|sub|dist|inv|trans)|str_(?:at|cat|empty|find|len|sub)|to_(?:num|str)"
    r"|request_\w+_from_primary_client|zero_ftsensor|(?:end_)?(?:freedrive|teach)_mode\w*"
    r"|tool_contact\w*|enable_external_ft_sensor|ft_rtde_input_enable|conveyor_pulse_decode|force_mode_set_\w+"
    r"|path_offset_set_(?:alpha_filter|max_offset)|interpolate_pose|rpy2rotvec|rotvec2rpy|wrench_trans|point_dist|inv|norm|normalize|dot|cross|length|size|floor|ceil"
    r"|sqrt|a?sin|a?cos|a?tan2?|exp|log|pow|abs|d2r|r2d|random|num_to_str|struct|make_list"
    r"|binary_list_to_integer|integer_to_binary_list|list_\w+|assert|sleep|sync|textmsg|popup"
    r"|stop[jl]|stopjl|force|halt|powerdown|time|protective_stop|position_deviation_warning"
    r"|reset_revolution_counter|program_extension_\w+|and|or|not|xor|if|elif|while|return"
)
EFFECTS = {
    **{"force_mode": ("force", True), "end_force_mode": ("force", False)},
    **{"track_conveyor_linear": ("conveyor", True), "track_conveyor_circular": ("conveyor", True)},
    **{"stop_conveyor_tracking": ("conveyor", False), "path_offset_enable": ("offset", True)},
    **{"path_offset_set": ("offset", True), "path_offset_disable": ("offset", False)},
}
"""Function -> key of the state, and whether motions are moved after it."""
NEEDS = ("force", "conveyor", "offset", "other")
STATE: dict[str, Any] = {LAST: None, "tool": Frame("set_tcp"), **dict.fromkeys(NEEDS, "")}


class _Reader:
    """Reads names first, then statements."""

    def __init__(self, texts: Sequence[str], harmless: Collection[str]) -> None:
        self.names, self.routines = Names(takes_single=True), {"": Routine("", entry="file")}
        self.harmless, self.remotes = {*harmless}, set[str]()
        self.state, self.text = STATE, without_comments(texts[0], COMMENT)
        statements = [*self._by_routine(self.text)]
        for routine, start, statement in statements:
            self._note_names(routine.name, start, statement)
        self.names.finish()
        for routine, start, statement in statements:
            routine.items += self._items(routine.name, start, statement)

    def _by_routine(self, text: str) -> Iterator[tuple[Routine, int, Any]]:
        """Yield statements with their routines; ends of blocks are jumps."""
        stack = [(self.routines[""], "")]
        for start, statement in _statements(text):
            now, word = stack[-1][0], ""
            if head := HEAD.match(statement):
                word = head["word"]
            if word in ("def", "thread", "sec"):
                match = re.match(r"\w+\s+(\w+)\s*\(?(.*)", statement, re.DOTALL)
                name = match[1] if match else "?"
                entry = "called" if word == "def" else "interrupt"
                routine = self.routines.setdefault(name, Routine(name, entry=entry))
                for part in match[2].split(",") if match else ():
                    self.names.declare_parameter(name, part.partition("=")[0].strip(" \t\r\n():"))
                stack.append((routine, word))
            elif re.fullmatch(r"end", statement):
                opened = stack.pop()[1] if len(stack) > 1 else "?"
                if opened not in ("def", "thread", "sec"):
                    yield now, start, Jump("endloop" if opened in ("while", "for") else "endif")
            else:
                if word in ("if", "while", "for", "switch"):
                    stack.append((now, word))
                yield now, start, statement

    def _note_names(self, routine: str, start: int, statement: Any) -> None:
        """Note what a statement does to names."""
        if isinstance(statement, Jump):
            return
        if match := ASSIGNMENT.match(statement):
            text = statement[match.end() :].strip()
            value = Statement(text, start + len(statement) - len(statement[match.end() :].lstrip()))
            if text.startswith("rpc_factory"):
                self.remotes.add(match["name"])
            is_literal = len(value.values) == 1 and re.match(r"p?\s*\[|struct\s*\(", text)
            literal = Declared("", value, value.values[0]) if is_literal else None
            if match["scope"] == "local":
                self.names.declare(routine, match["name"])
            assigned = None if match["part"] else literal
            self.names.assign(routine, match["name"], assigned, "is a variable")
            self.names.note_sources(match["name"], text)
        for call in CALL.finditer(without_strings(statement)):
            if call[1] in self.routines:
                for parameter in self.names.parameters[call[1]]:
                    self.names.note_sources(parameter, statement[call.end() :])

    def _items(self, routine: str, start: int, statement: Any) -> Iterator[Any]:
        """Yield the items of a statement."""
        if isinstance(statement, Jump):
            yield statement
            return
        where = f"not read: {' '.join(statement.split())[:60]}"
        word = re.match(r"\w*", statement)[0]  # type: ignore[index]
        if statement.startswith("$"):
            return
        match = MOTION.match(statement)
        is_call = re.match(r"\w+\s*\(", statement)
        if is_call and word == "set_tcp":
            yield Setting({"tool": self._tool(routine, statement, where)})
            return
        calls = self._calls(statement, match.start("arguments") if match else 0, where)
        if word in FLOW and not ASSIGNMENT.match(statement):
            yield from headed(FLOW[word], calls)
            return
        yield from calls
        if match:
            yield self._motion(routine, start, statement, match)
            return
        if not (
            is_call
            or ASSIGNMENT.match(statement)
            or (word in self.remotes and statement[len(word)] == ".")
            or word in ("run", "join", "kill", "pass")
            or word in ("enter_critical", "exit_critical", "global", "local")
        ):
            yield Setting(lost_state(STATE, where))

    def _calls(self, statement: str, place: int, where: str) -> Iterator[Any]:
        """Yield the calls of a statement after a place, and what unknown ones may do."""
        for call in CALL.finditer(without_strings(statement), place):
            name = call[1]
            if name in self.routines:
                yield from called(name, call.start() == 0)
            elif name in EFFECTS:
                key, moves = EFFECTS[name]
                yield Setting({key: Unknown(f"moved by {name}") if moves else ""})
            elif name not in self.harmless and not FUNCTIONS.fullmatch(name):
                yield Setting(lost_state(STATE, call_text(where, name)))

    def _tool(self, routine: str, statement: str, where: str) -> Any:
        """Return the tool of set_tcp(..)."""
        place = statement.index("(")
        arguments = _arguments(statement[place:], 0) or [("", Statement("", 0))]
        content = arguments[0][1]
        name = content.name(content.only_value)
        declared, _ = self.names.literal(routine, content, content.only_value)
        if declared is None:
            is_other = not self.names.is_used(routine, name) and "[" not in name
            return Frame(name) if is_other else Unknown(where)
        numbers = declared.statement.numbers(declared.value, "[", "p") or []
        if len(numbers) != 6:
            return Unknown(where)
        return Frame("set_tcp", tuple(number.value for number in numbers))

    def _motion(self, routine: str, start: int, text: str, match: re.Match[str]) -> Motion:
        """Return a motion with its points."""
        word = match["word"]
        kind = KINDS.get(word, "joint" if word in JOINT_MOTIONS else "linear")
        base = Frame("base", NO_FRAME)
        motion = Motion(start, start + len(text), routine, kind, base=base, needs=NEEDS)
        place = match.start("arguments")
        arguments = _arguments(text[place:].rstrip(), start + place)
        points = [point for keyword, point in arguments or () if keyword in ("", *POINTS)]
        n_points = 1 + (kind == "circle")
        if word not in KINDS or len(points) < n_points:
            motion.reason = f"{word} {'cannot be' if word in KINDS else 'is not'} read"
            return motion
        motion.goals = tuple(self._goal(routine, point) for point in points[:n_points])
        return motion

    def _goal(self, routine: str, statement: Statement) -> Goal:
        """Return a point: a pose, joint angles, or a name that has one."""
        text, name = " ".join(statement.text.split())[:60], statement.name(statement.only_value)
        declared, cause = self.names.literal(routine, statement, statement.only_value)
        if declared is None or "[" in name:
            return Goal(reason=f"target {text} {cause or 'is an expression'}")
        statement, value = declared.statement, declared.value
        if field := name.partition(".")[2]:
            place = statement.text.find("(")
            fields = dict(_arguments(statement.text[place:], statement.start + place) or ())
            statement = fields.get(field, Statement("", 0))
            value = statement.only_value
        pose, joints = statement.numbers(value, "[", "p"), statement.numbers(value, "[")
        numbers = pose or joints or []
        if len(numbers) != 6:
            return Goal(reason=f"target {text} is an expression, or not six numbers")
        return Goal(tuple(numbers), pose is None)


def _arguments(text: str, start: int) -> list[tuple[str, Statement]] | None:
    """Return keywords ("": none) and values between the brackets that a text is; None: it is not.

    Args:
        text: text that begins with a bracket.
        start: its place.
    """
    if not Statement(text, start).is_closed or text[-1:] != ")":
        return None
    arguments = []
    for part, place in Statement(text[1:-1], start + 1).parts():
        keyword = re.match(r"\s*(\w+)\s*=(?!=)", part)
        content = part[keyword.end() :] if keyword else part
        begin = place + len(part) - len(content.lstrip())
        arguments.append((keyword[1] if keyword else "", Statement(content.strip(), begin)))
    return arguments


def _statements(text: str) -> Iterator[tuple[int, str]]:
    """Yield the statements of a text, with their places; brackets may go over several lines."""
    depth, begin = 0, 0
    for match in BREAK.finditer(text):
        character = match[0][:1]
        depth += (character in "[({" and character != "") - (character in "])}" and character != "")
        depth = max(depth, 0)
        if character in ("\r", "\n", ";", "") and (
            not depth or not character or NEXT.match(text, match.end())
        ):
            yield from _split(text[begin : match.start()], begin)
            depth, begin = 0, match.end()


def _split(text: str, start: int) -> Iterator[tuple[int, str]]:
    """Yield the statements of a line: `if a: movel(p) end` has three."""
    begin, depth, before, head, has_head = -1, 0, "", False, False
    for match in PART.finditer(text):
        part = match[0]
        if begin >= 0 and not depth and not head and part[0] not in "[](){}":
            follows = has_head and before in ("]", ")", "}", "end") and part not in OPERATORS
            if part in ("end", "else", "elif") or (follows and WORD.fullmatch(part)):
                yield start + begin, text[begin : match.start()].rstrip()
                begin = -1
        if begin < 0:
            begin, head = match.start(), bool(HEAD.fullmatch(part))
            has_head |= head
        depth += (part in "[({") - (part in "])}")
        before = part
        if head and part == ":" and not depth:
            yield start + begin, text[begin : match.end()]
            begin, head = -1, False
    if begin >= 0:
        yield start + begin, text[begin:].rstrip()


LANGUAGE = Language(
    name="URScript",
    metres=1.0,
    radians=1.0,
    n_turns=3,
    motion=re.compile(r"(?<![\w.])move[ljpc][ \t]*\("),
    decimals=(7, 7),
    reader=_Reader,
    to_rotations=vector_rotations,
    configurations=None,
)
