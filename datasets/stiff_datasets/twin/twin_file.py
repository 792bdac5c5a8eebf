"""Read the constants of a digital twin: a small TOML file next to a URDF.

::

    name = "my_robot_twin"
    urdf = "my_robot.urdf"            # next to this file, or the name of a shipped robot
    tip = "tool0"                     # last link of the chain; default: the longest chain's end
    tcp_m = [0.0, 0.0, 0.1]           # frame of that link
    payload_kg = 5.0
    hook_m = [0.0, 0.05, 0.0]         # point of the load, from the TCP, last joint's frame
    clearance_m = 0.2                 # the default: of random poses, to the base column

    [[joint]]                         # one per joint, base to tip
    gear = "SHG-25"                   # a name of the catalogue in gears.py, or a table, see below
    structure_Nm_per_rad = 5e5        # casing and link, in series with the gear
    tilting_ratio = 4.0               # bearing stiffness over the gear's middle slope

    [[joint]]                         # a prismatic joint, such as a linear track
    drive_N_per_m = 2e7               # stiffness along its axis
    guide_Nm_per_rad = 5e6            # tilting stiffness of its guide, about both cross axes

``[noise]`` and ``[scatter]`` have defaults, see `Noise` and `Scatter`. A gear that is not in the
catalogue is given as ``gear = {rigidity_Nm_per_rad = .., rated_Nm = ..}`` (cycloidal: one slope and
lost motion), or as ``gear = {slopes_Nm_per_rad = [..3], breakpoints_Nm = [..2], rated_Nm = ..}``
(strain wave). A structure or a tilting ratio of ``inf`` is rigid. The worlds "structure" and "all"
need the sections of the links::

    [beams]
    modulus_Pa = 7.0e10
    poisson = 0.33

    [[beams.segment]]                 # base to first joint, joint to joint, last joint to TCP
    outer_m = 0.2                     # height of the tube
    wall_m = 0.01
"""

from __future__ import annotations

from collections.abc import Sequence
from importlib.resources import as_file, files
from itertools import groupby
from pathlib import Path
from typing import Annotated, Any, Literal

import numpy as np
from annotated_types import Ge, Le
from pydantic import (
    AfterValidator,
    Discriminator,
    Field,
    PrivateAttr,
    Tag,
    ValidationError,
    model_validator,
)

from stiff_datasets.planning.loads import stream
from stiff_datasets.planning.reachable import CLEARANCE
from stiff_datasets.robots.shipped_robots import shipped_chain, shipped_robots
from stiff_datasets.robots.urdf_reader import LONGEST_TCP_M, ChainModel, read_chain
from stiff_datasets.twin.gear_law import LOST_MOTION_SHARE, GearLaw
from stiff_datasets.twin.gears import (
    CATALOGUE,
    CYCLOIDAL,
    SOFTEST,
    STIFFEST,
    Gear,
    GearKind,
    Positive,
    RvGear,
    StrainWaveGear,
    TomlTable,
)
from stiff_protocols.contract.errors import ConfigError, DataError, unknown_name
from stiff_protocols.contract.files import read_toml
from stiff_protocols.contract.types import FloatArray, Robot

LAST_SPECIMEN = 9
SpecimenNumber = Annotated[int, Ge(0), Le(LAST_SPECIMEN)]

Modulus = Annotated[float, Ge(1e9), Le(1e12), Field(allow_inf_nan=False)]  # Pa; not MPa, GPa
NotNegative = Annotated[float, Ge(0), Field(allow_inf_nan=False)]
Share = Annotated[float, Ge(0), Le(1)]  # relative standard deviation
Tail = Annotated[float, Ge(1), Le(1000)]  # degrees of freedom of Student's t distribution
Load = Annotated[float, Ge(0), Le(1000)]  # N, N m
Length = Annotated[float, Ge(-LONGEST_TCP_M), Le(LONGEST_TCP_M)]  # m; mm would be larger
Vector = tuple[Length, Length, Length]
Diameter = Annotated[float, Ge(1e-3), Le(2.0), Field(allow_inf_nan=False)]  # m; mm would be larger

REVOLUTE, PRISMATIC = "revolute", "prismatic"
SOFTEST_DRIVE, STIFFEST_DRIVE = 1e4, 1e12  # N/m

ARCMIN = np.pi / 180.0 / 60.0  # rad
SLIDE: Literal["slide"] = "slide"
"""A prismatic joint, which has no gear."""
GEAR_LOST_MOTION_ARCMIN = (0.1, 0.4)
"""Range of an RV gear's lost motion without memory (KUKA KR300: 0.1 to 0.28, measured)."""
MIN_RATIO, MAX_RATIO = 1.0, 8.0
"""Range of tilting over axial stiffness in published identifications."""


