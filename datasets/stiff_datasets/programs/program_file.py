"""Motion targets of a robot program, and the same program with other numbers.

A language's module yields the targets of a program with the places of their numbers. They are
kept in columns: a program of a million targets takes 300 MB. A program is written back number by
number, so every other character stays as it was.
"""

from __future__ import annotations

from bisect import bisect_right
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import NamedTuple

import numpy as np

from stiff_protocols.contract.arrays import BoolArray, FloatArray, IntArray
from stiff_protocols.contract.errors import DataError
from stiff_protocols.contract.files import written_whole

MOST_NUMBERS, MOST_CONFIG = 7, 6
"""Numbers of a target (a position and a quaternion), and of its configuration."""
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


class Statement(NamedTuple):
    """A statement that cannot be read, and the valid form.

    Attributes:
        start: its place.
        text: the statement.
        valid: what is expected.
        text_index: number of the text.
    """

    start: int
    text: str
    valid: str
    text_index: int = 0


class StatementError(Exception):
    """A statement of a program that cannot be read; holds a `Statement`."""

    def __init__(self, start: int, text: str, valid: str, text_index: int = 0) -> None:
        super().__init__(text)
        self.statement = Statement(start, text, valid, text_index)


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
        left: motions that are left as they are.
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
    left: tuple[LeftMotion, ...]
    _starts: tuple[list[int], ...] = field(default=(), repr=False)

    def __len__(self) -> int:
        return len(self.lines)

    def line(self, start: int, text_index: int = 0) -> int:
        """Return the number of the line, from 1, of a place in a text."""
        return bisect_right(self._starts[text_index], start)

    def place(self, row: int) -> str:
        """Return "FILE, line N" of a target."""
        return f"{self.paths[0]}, line {self.lines[row]}"


def read_program(path: Path) -> RobotProgram:
    """Read the targets of a robot program.

    Args:
        path: KUKA .src (with the .dat beside it), ABB .mod, FANUC .ls, or URScript .script.

    Raises:
        DataError: the file cannot be read, its language is unknown, a statement is wrong, or it
            holds no target.
    """
    language = language_of(path)
    paths = [path]
    if language.companion:
        data = [path.with_suffix(suffix) for suffix in _either_case(language.companion)]
        paths += [file for file in data if file.is_file()][:1]
    texts = tuple(_text(file) for file in paths)
    starts = tuple(_line_starts(text) for text in texts)
    columns = _Columns()
    try:
        for motion in language.read(texts):
            columns.add(motion)
    except StatementError as error:
        wrong = error.statement
        line = bisect_right(starts[wrong.text_index], wrong.start)
        text = " ".join(wrong.text.split())[:60]
        raise DataError(
            f"{paths[wrong.text_index]}, line {line}: {text} (valid: {wrong.valid})"
        ) from error
    if not columns.statements and not columns.left:
        raise DataError(f"{path}: no motion of {language.name} in this program")
    return columns.program(tuple(paths), texts, language, starts)


def language_of(path: Path) -> Language:
    """Return the language of a program by its suffix; DataError for an unknown one."""
    match path.suffix.lower():
        case ".src":
            from stiff_datasets.programs.krl import LANGUAGE as language
        case ".mod" | ".modx" | ".prg":
            from stiff_datasets.programs.rapid import LANGUAGE as language
        case ".ls":
            from stiff_datasets.programs.fanuc_ls import LANGUAGE as language
        case ".script" | ".urscript":
            from stiff_datasets.programs.urscript import LANGUAGE as language
        case _:
            raise DataError(
                f"{path}: unknown language of a robot program (valid: KUKA .src, ABB .mod, FANUC "
                ".ls, URScript .script)"
            )
    return language


def edited_texts(texts: Sequence[str], edits: Sequence[Edit]) -> list[str]:
    """Return texts with new numbers in their places; the rest is as it was."""
    results = []
    for index, text in enumerate(texts):
        parts, end = [], 0
        own = (edit for edit in edits if edit.text_index == index)
        for edit in sorted(own, key=lambda edit: (edit.start, edit.end)):
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
    """Return a number with at least so many decimals, and as many as its old text has."""
    had = len(old.partition(".")[2]) if "e" not in old.lower() else 0
    text = f"{value:.{max(decimals, had)}f}"
    return text[1:] if float(text) == 0.0 and text[0] == "-" else text


def _text(path: Path) -> str:
    """Return a file's text, a character for a byte."""
    try:
        return path.read_bytes().decode("latin-1")
    except OSError as error:
        raise DataError(f"{path}: cannot be read: {error.strerror or error}") from error


def _line_starts(text: str) -> list[int]:
    starts, place = [0], text.find("\n")
    while place >= 0:
        starts.append(place + 1)
        place = text.find("\n", place + 1)
    return starts


def _either_case(suffix: str) -> tuple[str, str]:
    return suffix, suffix.upper()


class _Columns:
    """Collect targets as columns of numbers."""

    def __init__(self) -> None:
        from array import array

        self.statements, self.places = array("q"), array("q")
        self.config_places, self.values, self.config = array("q"), array("d"), array("d")
        self.flags, self.frame_index = array("b"), array("q")
        self.frames: dict[tuple[Frame, Frame], int] = {}
        self.left: list[LeftMotion] = []

    def add(self, motion: Target | LeftMotion) -> None:
        if isinstance(motion, LeftMotion):
            self.left.append(motion)
            return
        self.statements.extend((motion.start, motion.end, motion.goal_start, motion.goal_end))
        self.flags.extend((motion.is_linear, motion.follows, motion.has_joints, motion.text_index))
        for numbers, count, values, places in (
            (motion.numbers, MOST_NUMBERS, self.values, self.places),
            (motion.config, MOST_CONFIG, self.config, self.config_places),
        ):
            for number in numbers:
                values.append(number.value)
                places.extend((number.start, number.end))
            rest = count - len(numbers)
            values.extend((np.nan,) * rest)
            places.extend((0,) * (2 * rest))
        pair = (motion.base, motion.tool)
        self.frame_index.append(self.frames.setdefault(pair, len(self.frames)))

    def program(
        self,
        paths: tuple[Path, ...],
        texts: tuple[str, ...],
        language: Language,
        starts: tuple[list[int], ...],
    ) -> RobotProgram:
        statements = np.array(self.statements, dtype=np.int64).reshape(-1, 4)
        flags = np.array(self.flags, dtype=np.int64).reshape(-1, 4)
        return RobotProgram(
            paths=paths,
            texts=texts,
            language=language,
            lines=np.searchsorted(starts[0], statements[:, 0], side="right"),
            statements=statements[:, :2],
            goals=statements[:, 2:],
            is_linear=flags[:, 0] > 0,
            follows=flags[:, 1] > 0,
            has_joints=flags[:, 2] > 0,
            text_index=flags[:, 3],
            values=np.array(self.values).reshape(-1, MOST_NUMBERS),
            places=np.array(self.places, dtype=np.int64).reshape(-1, MOST_NUMBERS, 2),
            config=np.array(self.config).reshape(-1, MOST_CONFIG),
            config_places=np.array(self.config_places, dtype=np.int64).reshape(-1, MOST_CONFIG, 2),
            frames=tuple(self.frames),
            frame_index=np.array(self.frame_index, dtype=np.int64),
            left=tuple(self.left),
            _starts=starts,
        )
