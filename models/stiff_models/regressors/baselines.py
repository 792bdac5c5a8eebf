"""The reference rows `zero` and `mean`, which see neither the pose nor the load."""

from __future__ import annotations

import numpy as np

from stiff_models.base import FittedModel
from stiff_protocols.contract.types import FloatArray, Robot, Samples


class ZeroModel(FittedModel):
    """A rigid robot."""

    def _fit(self, train: Samples, robot: Robot, validation: Samples | None, seed: int) -> None:
        pass

    def _predict(self, q: FloatArray, wrench: FloatArray) -> FloatArray:
        return np.zeros((len(q), 3))


class MeanModel(FittedModel):
    """A constant: the mean deflection of the training samples, `mean_` (3,) m."""

    def _fit(self, train: Samples, robot: Robot, validation: Samples | None, seed: int) -> None:
        self.mean_ = train.deflection.mean(axis=0)

    def _predict(self, q: FloatArray, wrench: FloatArray) -> FloatArray:
        return np.tile(self.mean_, (len(q), 1))
