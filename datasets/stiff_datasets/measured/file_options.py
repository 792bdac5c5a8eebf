"""Define the options of a file of samples: torques, sheet, tolerance of poses, frame."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

from stiff_protocols.contract.errors import ConfigError

POSE_TOLERANCE = 0.05
"""deg and mm; robots repeat poses more precisely, and no plan has poses this near each other."""
LARGEST_POSE_TOLERANCE = 10.0


@dataclass(frozen=True)
class FileOptions:
    """Options that a user gives for a file of samples.

    Attributes:
        no_torque: torques were not measured: their columns may be missing, or zero.
        sheet: sheet of an Excel file; by default the only one with a table.
        pose_tolerance: rows without `pose_id` are one pose if their joint positions differ by at
            most this, in deg (prismatic joints: mm).
        register: positions are in a tracker's frame: turn the deflections to the base frame, by the
            unloaded positions and the joint angles.
        hook: (3,) where weights hang and ropes pull (`mass_kg`, `pull_N`), in the frame of the last
            link, in m; by default the TCP.
    """

    no_torque: bool = False
    sheet: str | None = None
    pose_tolerance: float = POSE_TOLERANCE
    register: bool = False
    hook: Sequence[float] | None = None

    def __post_init__(self) -> None:
        if not 0.0 <= self.pose_tolerance <= LARGEST_POSE_TOLERANCE:
            valid = f"valid: from 0 to {LARGEST_POSE_TOLERANCE:g}, in deg and mm"
            raise ConfigError(f"{self.pose_tolerance:g} ({valid})", "pose-tolerance")

    @property
    def words(self) -> list[str]:
        """Words of a command line that give these options."""
        words = ["--no-torque"] * self.no_torque
        words += [] if self.sheet is None else ["--sheet", self.sheet]
        if self.pose_tolerance != POSE_TOLERANCE:
            words += ["--pose-tolerance", str(self.pose_tolerance)]
        words += ["--register"] * self.register
        words += [] if self.hook is None else ["--hook", ",".join(f"{x:g}" for x in self.hook)]
        return words


DEFAULTS = FileOptions()