def _or_rigid(low: float, high: float) -> AfterValidator:
    def check(value: float) -> float:
        if not (low <= value <= high or value == np.inf):
            raise ValueError(f"not from {low:g} to {high:g}, nor inf, which is rigid")
        return value

    return AfterValidator(check)


def _gear_tag(gear: object) -> str | None:
    if isinstance(gear, str):
        return "gear name"
    if isinstance(gear, RvGear) or (isinstance(gear, dict) and "rigidity_Nm_per_rad" in gear):
        return "cycloidal"
    return "strain wave" if isinstance(gear, dict | StrainWaveGear) else None


class JointTable(TomlTable):
    """The elasticity of one joint.

    Attributes:
        gear: a name of the catalogue, or a separate table.
        structure_Nm_per_rad: casing and link, in series with the gear.
        tilting_ratio: stiffness across the axis over the gear's middle slope.
    """

    gear: Annotated[
        Annotated[str, Tag("gear name")]
        | Annotated[StrainWaveGear, Tag("strain wave")]
        | Annotated[RvGear, Tag("cycloidal")],
        Discriminator(
            _gear_tag,
            custom_error_type="gear",
            custom_error_message="Input should be the name of a gear, such as SHG-25, or a table",
        ),
    ]
    structure_Nm_per_rad: Annotated[float, _or_rigid(SOFTEST, STIFFEST)]
    tilting_ratio: Annotated[float, _or_rigid(MIN_RATIO, MAX_RATIO)]

    @model_validator(mode="after")
    def _known_gear(self) -> JointTable:
        if isinstance(self.gear, str) and self.gear not in CATALOGUE:
            raise ValueError(str(unknown_name("gear", self.gear, CATALOGUE)))
        return self

    @property
    def gear_figures(self) -> Gear:
        """Figures of the gear."""
        return CATALOGUE[self.gear] if isinstance(self.gear, str) else self.gear

    @property
    def tilting(self) -> float:
        """Stiffness about the two cross axes, N m/rad."""
        return self.tilting_ratio * self.gear_figures.slopes_Nm_per_rad[1]


class SlideTable(TomlTable):
    """The elasticity of one prismatic joint; it is linear.

    Attributes:
        drive_N_per_m: stiffness along the axis.
        guide_Nm_per_rad: tilting stiffness about the two cross axes.
    """

    drive_N_per_m: Annotated[float, _or_rigid(SOFTEST_DRIVE, STIFFEST_DRIVE)]
    guide_Nm_per_rad: Annotated[float, _or_rigid(SOFTEST, STIFFEST)]


def _joint_kind(table: Any) -> str:
    keys = table if isinstance(table, dict) else getattr(table, "__dict__", ())
    return PRISMATIC if {*SlideTable.model_fields} & {*keys} else REVOLUTE


AnyJoint = Annotated[
    Annotated[JointTable, Tag(REVOLUTE)] | Annotated[SlideTable, Tag(PRISMATIC)],
    Discriminator(_joint_kind),
]


class Noise(TomlTable):
    """Standard deviations of the instruments; the defaults are from the paper's data sheets.

    Attributes:
        tracker_m: noise of one reading of one axis; a deflection is the difference of two readings.
        force_N, torque_Nm: noise of the force sensor.
        tail: degrees of freedom of the readings' Student's t distribution, scaled by `tracker_m`;
            None: normal distribution.
    """

    tracker_m: Annotated[NotNegative, Le(1e-2)] = 1e-5
    force_N: Load = 0.04
    torque_Nm: Load = 0.002
    tail: Tail | None = None


class Scatter(TomlTable):
    """Relative standard deviations between robots of one type; assumption.

    Attributes:
        gear: deviation of all three slopes of a gear together.
        structure, tilting: deviation of the constants of that name, and of a prismatic joint's
            drive and guide.
        beams: deviation of the modulus of each segment's tube.
    """

    gear: Share = 0.08
    structure: Share = 0.08
    tilting: Share = 0.15
    beams: Share = 0.05


class Tube(TomlTable):
    """The section of a segment, a rectangular tube.

    Attributes:
        outer_m: height; the width is drawn, see `effects.BendingLinks`.
        wall_m: thickness.
    """

    outer_m: Diameter
    wall_m: Diameter

    @model_validator(mode="after")
    def _hollow(self) -> Tube:
        if 2.0 * self.wall_m > self.outer_m:
            raise ValueError(
                f"wall_m {self.wall_m:g} is more than half of outer_m {self.outer_m:g}"
            )
        return self


