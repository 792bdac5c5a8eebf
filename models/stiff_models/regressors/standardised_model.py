"""What the families share that learn from encoded, standardised samples with numpy arrays."""

from __future__ import annotations

from dataclasses import dataclass

from stiff_models.base import FittedModel
from stiff_models.networks.features import AngleEncoding, Scaler, encode
from stiff_protocols.contract.types import FloatArray, Robot, Samples

StandardisedRows = tuple[FloatArray, FloatArray]
"""Standardised features (n, n_features) and deflections (n, 3)."""


@dataclass(kw_only=True, eq=False, repr=False)
class StandardisedModel(FittedModel):
    """Base of the families that hand standardised rows to a learner.

    Features and deflections are standardised with the training rows' statistics: the defaults of
    most learners (a kernel's width, a tube of 0.1) mean nothing on deflections of 1e-4 m.

    Attributes:
        angle_encoding: "sincos" (sine and cosine of each angle) or "raw" (the angle).
    """

    angle_encoding: AngleEncoding = "sincos"

    def _standardised(self, robot: Robot, train: Samples) -> StandardisedRows:
        """Take the training rows' statistics and return the rows in them."""
        features = encode(robot, train.q, train.wrench, self.angle_encoding)
        self.input_scaler_ = Scaler.of(features)
        self.output_scaler_ = Scaler.of_deflection(train.deflection)
        return self.input_scaler_.apply(features), self.output_scaler_.apply(train.deflection)

    def _inputs(self, robot: Robot, q: FloatArray, wrench: FloatArray) -> FloatArray:
        return self.input_scaler_.apply(encode(robot, q, wrench, self.angle_encoding))

    def _rows(self, robot: Robot, samples: Samples) -> StandardisedRows:
        inputs = self._inputs(robot, samples.q, samples.wrench)
        return inputs, self.output_scaler_.apply(samples.deflection)
