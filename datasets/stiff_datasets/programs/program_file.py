"""Motion targets of a robot program, and the same program with other numbers.

A program is written back number by number, so every other character stays as it was.
"""

from __future__ import annotations

from bisect import bisect_right
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import NamedTuple

import numpy as np

from stiff_protocols.contract.arrays import BoolArray, FloatArray, IntArray
from stiff_protocols.contract.files import written_whole

MOST_NUMBERS, MOST_CONFIG = 7, 6
"""Numbers of a target (a position and a quaternion), and of its configuration."""
NEAR_ZERO = 1e-6
"""rad: an angle so near to a sign's or a turn's change is rounding."""
NO_FRAME = (0.0, 0.0, 0.0, 0.0, 0.0, 0.0)


class Number(NamedTuple):
    """A number in a program: its value and its place in the text."""

    value: float
    start: int
    end: int


class Frame(NamedTuple):
    """A tool or base frame of a program.

    Attributes:
        name: as the program calls it.
        values: position and orientation, in the program's units; empty where the program does not
            hold them.
    """

    name: str
    values: tuple[float, ...]


class Target(NamedTuple):
    """A motion of a program to a literal target.

    Attributes:
        start, end: place of the motion's statement in the first text.
        goal_start, goal_end: place of the target in it: a literal, or a name.
        is_linear: the tool moves along a straight line to it.
        follows: the motion before in the text is the one before it in the program's run, too.
        has_joints: the numbers are joint angles, not a pose.
        numbers: joint angles, or position and orientation.
        config: numbers of the arm's configuration; may be empty.
        base, tool: frames of a pose, and the tool of joint angles.
        text_index: number of the text in which the numbers are.
    """

    start: int
    end: int
    goal_start: int
    goal_end: int
    is_linear: bool
    follows: bool
    has_joints: bool
    numbers: Sequence[Number]
    config: Sequence[Number]
    base: Frame
    tool: Frame
    text_index: int = 0


class LeftMotion(NamedTuple):
    """A motion, or a part of it, that is left as it is.

    Attributes:
        start: its place in the first text.
        text: the statement.
        reason: why it is not corrected.
    """

    start: int
    text: str
    reason: str


class StatementError(Exception):
    """A statement of a program that cannot be read.

    Attributes:
        start: its place.
        text: the statement.
        valid: what is expected.
        text_index: number of the text.
    """

    def __init__(self, start: int, text: str, valid: str, text_index: int = 0) -> None:
        super().__init__(text)
        self.start, self.text, self.valid, self.text_index = start, text, valid, text_index


def is_either(written: FloatArray, low: FloatArray, high: FloatArray) -> BoolArray:
    """Return which written numbers are one of two."""
    return np.asarray((written == low) | (written == high))


@dataclass(frozen=True)
class Language:
    """A maker's language: how it is read, and its conventions.

    Attributes:
        name: of the language.
        companion: suffix of a second file with the targets' data; "" if there is none.
        metres, radians: one unit of its lengths [m] and of its angles [rad].
        n_turns: numbers of an orientation.
        decimals: digits after the point of lengths, joint angles and orientations, at least.
        read: yields targets and motions that are left, in the order of the text.
        to_rotations: (n, n_turns) numbers -> (n, 3, 3) rotations.
        from_rotations: the inverse.
        configurations: (n, 3) signs of shoulder, elbow and wrist (`arm_shape`) and (n, n_joints)
            controller's joint angles, rad -> (n, k) numbers of the configuration; None if targets
            have none.
        insert: (program, rows, numbers as texts, configurations) -> edits that put a motion to
            each literal target before the motion of its row, in this order.
        matches: (written, low, high) -> which numbers of a configuration fit, where `low` and
            `high` belong to joint angles a little smaller and larger.
        config_names: names of the numbers of a configuration.
        config_of_linear: linear motions are bound to the configuration that is written.
    """

    name: str
    companion: str
    metres: float
    radians: float
    n_turns: int
    decimals: tuple[int, int, int]
    read: Callable[[Sequence[str]], Iterator[Target | LeftMotion]]
    to_rotations: Callable[[FloatArray], FloatArray]
    from_rotations: Callable[[FloatArray], FloatArray]
    configurations: Callable[[FloatArray, FloatArray], FloatArray] | None
    insert: Callable[
        [RobotProgram, Sequence[int], Sequence[Sequence[str]], Sequence[Sequence[int]]], list[Edit]
    ]
    matches: Callable[[FloatArray, FloatArray, FloatArray], BoolArray] = is_either
    config_names: tuple[str, ...] = ()
    config_of_linear: bool = False