class BeamsTable(TomlTable):
    """The links' elasticity in the worlds "structure" and "all".

    Attributes:
        modulus_Pa, poisson: constants of the links' material.
        segment: one table per segment, base to TCP.
    """

    modulus_Pa: Modulus
    poisson: Annotated[float, Ge(0), Le(0.5)]
    segment: tuple[Tube, ...]


class TwinConstants(TomlTable):
    """All constants of a twin.

    Attributes:
        name: name of the twin; twins with different names have independent random numbers.
        urdf: a file next to the TOML file, or the name of a shipped robot.
        tip: last link of the chain in the URDF; None: the end of the longest chain.
        tcp_m: tool centre point in the frame of the URDF's last link, m.
        payload_kg: limit of the loads.
        hook_m: lever from the TCP to the point of the load, frame of the last joint, m.
        clearance_m: clearance of random poses, see `stiff_datasets.planning.reachable`; larger
            robots need more.
        joint: one table per joint, base to tip.
        beams: the links' elasticity; None: rigid links.
        noise, scatter: see `Noise` and `Scatter`.
    """

    name: Annotated[str, Field(pattern=r"^[\w.-]+$")]
    urdf: str
    tip: str | None = None
    tcp_m: Vector
    payload_kg: Positive
    hook_m: Vector
    clearance_m: Annotated[float, Ge(0), Le(LONGEST_TCP_M)] = CLEARANCE
    joint: tuple[AnyJoint, ...]
    beams: BeamsTable | None = None
    noise: Noise = Noise()
    scatter: Scatter = Scatter()
    _path: Path = PrivateAttr(default=Path())
    _robot: Robot | None = PrivateAttr(default=None)

    @classmethod
    def of_robot(cls, robot: Robot, **tables: Any) -> TwinConstants:
        """Return the constants of a robot that no file describes; `tables` are the others."""
        tables["tcp_m"] = tuple(robot.tcp_on_flange.tolist())
        constants = cls(name=robot.name, urdf=f"{robot.name}.urdf", **tables)
        constants._robot = robot
        return constants

    @property
    def gear_kinds(self) -> tuple[GearKind | Literal["slide"], ...]:
        """Kind of every joint's gear."""
        return tuple(
            SLIDE if isinstance(joint, SlideTable) else joint.gear_figures.kind
            for joint in self.joint
        )

    @property
    def rated_torques(self) -> FloatArray:
        """(n_joints,) rated torque of every gear, N m; 0 for a slide."""
        return np.array(
            [
                0.0 if isinstance(joint, SlideTable) else joint.gear_figures.rated_Nm
                for joint in self.joint
            ]
        )

    def chain(self) -> ChainModel:
        """Read the rigid robot for the twin.

        Raises:
            DataError: the URDF cannot be read, or its joints do not match the tables.
        """
        try:
            if self.urdf in {robot.urdf for robot in shipped_robots().values()}:
                chain = shipped_chain(self.urdf, self.tcp_m)
            else:
                file = self._path.parent / self.urdf
                chain = read_chain(file, tcp=self.tcp_m, tip=self.tip)
        except (ConfigError, DataError) as error:
            raise DataError(f"{self._path}: {error}") from error
        if chain.robot.mimics:
            raise DataError(
                f"{self._path}: {self.urdf}: {chain.robot.mimics[0].name} is a mimic joint, which "
                "a twin does not simulate (valid: independent joints)"
            )
        kinds = chain.robot.joint_types
        tables = tuple(map(_joint_kind, self.joint))
        if tables != kinds:
            raise DataError(
                f"{self._path}: {len(tables)} tables [[joint]] for the joints of {self.urdf}: "
                f"{_counted(tables)} for {_counted(kinds)} (valid: one table per joint, of its "
                "kind, base to tip; a prismatic joint has drive_N_per_m and guide_Nm_per_rad)"
            )
        if self.beams is not None and PRISMATIC in kinds:
            raise DataError(
                f"{self._path}: [beams] with a prismatic joint, whose links change their length "
                "(valid: no [beams])"
            )
        if self.beams is not None and len(self.beams.segment) != len(kinds) + 1:
            raise DataError(
                f"{self._path}: {len(self.beams.segment)} tables [[beams.segment]] for "
                f"{len(kinds)} joints (valid: {len(kinds) + 1}, from the base to the TCP)"
            )
        if not chain.robot.has_masses:
            raise DataError(
                f"{self._path}: no link of {self.urdf} has a mass; a twin needs them, because the "
                "weight preloads its gears (valid: <inertial> in every <link>)"
            )
        return chain

    def robot(self) -> Robot:
        """Read the rigid robot for the models, unless it was drawn; errors: see `chain`."""
        return self._robot or self.chain().robot


