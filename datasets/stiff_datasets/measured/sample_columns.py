"""Define the columns of a file of measured samples: names, units, aliases.

One row per load at a pose: ``pose_id, load_id, group, q1_deg .. qn_deg, fx_N, fy_N, fz_N, tx_Nm,
ty_Nm, tz_Nm, dx_mm, dy_mm, dz_mm`` (``q2_mm`` if joint 2 is prismatic). The wrench acts at the
TCP; wrench and deflection are expressed in the robot base frame; a deflection is the loaded minus
the unloaded position. Instead, a file may have both positions of the TCP, ``x0_mm .. z0_mm``
(unloaded) and ``x1_mm .. z1_mm`` (loaded). A file may also say when a row was read (``order``, a
number or a time), from which direction each joint reached the pose (``approach_q1 ..``, 1 or -1),
and what remained after the load was taken off (``after_dx_mm, after_dy_mm, after_dz_mm``).
"""

from __future__ import annotations

import re
from collections.abc import Iterator
from dataclasses import dataclass, replace
from typing import Literal, get_args

import numpy as np

from stiff_protocols.contract.types import FloatArray, Robot, TextArray

ID_COLUMNS = ("pose_id", "load_id", "group")
SIMULATED_GROUP = "simulated"
"""Group of rows written by `bench data simulate`."""
WRENCH_COLUMNS = ("fx_N", "fy_N", "fz_N", "tx_Nm", "ty_Nm", "tz_Nm")
TORQUE_COLUMNS = WRENCH_COLUMNS[3:]
DEFLECTION_COLUMNS = ("dx_mm", "dy_mm", "dz_mm")
UNLOADED_COLUMNS = ("x0_mm", "y0_mm", "z0_mm")
LOADED_COLUMNS = ("x1_mm", "y1_mm", "z1_mm")
"""Positions of the TCP in place of its deflection."""
ORDER = "order"
READING = "reading_mm"
DIRECTION_COLUMNS = ("reading_x", "reading_y", "reading_z")
"""A number that was read, and its direction."""
POINT_COLUMNS = ("point_x_mm", "point_y_mm", "point_z_mm")
"""Point of the last link that was read."""
AFTER_COLUMNS = ("after_dx_mm", "after_dy_mm", "after_dz_mm")
Criterion = Literal["d-optimal", "i-optimal"]
"""Criterion of a measurement plan, which is the `group` of its rows."""
MM_PER_M = 1000.0
DEG_PER_RAD = 180.0 / np.pi
EMPTY_SIGNS = {"", *"- -- \u2014 ? n/a na nan none null <na> nat tbd todo".split()}
"""Signs of a cell that is not filled in yet, in lower case."""
DECIMALS = 10
"""Numbers are written with this many decimals if they read back as the same SI number."""

MAX_CELL_LENGTH = 100
"""Characters of a name or a number; the longest name sets the width of an array of names."""
_MAX_CELL_SHOWN = 60
"""Characters of an invalid cell in a message."""

UNITS = {
    "deg": {"deg": 1.0, "degrees": 1.0, "grad": 1.0, "°": 1.0, "rad": DEG_PER_RAD},
    "mm": {"mm": 1.0, "m": MM_PER_M, "um": 1e-3, "µm": 1e-3, "μm": 1e-3, "micron": 1e-3},
    "N": {"n": 1.0, "kn": 1e3, "kg": 9.80665, "kgf": 9.80665},
    "Nm": {"nm": 1.0, "knm": 1e3, "nmm": 1e-3},
    "kg": {"kg": 1.0},
}
"""Standard unit -> units in headers, in lower case -> factor to the standard unit."""
MAX_NUMBER = 1e6
"""N, N m, deg or mm; no number of a file is larger."""


@dataclass(frozen=True)
class Column:
    """A column of files; `{}` stands for each axis, or for the number of each joint.

    Attributes:
        name: its name without the unit.
        unit: one of `UNITS`, at the end of its name in a file; "" for none.
        meaning: what it holds, in words.
        aliases: pattern of names in lower case, without unit, blanks, hyphens and underscores; the
            group is what `{}` stands for.
        limit: largest size of a number, in its unit.
    """

    name: str
    unit: str
    meaning: str
    aliases: str = "(?!)"
    limit: float = MAX_NUMBER


