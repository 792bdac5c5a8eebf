"""Joint angles and frames of a robot's controller, and of its description (URDF).

A controller may use other zeros or signs of joints than a URDF. FANUC's controllers count J3 from
the ground. World and flange frames may be turned or shifted. Programs use the controller's numbers,
models the description's.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from stiff_protocols.contract.arrays import FloatArray, freeze
from stiff_protocols.contract.display import BriefFields
from stiff_protocols.contract.errors import DataError


@dataclass(frozen=True, eq=False, repr=False)
class Controller(BriefFields):
    """The mapping between a controller's numbers and a robot description's.

    Attributes:
        signs: (n_joints,) 1 or -1: direction of each joint of the description in the controller's.
        zeros: (n_joints,) joint positions of the description where the controller's are zero, rad
            or m.
        world: (4, 4) pose of the controller's world frame in the description's base frame, m.
        flange: (4, 4) pose of the controller's flange frame in the description's last link, m.
        j3_from_ground: joint 3 is counted from the ground: the controller's joint 2 adds to it.
    """

    signs: FloatArray
    zeros: FloatArray
    world: FloatArray
    flange: FloatArray
    j3_from_ground: bool = False

    def __post_init__(self) -> None:
        freeze(self, signs=(None,), zeros=(len(self.signs),), world=(4, 4), flange=(4, 4))
        if (np.abs(self.signs) != 1.0).any():
            raise DataError(f"controller: signs are {self.signs.tolist()} (valid: 1 and -1)")
        if self.j3_from_ground and len(self.signs) < 3:
            raise DataError("controller: j3_from_ground requires at least three joints")
        for name in ("world", "flange"):
            turn = getattr(self, name)[:3, :3]
            if not np.allclose(turn @ turn.T, np.eye(3), atol=1e-6) or np.linalg.det(turn) < 0.0:
                raise DataError(f"controller: the pose of {name} is not a rotation")

    @classmethod
    def same_as_description(cls, n_joints: int) -> Controller:
        """Return the mapping of a controller with the description's numbers."""
        return cls(np.ones(n_joints), np.zeros(n_joints), np.eye(4), np.eye(4))

    def to_description(self, angles: FloatArray) -> FloatArray:
        """Return the description's joint positions of the controller's, (n, n_joints) rad or m."""
        angles = np.array(angles, dtype=np.float64)
        if self.j3_from_ground:
            angles[:, 2] += angles[:, 1]
        return np.asarray(self.signs * angles + self.zeros)

    def from_description(self, q: FloatArray) -> FloatArray:
        """Return the controller's joint positions of the description's, (n, n_joints) rad or m."""
        angles = self.signs * (np.asarray(q, dtype=np.float64) - self.zeros)
        if self.j3_from_ground:
            angles[:, 2] -= angles[:, 1]
        return np.asarray(angles)