def _counted(kinds: Sequence[str]) -> str:
    """Count the kinds of joints, base to tip, such as "1 prismatic, 6 revolute"."""
    return (
        ", ".join(f"{len([*equal_kinds])} {kind}" for kind, equal_kinds in groupby(kinds)) or "none"
    )


def specimen_law(constants: TwinConstants, specimen: int) -> GearLaw:
    """Return the law of all elastic coordinates of one robot, with arrays (..., 3 n_joints, 1).

    A strain-wave gear has three slopes. An RV gear has one, and lost motion without memory. Tilts
    and slides are linear. Number 0 has the constants of the file. The others differ by log-normal
    factors with the standard deviations of `Scatter`. Links, masses and the TCP are the same in
    all: their production tolerances change a deflection by a thousandth.
    """
    n, scatter = len(constants.joint), constants.scatter
    factors = np.ones((n, 4))
    if specimen:
        deviations = (scatter.gear, scatter.structure, scatter.tilting, scatter.tilting)
        rng = stream("specimen", constants.name, specimen)
        factors = np.exp(rng.normal(size=factors.shape) * deviations)
    rng = stream("lost motion", constants.name, specimen)
    widths = rng.uniform(*GEAR_LOST_MOTION_ARCMIN, size=n) * ARCMIN
    compliance, breakpoints = np.zeros((3, 3 * n, 1)), np.ones((2, 3 * n, 1))
    breakpoints[1] = 2.0
    lost_motion, torque = np.zeros((3 * n, 1)), np.ones((3 * n, 1))
    for number, (joint, (of_gear, of_structure, *of_tilts)) in enumerate(
        zip(constants.joint, factors, strict=True)
    ):
        row = 3 * number
        tilts = slice(row + 1, row + 3)
        if isinstance(joint, SlideTable):
            compliance[:, row, 0] = 1.0 / (joint.drive_N_per_m * of_structure)
            compliance[:, tilts, 0] = 1.0 / (joint.guide_Nm_per_rad * np.array(of_tilts))
            continue
        gear = joint.gear_figures
        slopes = np.array(gear.slopes_Nm_per_rad) * of_gear
        compliance[:, row, 0] = 1.0 / slopes + 1.0 / (joint.structure_Nm_per_rad * of_structure)
        compliance[:, tilts, 0] = 1.0 / (joint.tilting * np.array(of_tilts))
        breakpoints[:, row, 0] = gear.breakpoints_Nm
        if gear.kind == CYCLOIDAL:
            lost_motion[row], torque[row] = widths[number], LOST_MOTION_SHARE * gear.rated_Nm
    none = np.zeros((0, 1, 1))
    return GearLaw(compliance, breakpoints, lost_motion, torque, none, none)


def read_constants(path: Path) -> TwinConstants:
    """Read a TOML file of constants.

    Raises:
        DataError: the file cannot be read, or a key or value is invalid; the message names it.
    """
    table = read_toml(path)
    try:
        constants = TwinConstants(**table)
    except ValidationError as error:
        raise DataError(f"{path}: {_first_problem(error)}") from error
    constants._path = path
    return constants


def _first_problem(error: ValidationError) -> str:
    """Return the first error and its key; joints and segments count from 1."""
    problem = error.errors()[0]
    tags = (
        REVOLUTE,
        PRISMATIC,
        "gear name",
        "strain wave",
        "cycloidal",
    )  # tags of unions, not in files
    path = [part + 1 if isinstance(part, int) else part for part in problem["loc"]]
    key_path = ".".join(str(part) for part in path if part not in tags)
    is_value = problem["type"] != "missing" and not isinstance(problem["input"], dict)
    input_text = repr(problem["input"]) if is_value else ""
    message_parts = (key_path, input_text, problem["msg"].removeprefix("Value error, "))
    return ": ".join(filter(None, message_parts))


def shipped_constants(name: str) -> TwinConstants:
    """Read a shipped TOML file, named without its extension."""
    with as_file(files("stiff_datasets") / "twins" / f"{name}.toml") as path:
        return read_constants(path)


def shipped_twins() -> dict[str, str]:
    """Return the shipped twins: command-line name -> TOML file."""
    twin_files = (files("stiff_datasets") / "twins").iterdir()
    names = sorted(file.name.removesuffix(".toml") for file in twin_files)
    return {name.replace("_", "-"): name for name in names}
