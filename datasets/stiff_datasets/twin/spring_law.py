"""Model a joint's elasticity: strain-wave gear, structure in series, bearing, lost motion."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Annotated, Any

import numpy as np
from annotated_types import Ge, Gt, Le
from pydantic import BaseModel, ConfigDict, Field, model_validator

from stiff_protocols.contract.errors import unknown_name
from stiff_protocols.contract.types import FloatArray

LOST_MOTION_SHARE = 0.04
"""Share of the rated torque at which catalogues measure lost motion."""

SOFTEST, STIFFEST = 10.0, 1e10  # N m/rad; a unit wrong by a factor of 1000 is outside
Stiffness = Annotated[float, Ge(SOFTEST), Le(STIFFEST), Field(allow_inf_nan=False)]
Positive = Annotated[float, Gt(0), Field(allow_inf_nan=False)]


class TomlTable(BaseModel):
    """A table of a twin's file: unknown keys are errors, values do not change."""

    model_config = ConfigDict(frozen=True)

    @model_validator(mode="before")
    @classmethod
    def _known_keys(cls, table: Any) -> Any:
        for key in table if isinstance(table, dict) else ():
            if key not in cls.model_fields:
                raise ValueError(str(unknown_name("key", key, cls.model_fields)))
        return table


class Gear(TomlTable):
    """Catalogue torsion of a strain-wave gear: slope K1 up to T1, K2 up to T2, K3 above.

    Attributes:
        slopes_Nm_per_rad: K1, K2, K3.
        breakpoints_Nm: T1, T2.
        rated_Nm: lost motion is measured at +-4 % of this torque.
    """

    slopes_Nm_per_rad: tuple[Stiffness, Stiffness, Stiffness]
    breakpoints_Nm: tuple[Positive, Positive]
    rated_Nm: Positive

    @model_validator(mode="after")
    def _ascending(self) -> Gear:
        first, second = self.breakpoints_Nm
        if first >= second:
            raise ValueError(f"breakpoints_Nm {first:g}, {second:g}: the second must be larger")
        return self


@dataclass(frozen=True)
class JointSprings:
    """The elasticity of one joint.

    Attributes:
        gear: its strain-wave gear.
        structure: stiffness of casing and link in series with the gear, N m/rad.
        tilting: stiffness about the two cross axes, N m/rad.
        lost_motion: full width of the backlash-like dead angle, rad.
    """

    gear: Gear
    structure: float
    tilting: tuple[float, float]
    lost_motion: float


@dataclass(frozen=True)
class SlideSprings:
    """The elasticity of one prismatic joint, such as a linear track; it is linear.

    Attributes:
        drive: stiffness along the axis, N/m.
        tilting: stiffness of the guide about the two cross axes, N m/rad; about the joint's axis
            it is rigid.
    """

    drive: float
    tilting: tuple[float, float]


class SpringLaw:
    """Spring law theta = phi(tau) of all elastic coordinates; arrays are (3 n_joints, n).

    The torsion of a joint is piecewise linear in the torque (gear and structure in series) plus
    the lost motion, which saturates: half its width times tanh(tau / 4 % of the rated torque).
    A tilt is linear, and so is the drive of a prismatic joint, whose theta is in m and tau in N.

    Lost motion is either a curve or a hysteresis. With hysteresis the joint is at a turning point
    before the load. From there the same curve applies at twice its size (Masing's rule), so that
    every load takes up the full width of the lost motion again.

    Args:
        springs: one entry per joint, base to tip.
    """

    def __init__(self, springs: Sequence[JointSprings | SlideSprings]) -> None:
        """Arrange the constants in columns (3 n_joints, 1)."""
        rows = [row for joint in springs for row in _rows(joint)]
        columns = np.array(rows).T[:, :, None]
        self._compliance = columns[:3]  # rad/(N m) of the three segments
        self._breakpoints = columns[3:5]  # N m
        self._half_lost_motion, self._lost_motion_torque = columns[5:]  # rad, N m

    def angle(self, torque: FloatArray, turning: FloatArray | None = None) -> FloatArray:
        """Return theta [rad].

        Args:
            torque: N m.
            turning: torque at the turning point of the hysteresis, N m; None: lost motion is a
                curve without memory.
        """
        size = np.abs(torque)
        first, second = self._breakpoints
        spring_angle = (
            self._compliance[0] * np.minimum(size, first)
            + self._compliance[1] * np.clip(size - first, 0.0, second - first)
            + self._compliance[2] * np.maximum(size - second, 0.0)
        )
        start_torque, scale = (0.0, 1.0) if turning is None else (turning, 2.0)
        lost_motion_share = np.tanh((torque - start_torque) / (scale * self._lost_motion_torque))
        return np.asarray(
            np.copysign(spring_angle, torque) + scale * self._half_lost_motion * lost_motion_share
        )


def _rows(joint: JointSprings | SlideSprings) -> list[tuple[float, ...]]:
    """Return the constants of a joint's torsion, or drive, and of its two tilts."""
    if isinstance(joint, SlideSprings):
        return [_linear(stiffness) for stiffness in (joint.drive, *joint.tilting)]
    torsion = [1.0 / slope + 1.0 / joint.structure for slope in joint.gear.slopes_Nm_per_rad]
    lost_motion = (joint.lost_motion / 2.0, LOST_MOTION_SHARE * joint.gear.rated_Nm)
    tilts = [_linear(stiffness) for stiffness in joint.tilting]
    return [(*torsion, *joint.gear.breakpoints_Nm, *lost_motion), *tilts]


def _linear(stiffness: float) -> tuple[float, ...]:
    """Return the constants of a linear spring: one compliance, arbitrary breakpoints."""
    return (*(1.0 / stiffness,) * 3, 1.0, 2.0, 0.0, 1.0)
