"""Models to fit, use and save."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Any, Self

import numpy as np

from stiff_bench.api.data import Dataset, choice_of, registry
from stiff_bench.plan.options import Choice
from stiff_bench.plan.request import check_model
from stiff_bench.tables.units import PRINTED
from stiff_protocols.contract.errors import ConfigError, NotFittedError
from stiff_protocols.contract.interfaces import ChecksRobot, ChoosesEpoch, ReportsDiagnostics
from stiff_protocols.contract.plugin import ModelInfo
from stiff_protocols.contract.types import BenchmarkData, FloatArray, Prediction
from stiff_protocols.scoring.metrics import METRICS
from stiff_protocols.splits.generators import inner_validation

if TYPE_CHECKING:
    from pandas import DataFrame

VALIDATION_FRACTION = 0.2
"""Of the poses, where a model chooses its epoch; as the protocols' default."""


class Model:
    """A stiffness model: the benchmarked one, with what `fit` learned.

    Attributes:
        choice: which model, with its options.
        fitted: the model itself, of stiffbench's contract or a plugin's class; None before `fit`.
        note: how the number of epochs was chosen; "" where there is nothing to choose.
    """

    def __init__(self, choice: Choice[ModelInfo]) -> None:
        """Store the argument."""
        self.choice = choice
        self.fitted: Any = None
        self.note = ""

    @property
    def name(self) -> str:
        """Key with the options that differ from their defaults."""
        return self.choice.name

    def fit(self, data: Dataset | BenchmarkData, *, seed: int = 0) -> Self:
        """Fit the model to all samples of a data set.

        A model that chooses its epoch gets a fifth of the poses to choose by and learns from the
        others, as in a benchmark; every other model learns from all.

        Args:
            data: samples and their robot.
            seed: of the model, and of the poses that choose the epoch.

        Raises:
            ConfigError: the model cannot be used here, or not for this robot.
            ModelError: the samples cannot be fitted.
        """
        if why := self.choice.missing():
            raise ConfigError(f"{self.name!r} cannot be used here: {why}")
        model = self.choice.make()
        if isinstance(model, ChecksRobot):
            model.check_robot(data.robot)
        chooses = self.choice.info.uses_validation
        if chooses and isinstance(model, ChoosesEpoch):
            chooses = model.chooses_epoch()
        train, validation, note = data.samples, None, ""
        if chooses:
            rows = np.arange(len(train))
            split = inner_validation(train, rows, VALIDATION_FRACTION, seed)
            if len(split.validation):
                train, validation = train.take(split.train), train.take(split.validation)
                note = (
                    f"{len(validation)} samples of {len(set(validation.pose_id))} poses chose the "
                    f"number of epochs; {len(train)} samples were learned from"
                )
            else:
                note = "one pose gives no rows to choose the epoch by: the last one was kept"
        model.fit(train, robot=data.robot, validation=validation, seed=seed)
        self.fitted, self.note = model, note
        return self

    def predict(self, q: FloatArray, wrench: FloatArray) -> FloatArray:
        """Return (n, 3) the deflections of the TCP, m, base frame.

        Args:
            q: (n, n_joints) joint positions, rad or m.
            wrench: (n, 6) force [N] and torque [N m] at the TCP, base frame.

        Raises:
            NotFittedError: `fit` was not called.
            ModelError: the shapes are not those of the robot.
        """
        if self.fitted is None:
            raise NotFittedError(f"{self.name}: call fit first")
        return np.asarray(self.fitted.predict(q, wrench))

    def score(self, data: Dataset | BenchmarkData) -> DataFrame:
        """Return the errors on a data set: a row a metric and axis, with its unit.

        Raises:
            NotFittedError: `fit` was not called.
        """
        from pandas import DataFrame

        samples = data.samples
        predicted = self.predict(samples.q, samples.wrench)
        prediction = Prediction(np.arange(len(samples)), predicted, samples.deflection)
        return DataFrame(
            [
                (metric.key, axis, value * PRINTED[metric.unit][1], PRINTED[metric.unit][0])
                for metric in METRICS.values()
                for axis, value in metric.values(prediction, None).items()
            ],
            columns=["metric", "axis", "value", "unit"],
        )

    @property
    def diagnostics(self) -> dict[str, float]:
        """Numbers that the fit reports, by name and unit, such as identified stiffnesses."""
        if not isinstance(self.fitted, ReportsDiagnostics):
            return {}
        return dict(self.fitted.diagnostics_)

    def save(self, file: Path | str) -> None:
        """Write the fitted model to a new file, which `load_model` and `bench predict` read.

        Raises:
            NotFittedError: `fit` was not called.
            ModelError: it is none of stiffbench's own models.
            StoreError: the file cannot be written.
        """
        from stiff_models.io.saved import save

        if self.fitted is None:
            raise NotFittedError(f"{self.name}: call fit first")
        save(self.fitted, Path(file))

    def __repr__(self) -> str:
        """Name it, and say whether it is fitted."""
        state = "not fitted" if self.fitted is None else "fitted"
        return f"Model {self.name} ({state})"


def model_choice(model: str | type | Model, options: dict[str, Any]) -> Choice[ModelInfo]:
    """Return what a name, a class or a model stands for."""
    if isinstance(model, Model):
        choice = model.choice
    elif isinstance(model, str):
        choice = choice_of("model", model, options)
    else:
        info = ModelInfo(key=model.__name__, target=model, summary="")
        choice = Choice(info, model, dict(options), {})
    check_model(choice)
    return choice


def make_model(model: str | type, **options: Any) -> Model:
    """Return a model that is not fitted.

    Args:
        model: its key, such as "ft-mlp" or "sklearn:ensemble.RandomForestRegressor", a word with
            options, "ft-mlp@freeze=full", or a class of yours that keeps the contract.
        options: of it; `bench show NAME` lists them.

    Raises:
        ConfigError: the name or an option is unknown, or a value is wrong.
    """
    return Model(model_choice(model, options))


def load_model(file: Path | str) -> Model:
    """Return the fitted model that `Model.save` or `bench fit` wrote.

    Raises:
        DataError: the file cannot be read, or is damaged.
    """
    from stiff_models import load
    from stiff_models.io.saved import key_of

    fitted = load(file)
    info = registry().model(key_of(fitted))
    made = Model(replace(Choice.of(info), params=fitted.get_params()))
    made.fitted = fitted
    return made
