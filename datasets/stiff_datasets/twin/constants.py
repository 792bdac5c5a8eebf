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
    gear = 25                         # a catalogue size, or a table, see below
    structure_Nm_per_rad = 5e5        # casing and link, in series with the gear
    tilting_ratio = 4.0               # bearing stiffness over the gear's middle slope K2
    lost_motion_arcmin = 1.0          # full width

    [[joint]]                         # a prismatic joint, such as a linear track
    drive_N_per_m = 2e7               # stiffness along its axis
    guide_Nm_per_rad = 5e6            # tilting stiffness of its guide, about both cross axes

``[noise]``, ``[scatter]`` and ``[errors]`` have defaults, see `Noise`, `Scatter` and `Errors`. A
gear that is not in the catalogue is given as
``gear = {slopes_Nm_per_rad = [..3], breakpoints_Nm = [..2], rated_Nm = ..}``. A structure or a
tilting ratio of ``inf`` is rigid. Links bend if the file has their sections::

    [beams]
    modulus_Pa = 7.0e10
    poisson = 0.33
    foundation_N_per_m = 2e8          # foundation of the base; rigid by default
    foundation_Nm_per_rad = 1e7
    bend = "always"                   # or "effect", the default: only with the effect "links"
                                      # or physics = rigid

    [[beams.segment]]                 # base to first joint, joint to joint, last joint to TCP
    outer_m = 0.2
    wall_m = 0.01
"""

from __future__ import annotations

from collections.abc import Sequence
from functools import cached_property
from importlib.resources import as_file, files
from itertools import groupby
from pathlib import Path
from typing import Annotated, Any, Literal

import numpy as np
from annotated_types import Ge, Le, Lt
from pydantic import (
    AfterValidator,
    Discriminator,
    Field,
    PrivateAttr,
    StrictInt,
    Tag,
    ValidationError,
    model_validator,
)

from stiff_datasets.planning.loads import stream
from stiff_datasets.planning.reachable import CLEARANCE
from stiff_datasets.robots.shipped_robots import shipped_chain, shipped_robots
from stiff_datasets.robots.urdf_reader import LONGEST_TCP_M, ChainModel, read_chain
from stiff_datasets.twin.beams import Beams, Tube
from stiff_datasets.twin.gear_law import LOST_MOTION_SHARE, GearLaw
from stiff_datasets.twin.spring_law import (
    SOFTEST,
    STIFFEST,
    Gear,
    JointSprings,
    Positive,
    SlideSprings,
    TomlTable,
)
from stiff_protocols.contract.errors import ConfigError, DataError
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

TwinPhysics = Literal["tilting", "rigid"]
"""Bearings that tilt as given in the file, or rigid bearings and links that bend."""

REVOLUTE, PRISMATIC = "revolute", "prismatic"
SOFTEST_DRIVE, STIFFEST_DRIVE = 1e4, 1e12  # N/m

ARCMIN = np.pi / 180.0 / 60.0  # rad
STRAIN_WAVE, CYCLOIDAL, SLIDE = "strain wave", "RV", "slide"
"""Kinds of gears; a slide has none."""
GEAR_LOST_MOTION_ARCMIN = (0.1, 0.4)
"""Range of an RV gear's lost motion without memory (KUKA KR300: 0.1 to 0.28, measured)."""
MAX_LOST_MOTION = 60.0  # arcmin
MIN_RATIO, MAX_RATIO = 1.0, 8.0
"""Range of tilting over axial stiffness in published identifications."""

CATALOGUE = {
    size: Gear(slopes_Nm_per_rad=slopes, breakpoints_Nm=breakpoints, rated_Nm=rated)
    for size, slopes, breakpoints, rated in (
        (14, (0.47e4, 0.61e4, 0.71e4), (2.0, 6.9), 7.8),
        (17, (1.0e4, 1.4e4, 1.6e4), (3.9, 12.0), 24.0),
        (20, (1.6e4, 2.5e4, 2.9e4), (7.0, 25.0), 40.0),
        (25, (3.1e4, 5.0e4, 5.7e4), (14.0, 48.0), 67.0),
        (32, (6.7e4, 11.0e4, 12.0e4), (29.0, 108.0), 137.0),
    )
}
"""Strain-wave gears by size, ratio 80 and above, recalled from the manufacturer's catalogue. The
slopes of size 32 were confirmed. All other slopes and the rated torques are assumptions."""