def _vector(
    name: str, unit: str, meaning: str, letters: str, words: str, limit: float = MAX_NUMBER
) -> Column:
    aliases = f"(?:{words}|(?:{words})?(?:{letters}))([xyz])"
    return Column(name, unit, f"{meaning}, {{}} component, robot base frame", aliases, limit)


def _position(name: str, state: str, words: str) -> Column:
    meaning = f"position of the {state} TCP, {{}} coordinate, in a frame with the base's axes"
    return Column(name, "mm", meaning, f"(?:{words})([xyz])|([xyz])(?:{words})")


_JOINT_WORDS = (
    "joints?|jointangles?|jointpositions?|axis|axes|axisangles?|angles?|"
    "gelenke?|gelenkwinkel|achsen?|achswinkel|achsenwinkel|achsstellung(?:en)?|winkel"
)
_JOINT = "position of joint {} (joint 1 at the base) of the unloaded robot"
_POSE = "name of the robot pose; rows of one pose have the same joint positions"
HEADER_COLUMNS = (
    Column("pose_id", "", _POSE, "pose(?:id)?"),
    Column("load_id", "", "name of the load at the pose", "load(?:id)?"),
    Column("group", "", "part of the measurement that the pose belongs to"),
    Column(
        "q{}",
        "deg",
        _JOINT,
        f"(?:{_JOINT_WORDS}|(?:{_JOINT_WORDS})?(?:[ajq]|theta|θ))([1-9])",
    ),
    _vector("f{}", "N", "force on the robot at the TCP", "f", "forces?|kraft|kräfte"),
    _vector(
        "t{}",
        "Nm",
        "torque on the robot at the TCP",
        "[tm]",
        "torques?|moments?|momente|drehmomente?",
    ),
    _vector(
        "d{}",
        "mm",
        "deflection of the TCP (loaded minus unloaded position)",
        "[duδ]|delta",
        "deflections?|displacements?|deformations?|"
        "(?:auslenkung|verformung|verschiebung|verlagerung)(?:en)?",
        np.inf,  # checked with their unit
    ),
    _position("{}0", "unloaded", "unloaded|unbelastet|ohnelast"),
    _position("{}1", "loaded", "loaded|belastet|mitlast"),
)
"""Columns that make a row the header of a table."""
FURTHER_COLUMNS = (
    Column("q{}", "mm", _JOINT),
    Column(
        ORDER,
        "",
        "number or time of the reading, in the order of the measurement",
        "time|timestamp|zeit|zeitstempel|reihenfolge",
        np.inf,
    ),
    Column(
        "approach_q{}",
        "",
        "direction from which joint {} reached the pose: 1, -1, or 0 if it did not move",
    ),
    Column(
        "after_d{}",
        "mm",
        "displacement of the TCP that stays after the load is taken off, {} component, robot base "
        "frame",
    ),
    Column("mass", "kg", "mass of the hanging weight"),
    Column("pull", "N", "pull of a rope at the hook"),
    Column("pull_{}", "", "direction of the pull on the robot, {} component, robot base frame"),
    Column("reading", "mm", "gauge loaded, less the gauge unloaded"),
    Column("reading0", "mm", "gauge unloaded"),
    Column("reading1", "mm", "gauge loaded"),
    Column("reading2", "mm", "gauge unloaded again"),
    Column("reading_{}", "", "direction in which the gauge counts up, {} component, base frame"),
    Column("point_{}", "mm", "point that the gauge touches, {}, frame of the robot's last link"),
    Column("loading", "", "first, second or mean: which unloaded reading counts"),
    Column("state", "", "unloaded or loaded: a row is one state of the gauge or tracker"),
    Column("{}", "mm", "", limit=1e5),
    *(Column(angle, "deg", "", limit=1e4) for angle in "abc"),
)
"""Columns that samples may have, too, and columns of paths."""


def _single_columns(columns: tuple[Column, ...]) -> Iterator[Column]:
    """Yield the column of each axis and each joint."""
    for column in columns:
        for key in "123456789" if "q{}" in column.name else "xyz" if "{}" in column.name else "-":
            name, meaning = column.name.format(key), column.meaning.format(key)
            yield replace(column, name=name, meaning=meaning)


