"""List the gears of simulated robots: catalogue figures, and tables of a twin's file."""

from __future__ import annotations

from typing import Annotated, Any, Literal

from annotated_types import Ge, Gt, Le
from pydantic import BaseModel, ConfigDict, Field, model_validator

from stiff_protocols.contract.errors import unknown_name

SOFTEST, STIFFEST = 10.0, 1e10  # N m/rad; a unit wrong by a factor of 1000 is outside
Stiffness = Annotated[float, Ge(SOFTEST), Le(STIFFEST), Field(allow_inf_nan=False)]
Positive = Annotated[float, Gt(0), Field(allow_inf_nan=False)]

GearKind = Literal["strain wave", "RV"]
STRAIN_WAVE: GearKind = "strain wave"
CYCLOIDAL: GearKind = "RV"


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


class StrainWaveGear(TomlTable):
    """A strain-wave gear: slope K1 up to T1, K2 up to T2, K3 above.

    Attributes:
        slopes_Nm_per_rad: K1, K2, K3 of a monotone load.
        breakpoints_Nm: T1, T2.
        rated_Nm: rated torque, which scales the plays.
    """

    slopes_Nm_per_rad: tuple[Stiffness, Stiffness, Stiffness]
    breakpoints_Nm: tuple[Positive, Positive]
    rated_Nm: Positive

    @model_validator(mode="after")
    def _ascending(self) -> StrainWaveGear:
        first, second = self.breakpoints_Nm
        if first >= second:
            raise ValueError(f"breakpoints_Nm {first:g}, {second:g}: the second must be larger")
        return self

    @property
    def kind(self) -> GearKind:
        """Kind of the gear."""
        return STRAIN_WAVE


class RvGear(TomlTable):
    """A cycloidal gear, which has one slope and lost motion.

    Attributes:
        rigidity_Nm_per_rad: slope of a monotone load.
        rated_Nm: rated torque, which scales plays and lost motion.
    """

    rigidity_Nm_per_rad: Stiffness
    rated_Nm: Positive

    @property
    def kind(self) -> GearKind:
        """Kind of the gear."""
        return CYCLOIDAL

    @property
    def slopes_Nm_per_rad(self) -> tuple[float, float, float]:
        """The one slope, three times."""
        return (self.rigidity_Nm_per_rad,) * 3

    @property
    def breakpoints_Nm(self) -> tuple[float, float]:
        """Torques between equal slopes, which do not matter."""
        return self.rated_Nm / 2.0, self.rated_Nm


Gear = StrainWaveGear | RvGear

# Sources: A measured, or read in the source; B read in a public repository that cites it; C
# recalled, not opened: an assumption.

STRAIN_WAVE_GEARS = {
    f"SHG-{size}": StrainWaveGear(
        slopes_Nm_per_rad=(k1 * 1e4, k2 * 1e4, k3 * 1e4), breakpoints_Nm=(t1, t2), rated_Nm=rated
    )
    for size, rated, (k1, k2, k3), (t1, t2) in (
        (14, 7.8, (0.47, 0.61, 0.71), (2.0, 6.9)),
        (17, 24.0, (1.0, 1.4, 1.6), (3.9, 12.0)),
        (20, 40.0, (1.6, 2.5, 2.9), (7.0, 25.0)),
        (25, 67.0, (3.1, 5.0, 5.7), (14.0, 48.0)),
        (32, 178.0, (6.7, 11.0, 12.0), (29.0, 108.0)),
        (40, 345.0, (13.0, 20.0, 23.0), (54.0, 196.0)),
        (45, 459.0, (18.0, 29.0, 33.0), (76.0, 275.0)),
        (50, 611.0, (25.0, 40.0, 44.0), (108.0, 382.0)),
        (58, 905.0, (40.0, 61.0, 71.0), (168.0, 598.0)),
        (65, 1236.0, (54.0, 88.0, 98.0), (235.0, 843.0)),
    )
}
"""Strain-wave gears CSG and SHG by size. 14 to 25, ratio 80 and more: K1 and K3 are of Schaeffler
TPI 275, same sizes (B); rated torques, K2, T1, T2: C (tables for ratio 100 say 10, 31, 52, 87 N m,
B). 32 to 65, ratio 100: rated torques B, the rest C."""

RV_GEARS = {
    name: RvGear(rigidity_Nm_per_rad=rigidity, rated_Nm=rated)
    for name, rated, rigidity in (
        ("RV-6E", 58.0, 6.88e4),
        ("RV-20E", 167.0, 1.68e5),
        ("RV-40E", 412.0, 3.71e5),
        ("RV-80E", 784.0, 6.74e5),
        ("RV-110E", 1078.0, 1.01e6),
        ("RV-160E", 1568.0, 1.35e6),
        ("RV-320E", 3136.0, 3.37e6),
        ("RV-500N", 4900.0, 5.57e6),
        ("RV-700N", 7000.0, 8.94e6),
    )
}
"""Cycloidal gears by size: rated torque B, rigidity (20, 49, 108, 196, 294, 392 and 980 N m/arcmin)
C."""

CATALOGUE: dict[str, Gear] = {**STRAIN_WAVE_GEARS, **RV_GEARS}
