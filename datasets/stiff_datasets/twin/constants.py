"""The constants of a digital twin: a small TOML file beside a URDF.

::

    name = "my_robot_twin"
    urdf = "my_robot.urdf"            # beside this file, or the name of a shipped robot
    tcp_m = [0.0, 0.0, 0.1]           # frame of the URDF's last link
    payload_kg = 5.0
    hook_m = [0.0, 0.05, 0.0]         # where the load pulls, from the TCP, last joint's frame

    [[joint]]                         # one a joint, base to tip
    gear = 25                         # a catalogue size, or the three figures of [joint.gear]
    structure_Nm_per_rad = 5e5        # casing and link, in series with the gear
    tilting_ratio = 4.0               # bearing stiffness over the gear's middle slope K2
    lost_motion_arcmin = 1.0          # full width

``[noise]`` and ``[scatter]`` have defaults, see `Noise` and `Scatter`. A gear that is not in the
catalogue: ``gear = {slopes_Nm_per_rad = [..3], breakpoints_Nm = [..2], rated_Nm = ..}``.
"""

from __future__ import annotations

from dataclasses import replace
from functools import cached_property
from importlib.resources import as_file, files
from pathlib import Path
from typing import Annotated, Any

import numpy as np
from annotated_types import Ge, Gt, Le
from pydantic import (
    BaseModel,
    ConfigDict,
    Field,
    PrivateAttr,
    StrictInt,
    ValidationError,
    model_validator,
)

from stiff_datasets.planning.loads import stream
from stiff_datasets.robots.robot import (
    LONGEST_TCP_M,
    ChainModel,
    joint_type_and_axis,
    read_chain,
    robot_of,
    shipped_chain,
    shipped_names,
)
from stiff_datasets.twin.springs import Gear, JointSprings
from stiff_protocols.contract.errors import DataError, unknown_name
from stiff_protocols.contract.files import read_toml
from stiff_protocols.contract.types import Robot

LAST_SPECIMEN = 9
SpecimenNumber = Annotated[int, Ge(0), Le(LAST_SPECIMEN)]


def specimen_springs(constants: TwinConstants, specimen: int) -> tuple[JointSprings, ...]:
    """Return the joint springs of one robot of a type.

    Number 0 has the constants as they stand; the others differ from it by log-normal factors
    whose standard deviations are `Scatter`'s. Links, masses and the TCP are alike in all: what
    they differ by in production changes a deflection by a thousandth.
    """
    if specimen == 0:
        return constants.springs
    rng, scatter, drawn = stream("specimen", constants.name, specimen), constants.scatter, []
    deviations = (scatter.gear, scatter.structure, scatter.tilting, scatter.tilting)
    for joint in constants.springs:
        gear, structure, *tilting, lost_motion = np.exp(
            rng.normal(size=5) * np.array([*deviations, scatter.lost_motion])
        ).tolist()
        first, second, third = (slope * gear for slope in joint.gear.slopes)
        drawn.append(
            JointSprings(
                gear=replace(joint.gear, slopes=(first, second, third)),
                structure=joint.structure * structure,
                tilting=(joint.tilting[0] * tilting[0], joint.tilting[1] * tilting[1]),
                lost_motion=joint.lost_motion * lost_motion,
            )
        )
    return tuple(drawn)


Positive = Annotated[float, Gt(0), Field(allow_inf_nan=False)]
NotNegative = Annotated[float, Ge(0), Field(allow_inf_nan=False)]
Length = Annotated[float, Ge(-LONGEST_TCP_M), Le(LONGEST_TCP_M)]  # m; mm would be larger
Vector = tuple[Length, Length, Length]

ARCMIN = np.pi / 180.0 / 60.0  # rad
SMALLEST_RATIO, LARGEST_RATIO = 1.0, 8.0
"""Tilting stiffness against axial stiffness: the range of published identifications."""

CATALOGUE = {
    14: Gear((0.47e4, 0.61e4, 0.71e4), (2.0, 6.9), 7.8),
    17: Gear((1.0e4, 1.4e4, 1.6e4), (3.9, 12.0), 24.0),
    20: Gear((1.6e4, 2.5e4, 2.9e4), (7.0, 25.0), 40.0),
    25: Gear((3.1e4, 5.0e4, 5.7e4), (14.0, 48.0), 67.0),
    32: Gear((6.7e4, 11.0e4, 12.0e4), (29.0, 108.0), 137.0),
}
"""Strain-wave gears by size, ratio 80 and above. Recalled from the manufacturer's catalogue and so
an assumption, but for the slopes of size 32, which were confirmed; rated torques: assumption."""


