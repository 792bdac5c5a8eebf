"""Represent the motions of a robot program and the table of its targets, and edit its numbers.

Only numbers are replaced, so every other character of the program stays unchanged.
"""

from __future__ import annotations

import re
from bisect import bisect_right
from collections.abc import Callable, Collection, Iterator, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, NamedTuple, Protocol

import numpy as np

from stiff_apply.programs.flow import LAST, Flow, Frame, Routine, State, Unknown, Value, value_of
from stiff_apply.programs.statements import Names, Number, without_strings
from stiff_protocols.contract.arrays import BoolArray, FloatArray, IntArray
from stiff_protocols.contract.errors import DataError
from stiff_protocols.contract.files import written_whole

MOST_NUMBERS, MOST_CONFIG, MOST_EXTERNAL = 7, 6, 6
"""Largest counts of numbers of a target (position and quaternion), configuration, external axes."""
NEAR_ZERO = 1e-6
"""rad: smaller distances from a change of sign or turn are rounding errors."""
MAX_NUMBER = 1e6
"""Limit of the numbers of a target or a frame, in any unit."""
BASE, TOOL = Value("base"), Value("tool")
NO_FRAME = (0.0, 0.0, 0.0, 0.0, 0.0, 0.0)


@dataclass(frozen=True)
class Goal:
    """A point of a motion.

    Attributes:
        numbers: joint angles, or position and orientation; None: the value of the target before.
        has_joints: true for joint angles.
        config: numbers of the arm's configuration; may be empty.
        external: external axes; NaN for an axis that is not used.
        text_index: number of the text in which the numbers are.
        reason: why the target is not literal; "" if it is.
    """

    numbers: tuple[Number | None, ...] = ()
    has_joints: bool = False
    config: tuple[Number, ...] = ()
    external: tuple[float, ...] = ()
    text_index: int = 0
    reason: str = ""


@dataclass(eq=False)
class Motion:
    """A motion of a program.

    Attributes:
        start, end: place of its statement in the first text.
        routine: name of its routine.
        kind: "joint"; or "linear" and "circle", on which the tool follows a path.
        goals: its points; a circle has its helper point, too.
        base, tool: frames; a `Value` is in the state.
        needs: keys of the state that must be known.
        config_key: key of the state that says whether the configuration is obeyed; "": it is.
        reason: why it cannot be corrected; "" if it may be.
        is_relative: true if it moves with the target before.
        ends_at_goal: false if it goes on or stops before its last point.
        expects: values of the state with which its frames are valid, if the state has others.
    """

    start: int
    end: int
    routine: str
    kind: str
    goals: tuple[Goal, ...] = ()
    base: Any = BASE
    tool: Any = TOOL
    needs: tuple[str, ...] = ()
    config_key: str = ""
    reason: str = ""
    is_relative: bool = False
    ends_at_goal: bool = True
    expects: dict[str, Any] = field(default_factory=dict)


class LeftMotion(NamedTuple):
    """A motion that was not corrected: its line, its statement, and the reason."""

    line: int
    text: str
    reason: str


class Reading(Protocol):
    """A program that is read: routines, names, state at the start, and text without comments."""

    routines: dict[str, Routine]
    names: Names
    state: State
    text: str


def is_either(written: FloatArray, low: FloatArray, high: FloatArray) -> BoolArray:
    """Test if written numbers equal one of two numbers."""
    return np.asarray((written == low) | (written == high))


