"""Read a robot program and collect its targets in columns.

The module of its language yields the targets. A program of a million targets needs a few hundred
MB.
"""

from __future__ import annotations

from array import array
from bisect import bisect_right
from pathlib import Path

import numpy as np

from stiff_apply.programs import fanuc_ls, krl, rapid, urscript
from stiff_apply.programs.program_file import (
    MOST_CONFIG,
    MOST_NUMBERS,
    Frame,
    Language,
    LeftMotion,
    RobotProgram,
    StatementError,
    Target,
)
from stiff_protocols.contract.errors import DataError

MAX_NUMBER = 1e6
"""Limit of the numbers of a target or a frame, in any unit."""
LANGUAGES = {
    ".src": krl.LANGUAGE,
    ".mod": rapid.LANGUAGE,
    ".modx": rapid.LANGUAGE,
    ".prg": rapid.LANGUAGE,
    ".ls": fanuc_ls.LANGUAGE,
    ".script": urscript.LANGUAGE,
    ".urscript": urscript.LANGUAGE,
}
"""Suffix of a program -> its language."""


def read_program(path: Path) -> RobotProgram:
    """Read the targets of a robot program.

    Args:
        path: KUKA .src (with the .dat of the same name), ABB .mod, FANUC .ls, or URScript .script.

    Raises:
        DataError: the file cannot be read, its language is unknown, a statement is invalid, or it
            has no target.
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
        line = bisect_right(starts[error.text_index], error.start)
        text = " ".join(error.text.split())[:60]
        raise DataError(
            f"{paths[error.text_index]}, line {line}: {text} (valid: {error.valid})"
        ) from error
    if not columns.statements and not columns.left_motions:
        raise DataError(f"{path}: no motion of {language.name} in this program")
    program = columns.program(tuple(paths), texts, language, starts)
    if not len(program):
        first = columns.left_motions[0]
        raise DataError(
            f"{path}: no motion has a literal target; line {program.line(first.start)}: "
            f"{first.reason}"
        )
    frames = [value for pair in program.frames for frame in pair for value in frame.values]
    is_large = ~(np.abs(np.nan_to_num(program.values, nan=0.0, posinf=np.inf)) <= MAX_NUMBER)
    if is_large.any():
        row, column = np.argwhere(is_large)[0]
        value = program.values[row, column]
        raise DataError(f"{program.place(row)}: {value:g} (valid: numbers within +-{MAX_NUMBER:g})")
    if not all(abs(value) <= MAX_NUMBER for value in frames):
        raise DataError(f"{path}: a frame has a number beyond +-{MAX_NUMBER:g}")
    return program


def language_of(path: Path) -> Language:
    """Return the language of a program by its suffix; DataError for an unknown one."""
    suffix = path.suffix.lower()
    if suffix not in LANGUAGES:
        raise DataError(
            f"{path}: unknown language of a robot program (valid: KUKA .src, ABB .mod, FANUC .ls, "
            "URScript .script)"
        )
    return LANGUAGES[suffix]


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
        self.statements, self.places = array("q"), array("q")
        self.config_places, self.values, self.config = array("q"), array("d"), array("d")
        self.flags, self.frame_index = array("b"), array("q")
        self.frames: dict[tuple[Frame, Frame], int] = {}
        self.left_motions: list[LeftMotion] = []

    def add(self, motion: Target | LeftMotion) -> None:
        if isinstance(motion, LeftMotion):
            self.left_motions.append(motion)
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
            n_missing = count - len(numbers)
            values.extend((np.nan,) * n_missing)
            places.extend((0,) * (2 * n_missing))
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
            left_motions=tuple(self.left_motions),
            _starts=starts,
        )