class Edit(NamedTuple):
    """A new text for a place of a program; an empty place is an insertion."""

    text_index: int
    start: int
    end: int
    text: str


@dataclass(frozen=True, eq=False)
class RobotProgram:
    """The targets of a program, in columns.

    Attributes:
        paths: its files: the program, and the companion with its data if there is one.
        texts: their texts; a character is a byte.
        language: of the program.
        lines: (n,) line of each motion in the first file.
        statements, goals: (n, 2) places of the motion and of its target in the first text.
        is_linear, follows, has_joints: (n,) as of `Target`.
        text_index: (n,) number of the text that holds a target's numbers.
        values: (n, 7) numbers, in the program's units; NaN beyond the target's own.
        places: (n, 7, 2) places of these numbers.
        config: (n, 6) numbers of the configuration; NaN where there are none.
        config_places: (n, 6, 2) their places.
        frames: the pairs of base and tool frame that occur.
        frame_index: (n,) number of each target's pair.
        left_motions: motions that are left as they are.
    """

    paths: tuple[Path, ...]
    texts: tuple[str, ...]
    language: Language
    lines: IntArray
    statements: IntArray
    goals: IntArray
    is_linear: BoolArray
    follows: BoolArray
    has_joints: BoolArray
    text_index: IntArray
    values: FloatArray
    places: IntArray
    config: FloatArray
    config_places: IntArray
    frames: tuple[tuple[Frame, Frame], ...]
    frame_index: IntArray
    left_motions: tuple[LeftMotion, ...]
    _starts: tuple[list[int], ...] = field(default=(), repr=False)

    def __len__(self) -> int:
        return len(self.lines)

    def line(self, start: int, text_index: int = 0) -> int:
        """Return the number of the line, from 1, of a place in a text."""
        return bisect_right(self._starts[text_index], start)

    def place(self, row: int) -> str:
        """Return "FILE, line N" of a target."""
        return f"{self.paths[0]}, line {self.lines[row]}"


def edited_texts(texts: Sequence[str], edits: Sequence[Edit]) -> list[str]:
    """Return texts with new numbers in their places; the rest is as it was."""
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
    """Write the files of a program, byte for byte as their texts have them."""
    for path, text in zip(paths, texts, strict=True):
        with written_whole(path) as temporary:
            temporary.write_bytes(text.encode("latin-1"))


def copied_motions(program: RobotProgram, rows: Sequence[int], goals: Sequence[str]) -> list[Edit]:
    """Return edits that put copies of motions' lines, with other targets, before these lines."""
    edits, text = [], program.texts[0]
    newline = "\r\n" if "\r\n" in text else "\n"
    for row, goal in zip(rows, goals, strict=True):
        (start, end), (goal_start, goal_end) = program.statements[row], program.goals[row]
        line = text.rfind("\n", 0, start) + 1
        before = text[line:start] if text[line:start].isspace() else ""
        place = int(start) - len(before)
        copy = text[start:goal_start] + goal + text[goal_end:end].rstrip()
        edits.append(Edit(0, place, place, before + copy + newline))
    return edits


def number_text(value: float, old: str, decimals: int) -> str:
    """Return a number with `decimals` digits after the point, or as many as its old text has."""
    had = len(old.partition(".")[2]) if "e" not in old.lower() else 0
    text = f"{value:.{max(decimals, had)}f}"
    return text[1:] if float(text) == 0.0 and text[0] == "-" else text
