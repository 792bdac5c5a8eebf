"""Encode and standardise features and deflections for learners."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal, Self

import numpy as np

from stiff_models.fitted_model import FittedModel
from stiff_protocols.contract.types import BoolArray, FloatArray, Robot, Samples

AngleEncoding = Literal["sincos", "raw"]

ROUNDED_ZERO = 1e-3
NO_DEFLECTION = 1e-9
"""Unit [m] of deflections that are all zero: far below what any instrument resolves."""


def encode(
    robot: Robot, q: FloatArray, wrench: FloatArray, angle_encoding: AngleEncoding
) -> FloatArray:
    """Return the features of (n, n_joints) positions, rad or m, and (n, 6) wrenches, N and N m.

    "sincos" gives sin q, cos q and the wrench: 18 features for six joints. Angles that differ by a
    full turn are then equal. "raw" gives q and the wrench, and the sine and cosine of endless
    joints. Positions of prismatic joints are not changed.
    """
    turned = encoded_joints(robot, angle_encoding)
    if not turned.any():
        return np.hstack([q, wrench])
    angles, plain_positions = q[:, turned], q[:, ~turned]
    return np.hstack([np.sin(angles), np.cos(angles), plain_positions, wrench])


def encoded_joints(robot: Robot, angle_encoding: AngleEncoding) -> BoolArray:
    """Return (n_joints,) true for joints whose features are the sine and cosine of the angle."""
    return robot.endless if angle_encoding == "raw" else robot.turns


@dataclass(frozen=True, eq=False)
class Scaler:
    """Column means and standard deviations, each (n_columns,)."""

    mean: FloatArray
    scale: FloatArray

    @classmethod
    def of(cls, values: FloatArray, *, of_constant: float = 1.0) -> Self:
        """Compute statistics of (n, n_columns) values; constant columns get `of_constant`."""
        scale = values.std(axis=0)
        # sines of half turns differ by 1e-16: a rounded zero is not a scale either
        constant = scale <= 1e-12 * np.maximum(np.abs(values).max(axis=0), ROUNDED_ZERO)
        return cls(values.mean(axis=0), np.where(constant, of_constant, scale))

    @classmethod
    def of_deflection(cls, deflection: FloatArray) -> Self:
        """Compute the statistics of (n, 3) deflections, m.

        A component that does not vary (one sample, one gauge) is scaled by the size of all
        components. In units of 1 m, a learner's residual would be decimetres.
        """
        size = float(np.sqrt(np.mean(deflection**2)))
        return cls.of(deflection, of_constant=size or NO_DEFLECTION)

    def apply(self, values: FloatArray) -> FloatArray:
        """Return standardised values."""
        return (values - self.mean) / self.scale

    def undo(self, values: FloatArray) -> FloatArray:
        """Return standardised values in their original unit."""
        return values * self.scale + self.mean


StandardisedRows = tuple[FloatArray, FloatArray]
"""Standardised features (n, n_features) and deflections (n, 3)."""


@dataclass(kw_only=True, eq=False, repr=False)
class EncodedModel(FittedModel):
    """Base of the families that learn from encoded samples.

    Features and deflections are standardised with the training rows' statistics. The defaults of
    most learners (a kernel's width, a tube of 0.1) do not suit deflections of 1e-4 m.

    Attributes:
        angle_encoding: "sincos" (sine and cosine of each angle) or "raw" (the angle, if the joint
            has limits).
    """

    angle_encoding: AngleEncoding = "sincos"

    def _take_statistics(
        self, robot: Robot, q: FloatArray, wrench: FloatArray, deflection: FloatArray
    ) -> None:
        self.input_scaler_ = Scaler.of(encode(robot, q, wrench, self.angle_encoding))
        self.output_scaler_ = Scaler.of_deflection(deflection)

    def _standardised(self, robot: Robot, samples: Samples) -> StandardisedRows:
        """Return the rows, standardised with the stored statistics."""
        features = self._features(robot, samples.q, samples.wrench)
        return features, self.output_scaler_.apply(samples.deflection)

    def _trained_rows(self, robot: Robot, train: Samples) -> StandardisedRows:
        """Store the training rows' statistics and return the standardised rows."""
        self._take_statistics(robot, train.q, train.wrench, train.deflection)
        return self._standardised(robot, train)

    def _features(self, robot: Robot, q: FloatArray, wrench: FloatArray) -> FloatArray:
        """Return the (n, n_features) standardised features."""
        return self.input_scaler_.apply(encode(robot, q, wrench, self.angle_encoding))