def _or_rigid(low: float, high: float) -> AfterValidator:
    def check(value: float) -> float:
        if not (low <= value <= high or value == np.inf):
            raise ValueError(f"not from {low:g} to {high:g}, nor inf, which is rigid")
        return value

    return AfterValidator(check)


def _gear_kind(gear: object) -> str | None:
    if isinstance(gear, dict | Gear):
        return "table"
    return "size" if isinstance(gear, int) else None


class JointTable(TomlTable):
    """The elasticity of one joint.

    Attributes:
        gear: catalogue size or a separate table.
        structure_Nm_per_rad: casing and link, in series with the gear.
        tilting_ratio: stiffness across the axis over the gear's K2.
        lost_motion_arcmin: full width.
    """

    gear: Annotated[
        Annotated[StrictInt, Tag("size")] | Annotated[Gear, Tag("table")],
        Discriminator(
            _gear_kind,
            custom_error_type="gear",
            custom_error_message="Input should be an integer size or a table",
        ),
    ]
    structure_Nm_per_rad: Annotated[float, _or_rigid(SOFTEST, STIFFEST)]
    tilting_ratio: Annotated[float, _or_rigid(MIN_RATIO, MAX_RATIO)]
    lost_motion_arcmin: Annotated[NotNegative, Le(MAX_LOST_MOTION)]

    @model_validator(mode="after")
    def _known_gear(self) -> JointTable:
        if isinstance(self.gear, int) and self.gear not in CATALOGUE:
            raise ValueError(f"gear size {self.gear} (valid: {', '.join(map(str, CATALOGUE))})")
        return self

    @cached_property
    def springs(self) -> JointSprings:
        """The same in SI units."""
        gear = CATALOGUE[self.gear] if isinstance(self.gear, int) else self.gear
        tilting = self.tilting_ratio * gear.slopes_Nm_per_rad[1]
        lost_motion = self.lost_motion_arcmin * ARCMIN
        return JointSprings(gear, self.structure_Nm_per_rad, (tilting, tilting), lost_motion)