class _Table(BaseModel):
    """A TOML table: unknown keys are errors, values do not change."""

    model_config = ConfigDict(extra="forbid", frozen=True)


class GearTable(_Table):
    """A gear that is not in the catalogue; see `stiff_datasets.twin.springs.Gear`."""

    slopes_Nm_per_rad: tuple[Positive, Positive, Positive]
    breakpoints_Nm: tuple[Positive, Positive]
    rated_Nm: Positive

    @model_validator(mode="after")
    def _ascending(self) -> GearTable:
        first, second = self.breakpoints_Nm
        if first >= second:
            raise ValueError(f"breakpoints_Nm {first:g}, {second:g}: the second must be larger")
        return self


class JointTable(_Table):
    """The elasticity of one joint.

    Attributes:
        gear: catalogue size or a table of its own.
        structure_Nm_per_rad: casing and link, in series with the gear.
        tilting_ratio: stiffness across the axis over the gear's K2.
        lost_motion_arcmin: full width.
    """

    gear: StrictInt | GearTable
    structure_Nm_per_rad: Positive
    tilting_ratio: Annotated[float, Ge(SMALLEST_RATIO), Le(LARGEST_RATIO)]
    lost_motion_arcmin: NotNegative

    @model_validator(mode="after")
    def _known_gear(self) -> JointTable:
        if isinstance(self.gear, int) and self.gear not in CATALOGUE:
            raise ValueError(f"gear size {self.gear} (valid: {', '.join(map(str, CATALOGUE))})")
        return self

    @cached_property
    def springs(self) -> JointSprings:
        """The same in SI units."""
        if isinstance(self.gear, int):
            gear = CATALOGUE[self.gear]
        else:
            gear = Gear(self.gear.slopes_Nm_per_rad, self.gear.breakpoints_Nm, self.gear.rated_Nm)
        tilting = self.tilting_ratio * gear.slopes[1]
        lost_motion = self.lost_motion_arcmin * ARCMIN
        return JointSprings(gear, self.structure_Nm_per_rad, (tilting, tilting), lost_motion)


class Noise(_Table):
    """Standard deviations of the instruments; the defaults are the source paper's data sheets.

    Attributes:
        tracker_m: of one reading of one axis; a deflection is the difference of two readings.
        force_N, torque_Nm: of the force sensor.
    """

    tracker_m: NotNegative = 1e-5
    force_N: NotNegative = 0.04
    torque_Nm: NotNegative = 0.002


class Scatter(_Table):
    """How much robots of one type differ: relative standard deviations; assumption.

    Attributes:
        gear: of all three slopes of a gear together.
        structure, tilting, lost_motion: of the constants of that name.
    """

    gear: NotNegative = 0.08
    structure: NotNegative = 0.08
    tilting: NotNegative = 0.15
    lost_motion: NotNegative = 0.2


class TwinConstants(_Table):
    """All constants of a twin.

    Attributes:
        name: of the twin; random numbers belong to it, so twins of two names share none.
        urdf: a file beside the TOML file, or the name of a shipped robot.
        tcp_m: tool centre point in the frame of the URDF's last link, m.
        payload_kg: no load is heavier.
        hook_m: lever from the TCP to where the load pulls, frame of the last joint, m.
        joint: one table a joint, base to tip.
        noise, scatter: see there.
    """

    name: Annotated[str, Field(pattern=r"^[\w.-]+$")]
    urdf: str
    tcp_m: Vector
    payload_kg: Positive
    hook_m: Vector
    joint: tuple[JointTable, ...]
    noise: Noise = Noise()
    scatter: Scatter = Scatter()
    _path: Path = PrivateAttr(default=Path())

    @property
    def springs(self) -> tuple[JointSprings, ...]:
        """The elasticity of every joint, base to tip, SI units."""
        return tuple(joint.springs for joint in self.joint)

    def chain(self) -> ChainModel:
        """Read the rigid robot for the twin.

        Raises:
            DataError: the URDF cannot be read, or its joints are not those of the tables.
        """
        try:
            if self.urdf in shipped_names():
                chain = shipped_chain(self.urdf, tcp=self.tcp_m)
            else:
                chain = read_chain(self._path.parent / self.urdf, tcp=self.tcp_m)
        except DataError as error:
            raise DataError(f"{self._path}: {error}") from error
        model = chain.model
        kinds = [joint_type_and_axis(model, joint)[0] for joint in range(1, model.njoints)]
        if len(self.joint) != len(kinds) or "prismatic" in kinds:
            raise DataError(
                f"{self._path}: {len(self.joint)} tables [[joint]] for the joints of {self.urdf}: "
                f"{', '.join(kinds)} (valid: one table a joint, all revolute)"
            )
        return chain

    def robot(self) -> Robot:
        """Read the rigid robot for the models; errors as `chain`."""
        return robot_of(self.chain())