NAMES = {column.name: UNITS.get(column.unit, {}) for column in _single_columns(HEADER_COLUMNS)}
"""Name in a header, without unit -> factors of its units."""
COLUMNS = {
    f"{column.name}_{column.unit}".rstrip("_"): column
    for column in _single_columns((*HEADER_COLUMNS, *FURTHER_COLUMNS))
}
"""Name in a file -> column."""
GAUGE_COLUMNS = tuple(
    name
    for name, column in COLUMNS.items()
    if column.name.startswith(("mass", "pull", "reading", "point", "loading", "state"))
)
"""Columns of a workshop, which `gauge_columns.py` reads."""
_UNIT_WORDS = "|".join(unit for units in UNITS.values() for unit in units)
_HEADER = re.compile(
    rf"(.+?)[\s_]*(?:[\[(]\s*(.*?)\s*[\])]|(?:/\s*|\s+in\s+|[\s_])({_UNIT_WORDS}))?"
)


def split_header(header: str) -> tuple[str, str]:
    """Return the standard name of a column without its unit, and the unit, "" for none.

    A text that is too long for a name is returned unchanged.
    """
    if len(header) > MAX_CELL_LENGTH:
        return header, ""
    header = re.sub(r"\.\d+$", "", header)  # pandas numbers repeated names
    text = re.sub(r"n[ ·⋅*]m", "nm", header.strip().lower())
    match = _HEADER.fullmatch(text)
    name, bracketed_unit, plain_unit = match.groups() if match else (text, None, None)
    bare_name, unit = re.sub(r"[\s_-]", "", name), bracketed_unit or plain_unit or ""
    for column in (*HEADER_COLUMNS, *FURTHER_COLUMNS):
        if alias := re.fullmatch(column.aliases, bare_name):
            return column.name.format(*filter(None, alias.groups())), unit
    return bare_name, unit


def joint_columns(robot: Robot) -> tuple[str, ...]:
    """Return the names of the joint columns, base to tip, with their units."""
    units = {"revolute": "deg", "prismatic": "mm"}
    return tuple(f"q{i + 1}_{units[kind]}" for i, kind in enumerate(robot.joint_types))


def all_columns(robot: Robot) -> tuple[str, ...]:
    """Return the names of all columns in file order."""
    return (*ID_COLUMNS, *joint_columns(robot), *WRENCH_COLUMNS, *DEFLECTION_COLUMNS)


def optional_columns(robot: Robot) -> tuple[str, ...]:
    """Return the names of numbers that a file of samples may have, too."""
    approach = (f"approach_q{i + 1}" for i in range(robot.n_joints))
    return (ORDER, *approach, *AFTER_COLUMNS)


def is_planned(group: TextArray) -> bool:
    """Test if all samples are of `bench data plan`, by their (n,) groups."""
    return bool(np.isin(group, get_args(Criterion)).all())


def file_units(robot: Robot) -> FloatArray:
    """Return (n_joints,) file units per rad or m."""
    return np.where(robot.turns, DEG_PER_RAD, MM_PER_M)


def in_file_units(values: FloatArray, unit: float) -> FloatArray:
    """Return (n,) numbers x for which x / `unit` equals `values` (n,), or is nearest."""
    with np.errstate(over="ignore"):  # then another candidate is right
        result = np.asarray(values * unit)
        candidates = (
            np.nextafter(result, np.inf),
            np.nextafter(result, -np.inf),
            result,
            np.round(result, DECIMALS),
        )
    for candidate in candidates:  # the best last
        result = np.where(candidate / unit == values, candidate, result)
    return result


def shortened(text: str, limit: int = _MAX_CELL_SHOWN) -> str:
    """Return the first characters of a long text."""
    return text if len(text) <= limit else f"{text[:limit]}..."


def counted(number: int, thing: str) -> str:
    """Return "1 row", "5 rows"."""
    return f"{number} {thing}" if number == 1 else f"{number} {thing}s"


_UNIT_NAMES = {"deg": "deg", "N": "N", "Nm": "N m", "mm": "mm", "mm_s": "mm/s"}
"""End of a column's name -> the unit in text."""


def column_unit(column: str) -> str:
    """Return the unit at the end of a column's name, such as "N m"; "" for none."""
    match = re.fullmatch(r"\w+?_(deg|Nm|N|mm_s|mm)", column)
    return _UNIT_NAMES[match[1]] if match else ""
