"""Represent the motion targets of a robot program, and edit their numbers.

Only numbers are replaced, so every other character of the program stays unchanged.
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
"""Largest count of numbers of a target (position and quaternion) and of its configuration."""
NEAR_ZERO = 1e-6
"""rad: smaller distances from a change of sign or turn are rounding errors."""
NO_FRAME = (0.0, 0.0, 0.0, 0.0, 0.0, 0.0)


class Number(NamedTuple):
    """A number in a program: its value and its place in the text."""

    value: float
    start: int
    end: int


class Frame(NamedTuple):
    """A tool or base frame of a program.

    Attributes:
        name: name in the program.
        values: position and orientation, in the program's units; empty if the program does not
            contain them.
    """

    name: str
    values: tuple[float, ...]


class Target(NamedTuple):
    """A motion of a program to a literal target.

    Attributes:
        start, end: place of the motion's statement in the first text.
        goal_start, goal_end: place of the target in the text: a literal, or a name.
        is_linear: true if the tool moves to it along a straight line.
        follows: true if the previous motion in the text is also the previous motion at run time.
        has_joints: true if the numbers are joint angles, not a pose.
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
    """A motion, or a part of it, that stays unchanged.

    Attributes:
        start: its place in the first text.
        text: the statement.
        reason: reason why it is not corrected.
    """

    start: int
    text: str
    reason: str


class StatementError(Exception):
    """A statement of a program that cannot be read.

    Attributes:
        start: its place.
        text: the statement.
        valid: expected statement.
        text_index: number of the text.
    """

    def __init__(self, start: int, text: str, valid: str, text_index: int = 0) -> None:
        super().__init__(text)
        self.start, self.text, self.valid, self.text_index = start, text, valid, text_index


def is_either(written: FloatArray, low: FloatArray, high: FloatArray) -> BoolArray:
    """Test if written numbers equal one of two numbers."""
    return np.asarray((written == low) | (written == high))


@dataclass(frozen=True)
class Language:
    """A manufacturer's language: its reader and its conventions.

    Attributes:
        name: name of the language.
        companion: suffix of a second file with the targets' data; "" if there is none.
        metres, radians: one unit of its lengths [m] and of its angles [rad].
        n_turns: count of numbers of an orientation.
        decimals: least decimals of lengths, joint angles and orientations.
        read: yields targets and unchanged motions, in the order of the text.
        to_rotations: (n, n_turns) numbers -> (n, 3, 3) rotations.
        configurations: (n, 3) signs of shoulder, elbow and wrist (`arm_shape`) and (n, n_joints)
            controller's joint angles, rad -> (n, k) numbers of the configuration; None if targets
            have no configuration.
        matches: (written, low, high) -> true for numbers of a configuration that fit; `low` and
            `high` belong to slightly smaller and larger joint angles.
        config_names: names of the numbers of a configuration.
        config_of_linear: true if linear motions require the written configuration.
    """

    name: str
    companion: str
    metres: float
    radians: float
    n_turns: int
    decimals: tuple[int, int, int]
    read: Callable[[Sequence[str]], Iterator[Target | LeftMotion]]
    to_rotations: Callable[[FloatArray], FloatArray]
    configurations: Callable[[FloatArray, FloatArray], FloatArray] | None
    matches: Callable[[FloatArray, FloatArray, FloatArray], BoolArray] = is_either
    config_names: tuple[str, ...] = ()
    config_of_linear: bool = False


class Edit(NamedTuple):
    """A new text for a place of a program."""

    text_index: int
    start: int
    end: int
    text: str


@dataclass(frozen=True, eq=False)
class RobotProgram:
    """The targets of a program, in columns.

    Attributes:
        paths: its files: the program, and the companion with its data if there is one.
        texts: their texts; each character is a byte.
        language: language of the program.
        lines: (n,) line of each motion in the first file.
        statements, goals: (n, 2) places of the motion and of its target in the first text.
        is_linear, follows, has_joints: (n,) see `Target`.
        text_index: (n,) number of the text that holds a target's numbers.
        values: (n, 7) numbers, in the program's units; NaN if a target has fewer.
        places: (n, 7, 2) places of these numbers.
        config: (n, 6) numbers of the configuration; NaN if there are none.
        config_places: (n, 6, 2) their places.
        frames: pairs of base and tool frame in the program.
        frame_index: (n,) number of each target's pair.
        left_motions: motions that stay unchanged.
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