def read_constants(path: Path) -> TwinConstants:
    """Read a TOML file of constants.

    Raises:
        DataError: it cannot be read, or a key or value is wrong; the message names them.
    """
    try:
        table = read_toml(path)
    except OSError as error:
        raise DataError(f"{path}: cannot be read: {error.strerror or error}") from error
    except ValueError as error:
        raise DataError(f"{path}: not a TOML file: {error}") from error
    try:
        constants = TwinConstants(**table)
    except ValidationError as error:
        raise DataError(f"{path}: {_first_problem(error)}") from error
    constants._path = path
    return constants


def _first_problem(error: ValidationError) -> str:
    problems: list[Any] = list(error.errors())
    # a gear is a number or a table: that it is not the other one says nothing
    telling = [p for p in problems if p["type"] not in ("int_type", "model_type")] or problems
    # a wrong name explains the name that is missing
    problem = next((p for p in telling if p["type"] == "extra_forbidden"), telling[0])
    path = [
        str(part + 1) if isinstance(part, int) else part
        for part in problem["loc"]
        if not str(part).startswith(("int", "GearTable", "function-"))
    ]
    where = ".".join(path)
    kind, about = problem["type"], problem.get("ctx", {})
    if kind == "missing":
        return f"{where} is missing"
    if kind == "value_error":  # our own, of a whole table
        return f"{where}: {about['error']}"
    if kind == "extra_forbidden":
        *above, name = path
        table = GearTable if "gear" in above else _TABLES.get((*above, "")[0], TwinConstants)
        return str(unknown_name(f"{'.'.join(above)} key".strip(), name, table.model_fields))
    valid = _VALID[kind].format(**about) if kind in _VALID else problem["msg"]
    return f"{where}: {problem['input']!r} (valid: {valid})"


_VALID = {
    **dict.fromkeys(("float_type", "float_parsing"), "a number"),
    **dict.fromkeys(("int_type", "int_parsing"), "a whole number"),
    **dict.fromkeys(("tuple_type", "list_type"), "a list"),
    **dict.fromkeys(("model_type", "dict_type"), "a table"),
    "string_type": "a text",
    "string_pattern_mismatch": "letters, digits, and _ . -",
    "finite_number": "a finite number",
    "greater_than": "a number above {gt:g}",
    "greater_than_equal": "a number of at least {ge:g}",
    "less_than": "a number below {lt:g}",
    "less_than_equal": "a number of at most {le:g}",
    "too_long": "at most {max_length} entries",
    "too_short": "at least {min_length} entries",
}
"""Pydantic's name of a problem -> what is valid, in our words."""


_TABLES: dict[str, type[_Table]] = {"joint": JointTable, "noise": Noise, "scatter": Scatter}


def shipped_constants(name: str) -> TwinConstants:
    """Read one of stiffbench's own TOML files, named without its ending."""
    with as_file(files("stiff_datasets") / "twins" / f"{name}.toml") as path:
        return read_constants(path)


def shipped_twins() -> dict[str, str]:
    """Return the names of stiffbench's own twins on the command line -> their TOML files."""
    names = [
        f.name[:-5]
        for f in (files("stiff_datasets") / "twins").iterdir()
        if f.name.endswith(".toml")
    ]
    return {name.replace("_", "-"): name for name in sorted(names)}
