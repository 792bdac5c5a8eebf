"""Base classes of the built-in families: checked `predict`, `save`, normal intervals."""

from __future__ import annotations

from abc import abstractmethod
from pathlib import Path
from typing import TYPE_CHECKING, Self

import numpy as np

from stiff_models.io import model_file
from stiff_protocols.contract.errors import ModelError, NotFittedError, warn
from stiff_protocols.contract.stiffness_model import StiffnessModel, check_readings
from stiff_protocols.contract.training_range import TrainingRange
from stiff_protocols.contract.types import FloatArray, Interval, Robot, Samples
from stiff_protocols.springs.unseen_joints import unseen_joints_texts

if TYPE_CHECKING:
    import torch


class FittedModel(StiffnessModel):
    """Base of the built-in families: checks inputs and predictions, and writes model files.

    A family implements `_fit` and `_predict`. It keeps everything that a prediction needs in
    attributes that end in an underscore; a model file holds these attributes.

    Attributes:
        robot_: robot of the fit; predictions are valid only for that robot.
        training_range_: joint positions and loads of the training samples.
    """

    robot_: Robot
    training_range_: TrainingRange

    def fit(
        self, train: Samples, *, robot: Robot, validation: Samples | None = None, seed: int = 0
    ) -> Self:
        """Fit the model as `StiffnessModel.fit`; without validation rows keep the last epoch.

        Raises:
            ConfigError: the options contradict each other, the samples or the robot, or the model
                takes no readings along directions, or at other points than the TCP.
            ModelError: these samples identify nothing, or the training diverged.
        """
        check_readings(self, train)
        self._fit(train, robot, validation, seed)
        if self.takes_directions:
            seen = train.directions, train.levers
            for text in unseen_joints_texts(robot, train.q, train.wrench, *seen):
                warn(f"{text}; until then its stiffness is guessed from the other joints' sizes")
        self.robot_, self.training_range_ = robot, TrainingRange.of(train, robot)
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
            ModelError: the shapes do not match the fitted robot, or a number is not finite.
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
        """Write the fitted model to one file for `stiff_models.load`; see `io.model_file`.

        Raises:
            NotFittedError: `fit` was not called.
            ModelError: the model is not part of stiffbench, or holds objects that cannot be saved.
            StoreError: the file cannot be written.
        """
        model_file.save(self, path)

    def _empty_module(self, name: str) -> torch.nn.Module:
        """Return an untrained module of the shape of the fitted attribute `name`, for loading.

        It is called after every other attribute was restored.
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
    """Base of the families that predict standard deviations; list it before other bases."""

    def predict_interval(self, q: FloatArray, wrench: FloatArray, coverage: float) -> Interval:
        """Return the central interval of each axis' predictive normal, noise included.

        Arguments and errors are the same as for `predict`; `coverage` (0..1) is per axis. Beyond
        the training range the interval is wider; see `TrainingRange.widened`.
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