@dataclass(frozen=True)
class Language:
    """A manufacturer's language: its reader and its conventions.

    Attributes:
        name: name of the language.
        companions: names of files with data next to the program; "*" is its own name.
        metres, radians: one unit of its lengths [m] and of its angles [rad].
        n_turns: count of numbers of an orientation.
        motion: begin of a motion.
        decimals: least decimals of lengths and joint angles.
        reader: reads the texts; names of other routines that do not change the state.
        to_rotations: (n, n_turns) numbers -> (n, 3, 3) rotations.
        configurations: (n, 3) signs of shoulder, elbow and wrist (`arm_signs`) and (n, n_joints)
            controller's joint angles, rad -> (n, k) numbers of the configuration; None if targets
            have no configuration.
        matches: (written, low, high) -> true for numbers of a configuration that fit; `low` and
            `high` belong to slightly smaller and larger joint angles.
        config_names: names of the numbers of a configuration.
        config_of_linear: true if linear motions require the written configuration.
        external_names: names of the external axes.
    """

    name: str
    metres: float
    radians: float
    n_turns: int
    motion: re.Pattern[str]
    decimals: tuple[int, int]
    reader: Callable[[Sequence[str], Collection[str]], Reading]
    to_rotations: Callable[[FloatArray], FloatArray]
    configurations: Callable[[FloatArray, FloatArray], FloatArray] | None
    companions: tuple[str, ...] = ()
    matches: Callable[[FloatArray, FloatArray, FloatArray], BoolArray] = is_either
    config_names: tuple[str, ...] = ()
    config_of_linear: bool = False
    external_names: tuple[str, ...] = ()


class Edit(NamedTuple):
    """A new text for a place of a program."""

    text_index: int
    start: int
    end: int
    text: str


@dataclass(frozen=True, eq=False)
class RobotProgram:
    """The motions of a program, and their targets in columns.

    Attributes:
        paths: its files: the program, and the companion with its data if there is one.
        texts: their texts; each character is a byte.
        language: language of the program.
        reading: routines and names.
        motions: motions in the order of the text.
        reasons: why a motion is left; "" for motions with rows.
        motion: (n,) number of each target's motion.
        is_linear, follows, has_joints: (n,) true if the tool moves along a path; if the previous
            row is the target before at run time; if the numbers are joint angles.
        text_index: (n,) number of the text that holds a target's numbers.
        values: (n, 7) numbers, in the program's units; NaN if a target has fewer.
        places: (n, 7, 2) places of these numbers; equal places: where it is to be inserted.
        config: (n, 6) numbers of the configuration; NaN if there are none.
        config_places: (n, 6, 2) their places.
        external: (n, 6) external axes; NaN if they are not used.
        frames: pairs of base and tool frame in the program.
        frame_index: (n,) number of each target's pair.
        motion_lines: (n_motions,) line of each motion in the first file.
        states: state at each motion that is reached.
    """

    paths: tuple[Path, ...]
    texts: tuple[str, ...]
    language: Language
    reading: Reading
    motions: tuple[Motion, ...]
    reasons: tuple[str, ...]
    motion: IntArray
    is_linear: BoolArray
    follows: BoolArray
    has_joints: BoolArray
    text_index: IntArray
    values: FloatArray
    places: IntArray
    config: FloatArray
    config_places: IntArray
    external: FloatArray
    frames: tuple[tuple[Frame, Frame], ...]
    frame_index: IntArray
    motion_lines: IntArray
    states: dict[Any, State]

    def __len__(self) -> int:
        return len(self.motion)

    @property
    def lines(self) -> IntArray:
        """(n,) line of each target's motion in the first file."""
        return np.asarray(self.motion_lines[self.motion])

    def place(self, row: int) -> str:
        """Return "FILE, line N" of a target."""
        return f"{self.paths[0]}, line {self.lines[row]}"

    def left_motion(self, index: int, reason: str) -> LeftMotion:
        """Return a motion with the reason why it is left."""
        motion = self.motions[index]
        text = " ".join(self.texts[0][motion.start : motion.end].split())
        return LeftMotion(int(self.motion_lines[index]), text, reason)


