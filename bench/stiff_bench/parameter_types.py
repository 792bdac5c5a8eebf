"""Define the types of the public functions' parameters, with the form of their values as words.

`bench` reads them: bounds are checked, and several numbers are one word with commas between.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Literal

from stiff_datasets.measured.file_options import LARGEST_POSE_TOLERANCE


@dataclass(frozen=True)
class Form:
    """Form of a value on the command line.

    Attributes:
        name: placeholder of the value in help pages.
        valid: description of several numbers, for errors; "" for a single value.
        counts: valid numbers of numbers; empty: at least one.
        words: words that are valid in place of numbers.
    """

    name: str
    valid: str = ""
    counts: tuple[int, ...] = ()
    words: tuple[str, ...] = ()


@dataclass(frozen=True)
class Bounds:
    """Bounds of a number; None: no bound."""

    at_least: float | None = None
    above: float | None = None
    at_most: float | None = None
    below: float | None = None

    def hold(self, number: float) -> bool:
        """Return whether a finite number is within the bounds."""
        return math.isfinite(number) and not (
            (self.at_least is not None and number < self.at_least)
            or (self.above is not None and number <= self.above)
            or (self.at_most is not None and number > self.at_most)
            or (self.below is not None and number >= self.below)
        )

    def __str__(self) -> str:
        """Return the bounds as words: "at least 1 and at most 10000"."""
        bounds = {name.replace("_", " "): bound for name, bound in vars(self).items()}
        return " and ".join(f"{n} {bound:.15g}" for n, bound in bounds.items() if bound is not None)


FilePath = Path | str
Setting = Annotated[Sequence[str], Form("KEY.OPTION=VALUE")]
Folder = Annotated[Path | str, Form("DIR")]
PICTURE = Form("FILE.png")
Picture = Annotated[Path | str, PICTURE]

Count = Annotated[int, Bounds(at_least=1)]
Seed = Annotated[
    int, Bounds(at_least=0, at_most=2**32 - 20_000)
]  # a split's is this one and its number
Fraction = Annotated[float, Form("FRACTION"), Bounds(above=0.0, below=1.0)]
PoseTolerance = Annotated[float, Form("DEG"), Bounds(at_least=0.0, at_most=LARGEST_POSE_TOLERANCE)]
Tolerance = Annotated[float, Form("MM"), Bounds(at_least=1e-5, at_most=10.0)]
Iterations = Annotated[int, Bounds(at_least=1, at_most=1000)]

Point = Annotated[Sequence[float], Form("X,Y,Z", "three finite lengths in m, x,y,z", (3,))]
Axis = Annotated[Sequence[float], Form("X,Y,Z", "three finite numbers, x,y,z", (3,))]
Frame = Annotated[
    Sequence[float],
    Form("X,Y,Z,A,B,C", "six finite numbers, x,y,z in mm and a,b,c in deg", (6,)),
]
Load = Annotated[
    Sequence[float],
    Form(
        "FX,FY,FZ[,TX,TY,TZ]",
        "three or six finite numbers, fx,fy,fz in N and tx,ty,tz in N m",
        (3, 6),
    ),
]
Angles = Annotated[
    Sequence[float] | str,
    Form("A,B,C", "down, or three finite numbers a,b,c in deg", (3,), ("down",)),
]
Box = Annotated[
    Sequence[float],
    Form("X0,X1,Y0,Y1,Z0,Z1", "six finite lengths in mm, x0,x1,y0,y1,z0,z1", (6,)),
]
JointPositions = Annotated[
    Sequence[float], Form("Q1,Q2,...", "one finite number per joint, deg or mm")
]
HeldJoints = Annotated[Mapping[str, float | None], Form("JOINT=VALUE")]
"""deg or mm by name or number of the joint; None: the value of the path or posture."""
SIZE = Form("SIZE")
Bytes = Annotated[int, SIZE]

AxisName = Literal["x", "y", "z"]
Device = Literal["auto", "cpu", "cuda"]
