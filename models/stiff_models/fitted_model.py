"""What every built-in family shares: a checked `predict`, `save`, intervals of a normal error."""

from __future__ import annotations

from abc import abstractmethod
from collections.abc import Iterator
from pathlib import Path
from typing import TYPE_CHECKING, Self

import numpy as np
from sklearn.base import BaseEstimator

from stiff_models.io import model_file
from stiff_protocols.contract.errors import ModelError, NotFittedError
from stiff_protocols.contract.stiffness_model import StiffnessModel
from stiff_protocols.contract.training_range import TrainingRange
from stiff_protocols.contract.types import FloatArray, IntArray, Interval, Robot, Samples

if TYPE_CHECKING:
    import torch


FOLDS = 5
"""In which poses are left out, to see how wrong a model is at poses that it did not learn from."""


def folds_of_poses(samples: Samples, seed: int) -> Iterator[tuple[IntArray, IntArray]]:
    """Yield the rows that are learned from and those that are left out, for a fifth of the poses.

    Of fewer than `FOLDS` poses, at least two, each one is left out.
    """
    from sklearn.model_selection import GroupKFold  # not every model needs it

    n_folds = min(FOLDS, len(np.unique(samples.pose_id)))
    folds = GroupKFold(n_folds, shuffle=True, random_state=seed)
    yield from folds.split(samples.q, groups=samples.pose_id)


def left_out_fifths(samples: Samples, seed: int) -> Iterator[tuple[Samples, Samples]]:
    """Yield the samples of `folds_of_poses`."""
    for learned, left_out in folds_of_poses(samples, seed):
        yield samples.take(learned), samples.take(left_out)


class FittedModel(BaseEstimator, StiffnessModel):  # type: ignore[misc]
    """Base of the built-in families: a prediction that is checked at both ends, and files.

    A family writes `_fit` and `_predict`, and keeps everything that a prediction needs in
    attributes that end in an underscore: those are what a model file holds.

    Attributes:
        robot_: the robot it was fitted for; predictions are valid for that robot alone.
        training_range_: joint positions and loads that it learned from.
    """

    robot_: Robot
    training_range_: TrainingRange

    def fit(
        self, train: Samples, *, robot: Robot, validation: Samples | None = None, seed: int = 0
    ) -> Self:
        """Learn as `StiffnessModel.fit` says; without validation rows the last epoch is kept.

        Raises:
            ConfigError: the options do not fit each other, the samples or the robot.
            ModelError: these samples identify nothing, or the training diverged.
        """
        self._fit(train, robot, validation, seed)
        self.robot_, self.training_range_ = robot, TrainingRange.of(train)
        return self

    @abstractmethod
    def _fit(self, train: Samples, robot: Robot, validation: Samples | None, seed: int) -> None:
        """Set the fitted attributes."""

    def predict(self, q: FloatArray, wrench: FloatArray) -> FloatArray:
        """Return the (n, 3) deflection of the TCP, m, base frame.

        Args:
            q: (n, n_joints) joint positions, rad or m.
            wrench: (n, 6) N and N m at the TCP, base frame.

        Raises:
            NotFittedError: `fit` was not called.
            ModelError: the shapes are not those of the robot fitted for, or a number is not finite.
        """
        q, wrench = self._checked(q, wrench)
        if not len(q):
            return np.empty((0, 3))
        predicted = self._predict(q, wrench)
        if not np.isfinite(predicted).all():
            row = _first_not_finite(predicted)
            raise ModelError(
                f"row {row}: q = {q[row].tolist()}, wrench = {wrench[row].tolist()}: "
                f"the prediction is {predicted[row].tolist()}, expected finite numbers"
            )
        return predicted

    def save(self, path: Path) -> None:
        """Write the fitted model to one file that `stiff_models.load` reads; see `io.model_file`.

        Raises:
            NotFittedError: `fit` was not called.
            ModelError: the model is none of stiffbench's own, or holds what no file can.
            StoreError: the file cannot be written.
        """
        model_file.save(self, path)

    def _empty_module(self, name: str) -> torch.nn.Module:
        """Return an untrained module of the shape of the fitted attribute `name`, for loading.

        Called when every other attribute is restored.
        """
        raise NotImplementedError(f"{type(self).__name__} holds no module {name!r}")

    @abstractmethod
    def _predict(self, q: FloatArray, wrench: FloatArray) -> FloatArray:
        """Return the (n, 3) deflection of checked float64 input."""

    def _checked(self, q: FloatArray, wrench: FloatArray) -> tuple[FloatArray, FloatArray]:
        if not hasattr(self, "robot_"):
            raise NotFittedError(f"{type(self).__name__}: call fit before predict")
        q, wrench = np.asarray(q, dtype=np.float64), np.asarray(wrench, dtype=np.float64)
        for name, array, columns in (("q", q, self.robot_.n_joints), ("wrench", wrench, 6)):
            if array.ndim != 2 or array.shape[1] != columns or len(array) != len(q):
                raise ModelError(f"{name} has shape {array.shape}, expected (n, {columns})")
            if not np.isfinite(array).all():
                row = _first_not_finite(array)
                raise ModelError(f"{name}[{row}] is {array[row].tolist()}, expected finite numbers")
        return q, wrench


class NormalModel(FittedModel):
    """Base of the families with standard deviations of their own, before their other bases."""

    def predict_interval(self, q: FloatArray, wrench: FloatArray, coverage: float) -> Interval:
        """Return the central interval of each axis' predictive normal, its noise included.

        Arguments and errors as of `predict`; `coverage` (0..1) is of each axis by itself. Beyond
        the training range it is wider, as `TrainingRange.widened` says.
        """
        from scipy.special import ndtri  # not every model needs it

        def within(q: FloatArray, wrench: FloatArray) -> Interval:
            mean, deviation = self._mean_and_deviation(q, wrench)
            half = ndtri(0.5 + coverage / 2.0) * deviation
            return Interval(mean - half, mean + half, coverage)

        return self.training_range_.widened(within, *self._checked(q, wrench))

    @abstractmethod
    def _mean_and_deviation(
        self, q: FloatArray, wrench: FloatArray
    ) -> tuple[FloatArray, FloatArray]:
        """Return (n, 3) m twice: the prediction, and its standard deviation with the noise."""


def _first_not_finite(rows: FloatArray) -> int:
    return int(np.isfinite(rows).all(axis=1).argmin())