def program_table(
    paths: tuple[Path, ...],
    texts: tuple[str, ...],
    language: Language,
    harmless: Collection[str],
) -> RobotProgram:
    """Return the table of a program's targets.

    Args:
        paths: files of the program.
        texts: their texts.
        language: language of the program.
        harmless: names of other routines that do not change the state.

    Raises:
        DataError: it has no motion.
    """
    reading = language.reader(texts, harmless)
    state_of = Flow(reading.routines, reading.state).at
    motions = [
        item
        for routine in reading.routines.values()
        for item in routine.items
        if isinstance(item, Motion)
    ]
    motions += _unread_motions(reading, language, motions)
    motions.sort(key=lambda motion: motion.start)
    if not motions:
        raise DataError(f"{paths[0]}: no motion of {language.name} in this program")
    ends = [match.start() for match in re.finditer("\n", texts[0])]
    motion_lines = 1 + np.searchsorted(ends, [motion.start for motion in motions])
    rows, reasons = list[tuple[Any, ...]](), list[str]()
    frames: dict[tuple[Frame, Frame], int] = {}
    last_goals: dict[Any, tuple[Goal, Any]] = {}
    for index, motion in enumerate(motions):
        state = state_of.get(motion)
        before = state and state[LAST]
        reason, base, tool = _frames_of(motion, state)
        last = last_goals.get(before, (Goal(reason="unknown"), None))
        goals = []
        for goal in motion.goals:
            if motion.kind == "circle":
                last = Goal(reason="circle"), None
            goals.append(_whole_goal(goal, *last, (base, tool)))
            last = (goals[-1], (base, tool))
        if goals and motion.ends_at_goal:
            last_goals[motion] = last
        reason = reason or next((goal.reason for goal in goals if goal.reason), "")
        reasons.append(reason)
        if reason or state is None:
            continue
        pair = frames.setdefault((base, tool), len(frames))
        for number, goal in enumerate(goals):
            is_bound = not motion.config_key or state[motion.config_key]
            is_next = index > 0 and before is motions[index - 1] and not reasons[index - 1]
            follows = number > 0 or is_next
            flags = (index, motion.kind != "joint", follows, goal.has_joints, goal.text_index)
            obeyed = goal.config if is_bound and motion.kind != "circle" else ()
            rows.append((*flags, pair, goal.numbers, obeyed, goal.external))
    columns = [*zip(*rows, strict=True)] or [()] * 9
    values, places = _columns(columns[6], MOST_NUMBERS)
    config, config_places = _columns(columns[7], MOST_CONFIG)
    external = np.full((len(rows), MOST_EXTERNAL), np.nan)
    for row, axes in enumerate(columns[8]):
        external[row, : len(axes)] = axes
    return RobotProgram(
        paths=paths,
        texts=texts,
        language=language,
        reading=reading,
        motions=tuple(motions),
        reasons=tuple(reasons),
        motion=np.array(columns[0], dtype=np.int64),
        is_linear=np.array(columns[1], dtype=bool),
        follows=np.array(columns[2], dtype=bool),
        has_joints=np.array(columns[3], dtype=bool),
        text_index=np.array(columns[4], dtype=np.int64),
        values=values,
        places=places,
        config=config,
        config_places=config_places,
        external=external,
        frames=tuple(frames),
        frame_index=np.array(columns[5], dtype=np.int64),
        motion_lines=motion_lines,
        states=state_of,
    )


def _unread_motions(
    reading: Reading, language: Language, motions: Sequence[Motion]
) -> Iterator[Motion]:
    """Yield motions at places where no statement is read as a motion, so that none is lost."""
    spans = sorted((motion.start, motion.end) for motion in motions)
    starts = [start for start, _ in spans]
    for match in language.motion.finditer(without_strings(reading.text)):
        index = bisect_right(starts, match.end() - 1) - 1
        if index < 0 or match.end() > spans[index][1]:
            reason = "is at a place where no motion is expected"
            yield Motion(match.start(), match.end(), "", "linear", reason=reason)


