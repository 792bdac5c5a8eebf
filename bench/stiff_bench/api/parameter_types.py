"""Define the types of the public functions' parameters, with the form of their values as words.

`bench` reads them: bounds are checked, and several numbers are one word with commas between.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Literal

from annotated_types import Interval

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


FilePath = Path | str
Setting = Annotated[Sequence[str], Form("KEY.OPTION=VALUE")]
Folder = Annotated[Path | str, Form("DIR")]
Picture = Annotated[Path | str, Form("FILE.png")]

Count = Annotated[int, Interval(ge=1)]
Seed = Annotated[int, Interval(ge=0, le=2**32 - 20_000)]  # a split's is this one and its number
Fraction = Annotated[float, Form("FRACTION"), Interval(gt=0.0, lt=1.0)]
PoseTolerance = Annotated[float, Form("DEG"), Interval(ge=0.0, le=LARGEST_POSE_TOLERANCE)]
Tolerance = Annotated[float, Form("MM"), Interval(ge=1e-5, le=10.0)]
Iterations = Annotated[int, Interval(ge=1, le=1000)]

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
Levels = Annotated[float | Sequence[float], Form("MM,...", "one finite number or several, in mm")]
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
