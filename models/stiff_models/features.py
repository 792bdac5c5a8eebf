"""What the networks see of a sample, and how numbers are standardised."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal, Self

import numpy as np

from stiff_protocols.types import FloatArray, Robot

AngleEncoding = Literal["sincos", "raw"]


def encode(
    robot: Robot, q: FloatArray, wrench: FloatArray, angle_encoding: AngleEncoding
) -> FloatArray:
    """Return the features of each sample.

    Args:
        robot: says which joints turn; a prismatic joint's position always stays as it is.
        q: (n, n_joints) joint positions, rad or m.
        wrench: (n, 6) N and N m.
        angle_encoding: "sincos" gives sin q, cos q and the wrench (18 features for six joints;
            an angle and the same angle a turn later are one pose), "raw" gives q and the wrench.
    """
    if angle_encoding == "raw":
        return np.hstack([q, wrench])
    turning = np.array([kind == "revolute" for kind in robot.joint_types])
    angles, slides = q[:, turning], q[:, ~turning]
    return np.hstack([np.sin(angles), np.cos(angles), slides, wrench])


@dataclass(frozen=True, eq=False)
class Scaler:
    """Column means and standard deviations.

    Attributes:
        mean: (n_columns,)
        scale: (n_columns,); 1 for a column that does not vary.
    """

    mean: FloatArray
    scale: FloatArray

    @classmethod
    def of(cls, values: FloatArray) -> Self:
        """Take the statistics of (n, n_columns) values."""
        scale = values.std(axis=0)
        constant = scale <= 1e-12 * np.maximum(np.abs(values).max(axis=0), 1e-300)
        return cls(values.mean(axis=0), np.where(constant, 1.0, scale))

    def apply(self, values: FloatArray) -> FloatArray:
        """Return standardised values."""
        return (values - self.mean) / self.scale

    def undo(self, values: FloatArray) -> FloatArray:
        """Return values in their own unit again."""
        return values * self.scale + self.mean
