"""Define the types of the public functions' parameters, with the form of their values as words.

`bench` reads them: bounds are checked, and several numbers are one word with commas between.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from operator import ge, gt, le, lt
from pathlib import Path
from typing import Annotated, Any, Literal

from stiff_datasets.measured.file_options import LARGEST_POSE_TOLERANCE

HOLDS = {"at_least": ge, "above": gt, "at_most": le, "below": lt}
"""Bound -> test of a number and the bound."""
SMALLEST_SIZE = 2**20
"""Bytes; smaller numbers are refused, because their unit is probably missing."""


@dataclass(frozen=True)
class Form:
    """Form of a value on the command line.

    Attributes:
        name: placeholder of the value in help pages.
        valid: description of valid words, for errors; "": any word.
        read: function that reads a word; ValueError: the word is not valid.
    """

    name: str
    valid: str = ""
    read: Callable[[str], Any] = str


@dataclass(frozen=True)
class Bounds:
    """Bounds of a number; None: no bound."""

    at_least: float | None = None
    above: float | None = None
    at_most: float | None = None
    below: float | None = None

    def form(self, name: str, kind: type[int] | type[float]) -> Form:
        """Return the form of a finite number within the bounds, with or without its unit: 5mm."""
        bounds = {key: bound for key, bound in vars(self).items() if bound is not None}

        def read(word: str) -> float:
            number = kind(word.removesuffix(name.lower()))
            if not math.isfinite(number) or not all(
                HOLDS[key](number, bound) for key, bound in bounds.items()
            ):
                raise ValueError
            return number

        texts = [f"{key.replace('_', ' ')} {bound:.15g}" for key, bound in bounds.items()]
        valid = ["a whole number" if kind is int else "a finite number", " and ".join(texts)]
        return Form(name, ", ".join(filter(None, valid)), read)


def numbers(name: str, valid: str, counts: Sequence[int] = (), words: Sequence[str] = ()) -> Form:
    """Return the form of a word of several numbers (`counts`: how many) or one of `words`."""

    def read(word: str) -> tuple[float, ...] | str:
        if word in words:
            return word
        values = tuple(map(float, word.split(",")))
        if not all(map(math.isfinite, values)) or (counts and len(values) not in counts):
            raise ValueError
        return values

    return Form(name, valid, read)


def _joint_value(word: str) -> tuple[str, float | None]:
    name, equals, text = word.partition("=")
    value = float(text) if equals else None
    if not name or not math.isfinite(value or 0.0):
        raise ValueError
    return name, value


def _named_frame(word: str) -> tuple[str, tuple[float, ...]]:
    name, equals, text = word.rpartition("=")
    values = tuple(map(float, text.split(",")))
    if bool(name) != bool(equals) or len(values) != 6 or not all(map(math.isfinite, values)):
        raise ValueError
    return name, values


def _size(word: str) -> int:
    from pydantic import ByteSize, TypeAdapter

    if (size := TypeAdapter(ByteSize).validate_python(word)) < SMALLEST_SIZE:
        raise ValueError
    return int(size)


FilePath = Path | str
Setting = Annotated[Sequence[str], Form("KEY.OPTION=VALUE")]
Folder = Annotated[Path | str, Form("DIR")]
Picture = Annotated[Path | str, Form("FILE.png")]

Count = Annotated[int, Bounds(at_least=1)]
Seed = Annotated[int, Bounds(at_least=0, at_most=2**32 - 20_000)]
"""The seed of a split is this one and the number of the split."""
Fraction = Annotated[float, Form("FRACTION"), Bounds(above=0.0, below=1.0)]
PoseTolerance = Annotated[float, Form("DEG"), Bounds(at_least=0.0, at_most=LARGEST_POSE_TOLERANCE)]
Tolerance = Annotated[float, Form("MM"), Bounds(at_least=1e-5, at_most=10.0)]
Iterations = Annotated[int, Bounds(at_least=1, at_most=1000)]

Point = Annotated[Sequence[float], numbers("X,Y,Z", "three finite lengths in m, x,y,z", [3])]
Axis = Annotated[Sequence[float], numbers("X,Y,Z", "three finite numbers, x,y,z", [3])]
Frame = Annotated[
    Sequence[float],
    numbers("X,Y,Z,A,B,C", "six finite numbers, x,y,z in mm and a,b,c in deg", [6]),
]
Frames = Annotated[
    Mapping[str, Sequence[float]],
    Form(
        "[NAME=]X,Y,Z,A,B,C",
        "six finite numbers, x,y,z in mm and a,b,c in deg; 2=x,y,z,a,b,c for frame 2",
        _named_frame,
    ),
]
"""mm and deg by number or name of a frame of a program; "": a frame without a name."""
Load = Annotated[
    Sequence[float],
    numbers(
        "FX,FY,FZ[,TX,TY,TZ]",
        "three or six finite numbers, fx,fy,fz in N and tx,ty,tz in N m",
        [3, 6],
    ),
]
Angles = Annotated[
    Sequence[float] | str,
    numbers("A,B,C", "down, or three finite numbers a,b,c in deg", [3], ["down"]),
]
Box = Annotated[
    Sequence[float],
    numbers("X0,X1,Y0,Y1,Z0,Z1", "six finite lengths in mm, x0,x1,y0,y1,z0,z1", [6]),
]
JointPositions = Annotated[
    Sequence[float], numbers("Q1,Q2,...", "one finite number per joint, deg or mm")
]
HeldJoints = Annotated[
    Mapping[str, float | None],
    Form("JOINT=VALUE", "JOINT=VALUE with a number in deg or mm", _joint_value),
]
"""deg or mm by name or number of the joint; None: the value of the path or posture."""
Bytes = Annotated[
    int, Form("SIZE", "a size with its unit, such as 2GiB or 500MB, at least 1MiB", _size)
]

AxisName = Literal["x", "y", "z"]
Device = Literal["auto", "cpu", "cuda"]