def _frames_of(motion: Motion, state: State | None) -> tuple[str, Frame, Frame]:
    """Return why a motion is left, its base and its tool."""
    base, tool = (
        value_of(state or {}, frame.key) if isinstance(frame, Value) else frame
        for frame in (motion.base, motion.tool)
    )
    if motion.reason or state is None:
        return motion.reason or "is never reached", Frame(""), Frame("")
    is_pose = any(not goal.has_joints for goal in motion.goals)
    needs = [state[key] for key in (*motion.needs, *[motion.config_key] * is_pose) if key]
    for value in (*needs, *[base] * is_pose, tool):
        if isinstance(value, Unknown):
            return value.cause, Frame(""), Frame("")
    for key, value in motion.expects.items():
        active = state[key]
        if value is not None and isinstance(active, str) and int(value) != int(active):
            return f"the active {key} is {state[key]}, its own is {value}", Frame(""), Frame("")
    if isinstance(base, Unknown):
        base = Frame("")
    if not all(abs(number) <= MAX_NUMBER for number in (*base.values, *tool.values)):
        return f"a frame has a number beyond +-{MAX_NUMBER:g}", base, tool
    return "", base, tool


def _whole_goal(goal: Goal, last: Goal, frames_of_last: Any, frames: Any) -> Goal:
    """Return a goal with missing numbers from the target before; they are to be inserted."""
    for number in goal.numbers:
        if number and not abs(number.value) <= MAX_NUMBER:
            return Goal(reason=f"{number.value:g} is not within +-{MAX_NUMBER:g}")
    if goal.reason or None not in goal.numbers:
        return goal
    reason = "the target has not all numbers, and the target before "
    if last.reason:
        return Goal(reason=f"{reason}is not literal")
    if last.has_joints != goal.has_joints or not (last.has_joints or frames_of_last == frames):
        return Goal(reason=f"{reason}is of another kind or in another frame")
    end = max(number.end for number in goal.numbers if number is not None)
    pairs = zip(goal.numbers, last.numbers, strict=True)
    numbers = tuple(
        number or Number(before.value, end, end) for number, before in pairs if before is not None
    )
    return Goal(numbers, goal.has_joints, goal.config, goal.external, goal.text_index)


def _columns(rows: Sequence[Sequence[Number]], count: int) -> tuple[FloatArray, IntArray]:
    """Return (n, count) values and (n, count, 2) places of numbers; NaN and 0 for missing ones."""
    values, places = np.full((len(rows), count), np.nan), np.zeros((len(rows), count, 2), np.int64)
    for row, numbers in enumerate(rows):
        if numbers:
            values[row, : len(numbers)] = [number.value for number in numbers]
            places[row, : len(numbers)] = [number[1:] for number in numbers]
    return values, places


def edited_texts(texts: Sequence[str], edits: Sequence[Edit]) -> list[str]:
    """Apply edits to texts; all other characters stay unchanged."""
    results = []
    for index, text in enumerate(texts):
        parts, end = [], 0
        text_edits = (edit for edit in edits if edit.text_index == index)
        for edit in sorted(text_edits, key=lambda edit: (edit.start, edit.end)):
            parts += [text[end : edit.start], edit.text]
            end = edit.end
        results.append("".join([*parts, text[end:]]))
    return results


def write_texts(paths: Sequence[Path], texts: Sequence[str]) -> None:
    """Write the files of a program, byte for byte."""
    for path, text in zip(paths, texts, strict=True):
        with written_whole(path) as temporary:
            temporary.write_bytes(text.encode("latin-1"))


def number_text(value: float, old: str, decimals: int) -> str:
    """Format a number with `decimals` decimals, or as many as its old text has."""
    n_old_decimals = len(old.partition(".")[2]) if "e" not in old.lower() else 0
    text = f"{value:.{max(decimals, n_old_decimals)}f}"
    return text[1:] if float(text) == 0.0 and text[0] == "-" else text