class SlideTable(TomlTable):
    """The elasticity of one prismatic joint.

    Attributes:
        drive_N_per_m: stiffness along the axis.
        guide_Nm_per_rad: tilting stiffness about the two cross axes.
    """

    drive_N_per_m: Annotated[float, _or_rigid(SOFTEST_DRIVE, STIFFEST_DRIVE)]
    guide_Nm_per_rad: Annotated[float, _or_rigid(SOFTEST, STIFFEST)]

    @cached_property
    def springs(self) -> SlideSprings:
        """The same in SI units."""
        return SlideSprings(self.drive_N_per_m, (self.guide_Nm_per_rad, self.guide_Nm_per_rad))


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
        structure, tilting, lost_motion: deviation of the constants of that name; `structure` and
            `tilting` also apply to a prismatic joint's drive and guide.
        beams: deviation of the modulus of each segment's tube.
    """

    gear: Share = 0.08
    structure: Share = 0.08
    tilting: Share = 0.15
    lost_motion: Share = 0.2
    beams: Share = 0.05


class Errors(TomlTable):
    """Errors of the robot description and the instruments; assumption.

    Every error has this size and a direction or sign drawn for the specimen.

    Attributes:
        place_m, turn_rad: error of every joint's frame.
        tcp_m: error of the TCP.
        mass: relative error of every link's mass.
        registration_rad: error of the tracker's frame relative to the robot's base.
        force_frame_rad: error of the force sensor's frame.
        force_gain: relative error of the force sensor's gain.
        tracker_m, tail: noise with heavy tails, see `Noise`.
    """

    place_m: Annotated[NotNegative, Le(0.01)] = 3e-4
    turn_rad: Annotated[NotNegative, Le(0.1)] = 5e-4
    tcp_m: Annotated[NotNegative, Le(0.01)] = 3e-4
    mass: Annotated[float, Ge(0), Lt(1)] = 0.1
    registration_rad: Annotated[NotNegative, Le(0.1)] = 5e-4
    force_frame_rad: Annotated[NotNegative, Le(0.2)] = float(np.deg2rad(1.0))
    force_gain: Annotated[float, Ge(0), Lt(1)] = 0.03
    tracker_m: Annotated[NotNegative, Le(1e-2)] = 1e-5
    tail: Tail = 3.0


class BeamsTable(TomlTable):
    """The links' elasticity; see `stiff_datasets.twin.beams.Beams`.

    Attributes:
        modulus_Pa, poisson: constants of the links' material.
        foundation_N_per_m, foundation_Nm_per_rad: stiffness of the base's foundation.
        bend: "always", or "effect": only with the effect "links" or rigid bearings.
        segment: one table per segment, base to TCP.
    """

    modulus_Pa: Modulus
    poisson: Annotated[float, Ge(0), Le(0.5)]
    foundation_N_per_m: Annotated[float, Ge(1e3)] = np.inf
    foundation_Nm_per_rad: Annotated[float, Ge(10.0)] = np.inf
    bend: Literal["always", "effect"] = "effect"
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
        noise, scatter, errors: see `Noise`, `Scatter`, `Errors`.
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
    errors: Errors = Errors()
    _path: Path = PrivateAttr(default=Path())

    @property
    def springs(self) -> tuple[JointSprings | SlideSprings, ...]:
        """The elasticity of every joint, base to tip, SI units."""
        return tuple(joint.springs for joint in self.joint)

    @property
    def gear_kinds(self) -> tuple[str, ...]:
        """Kind of every joint's gear: a size is a strain-wave gear, a table an RV gear."""
        return tuple(
            SLIDE
            if isinstance(joint, SlideTable)
            else STRAIN_WAVE
            if isinstance(joint.gear, int)
            else CYCLOIDAL
            for joint in self.joint
        )

    @property
    def rated_torques(self) -> FloatArray:
        """(n_joints,) rated torque of every gear, N m; 0 for a slide."""
        return np.array(
            [
                joint.gear.rated_Nm if isinstance(joint, JointSprings) else 0.0
                for joint in self.springs
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
        if not chain.robot.masses.any():
            raise DataError(
                f"{self._path}: no link of {self.urdf} has a mass; a twin needs them, because the "
                "weight preloads its gears (valid: <inertial> in every <link>)"
            )
        return chain

    def robot(self) -> Robot:
        """Read the rigid robot for the models; errors: see `chain`."""
        return self.chain().robot


def _counted(kinds: Sequence[str]) -> str:
    """Count the kinds of joints, base to tip, such as "1 prismatic, 6 revolute"."""
    return (
        ", ".join(f"{len([*equal_kinds])} {kind}" for kind, equal_kinds in groupby(kinds)) or "none"
    )


def specimen_springs(
    constants: TwinConstants, specimen: int
) -> tuple[JointSprings | SlideSprings, ...]:
    """Return the joint springs of one robot of a type.

    Number 0 has the nominal constants. The others differ by log-normal factors with the standard
    deviations of `Scatter`. Links, masses and the TCP are the same in all: their production
    tolerances change a deflection by a thousandth.
    """
    if specimen == 0:
        return constants.springs
    rng, scatter = stream("specimen", constants.name, specimen), constants.scatter
    specimen_joints: list[JointSprings | SlideSprings] = []
    tilting_twice = (scatter.tilting, scatter.tilting)
    deviations = (scatter.gear, scatter.structure, *tilting_twice, scatter.lost_motion)
    for joint in constants.springs:
        gear_factor, structure_factor, first_tilt_factor, second_tilt_factor, lost_motion_factor = (
            np.exp(rng.normal(size=5) * deviations)
        )
        tilts = (joint.tilting[0] * first_tilt_factor, joint.tilting[1] * second_tilt_factor)
        if isinstance(joint, SlideSprings):
            specimen_joints.append(SlideSprings(joint.drive * structure_factor, tilts))
            continue
        slopes = tuple(slope * gear_factor for slope in joint.gear.slopes_Nm_per_rad)
        gear_of_specimen = joint.gear.model_copy(update={"slopes_Nm_per_rad": slopes})
        lost_motion_rad = joint.lost_motion * lost_motion_factor
        specimen_joints.append(
            JointSprings(
                gear_of_specimen, joint.structure * structure_factor, tilts, lost_motion_rad
            )
        )
    return tuple(specimen_joints)


def specimen_law(constants: TwinConstants, specimen: int) -> GearLaw:
    """Return the law of all elastic coordinates of one robot, with arrays (..., 3 n_joints, 1).

    A strain-wave gear has three slopes. An RV gear has one, its last, and lost motion without
    memory. Tilts and slides are linear.
    """
    springs = specimen_springs(constants, specimen)
    rng = stream("lost motion", constants.name, specimen)
    widths = rng.uniform(*GEAR_LOST_MOTION_ARCMIN, size=len(springs)) * ARCMIN
    compliance, breakpoints = np.zeros((3, 3 * len(springs), 1)), np.ones((2, 3 * len(springs), 1))
    breakpoints[1] = 2.0
    lost_motion, torque = np.zeros((3 * len(springs), 1)), np.ones((3 * len(springs), 1))
    for number, (joint, kind) in enumerate(zip(springs, constants.gear_kinds, strict=True)):
        row = 3 * number
        compliance[:, row + 1 : row + 3, 0] = 1.0 / np.array(joint.tilting)
        if isinstance(joint, SlideSprings):
            compliance[:, row, 0] = 1.0 / joint.drive
            continue
        slopes = np.array(joint.gear.slopes_Nm_per_rad)
        if kind == CYCLOIDAL:
            slopes = slopes[[-1, -1, -1]]
            lost_motion[row], torque[row] = widths[number], LOST_MOTION_SHARE * joint.gear.rated_Nm
        compliance[:, row, 0] = 1.0 / slopes + 1.0 / joint.structure
        breakpoints[:, row, 0] = joint.gear.breakpoints_Nm
    none = np.zeros((0, 1, 1))
    return GearLaw(compliance, breakpoints, lost_motion, torque, none, none)


def specimen_beams(
    constants: TwinConstants, robot: Robot, specimen: int, *, must_bend: bool
) -> Beams | None:
    """Return the bending links of one robot of a type; None: rigid links.

    Args:
        constants: constants of the type.
        robot: geometry of the specimen.
        specimen: 0 has the nominal moduli, the others scatter as in `Scatter`.
        must_bend: true with the effect "links" or with rigid bearings.

    Raises:
        DataError: the links have to bend and have no sections.
    """
    table = constants.beams
    if must_bend and table is None:
        raise DataError(
            f"{constants._path}: no table [beams], which the effect 'links' and physics=rigid need "
            "(valid: sections as in stiff_datasets/twin/constants.py, or neither of the two)"
        )
    if table is None or (table.bend == "effect" and not must_bend):
        return None
    moduli = np.ones(len(table.segment))
    if specimen:
        rng = stream("beams", constants.name, specimen)
        moduli = np.exp(rng.normal(scale=constants.scatter.beams, size=moduli.shape))
    foundation = (table.foundation_N_per_m, table.foundation_Nm_per_rad)
    return Beams(robot, table.segment, moduli * table.modulus_Pa, table.poisson, foundation)


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
    tags = (REVOLUTE, PRISMATIC, "size", "table")  # tags of unions, not in files
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
