"""A model that meets the contract, and one for each way to break it."""

from __future__ import annotations

import json
import random
import sys
from typing import Annotated, ClassVar

import numpy as np
from annotated_types import Ge
from sklearn.base import BaseEstimator
from sklearn.utils.validation import check_is_fitted

from stiff_protocols.contract.types import Interval, Samples


class Springs(BaseEstimator):
    """One Cartesian compliance, learned by least squares; meets the whole contract."""

    def __init__(self, *, scale: Annotated[float, Ge(0.0)] = 1.0):
        self.scale = scale

    def fit(self, train, *, robot, validation=None, seed=0):
        self.n_joints_ = robot.n_joints
        self.compliance_ = self.scale * np.linalg.lstsq(train.wrench, train.deflection)[0]
        self.diagnostics_ = {"largest compliance [m/N]": float(self.compliance_.max())}
        self.learned(train, validation, seed)
        return self

    def learned(self, train, validation, seed):
        """Do nothing; a broken model overrides it."""

    def predict(self, q, wrench):
        check_is_fitted(self, "compliance_")
        if q.shape[1] != self.n_joints_:
            raise ValueError("another robot")
        return wrench @ self.compliance_

    def predict_interval(self, q, wrench, coverage):
        middle, half = self.predict(q, wrench), coverage * self.half_width(wrench)
        return Interval(middle - half, middle + half, coverage)

    def half_width(self, wrench):
        return 1e-3

    def save(self, path):
        path.write_text(json.dumps([self.n_joints_, self.compliance_.tolist()]))


def reader(cls):
    def load(path):
        model = cls()
        n_joints, compliance = json.loads(path.read_text())
        model.n_joints_, model.compliance_ = n_joints, np.array(compliance)
        return model

    return load


def broken(name, **methods):
    """Return a model class with other methods."""
    return type(name, (Springs,), methods)


def predicting(name, change):
    """Return a model class that applies `change` to the right (n, 3) predictions."""
    return broken(name, predict=lambda self, q, wrench: change(Springs.predict(self, q, wrench)))


def finding(name, attributes):
    """Return a model class whose fit sets these attributes of itself, too."""
    return broken(name, learned=lambda self, *rows: vars(self).update(attributes(self, *rows)))


class ByPosition(Springs):
    def __init__(self, scale=1.0):
        super().__init__(scale=scale)


class Converts(Springs):
    def __init__(self, *, scale: float = 1.0):
        super().__init__(scale=float(scale))


class ForeignAnnotation(Springs):
    def __init__(self, *, scale: NotThere = 1.0):  # noqa: F821
        super().__init__(scale=scale)


class PredictsEarly(Springs):
    def predict(self, q, wrench):
        if not hasattr(self, "compliance_"):
            return np.zeros((len(q), 3))
        return super().predict(q, wrench)


class CannotFit(Springs):
    def learned(self, train, validation, seed):
        raise RuntimeError("no licence")


class WritesIntoWrench(Springs):
    def predict(self, q, wrench):
        predicted = super().predict(q, wrench)
        wrench *= 2.0
        return predicted


class Peeks(Springs):
    def learned(self, train, validation, seed):
        if validation is not None:
            self.compliance_ += 1e-9 * validation.deflection.mean()


class LearnsFromValidation(Springs):
    def learned(self, train, validation, seed):
        if validation is not None:
            wrench = np.vstack([train.wrench, validation.wrench])
            deflection = np.vstack([train.deflection, validation.deflection])
            self.compliance_ = self.scale * np.linalg.lstsq(wrench, deflection)[0]


class NoiseOfValidation(Springs):
    def learned(self, train, validation, seed):
        rows = train if validation is None else validation
        self.noise_ = np.std(rows.deflection - self.predict(rows.q, rows.wrench))

    def half_width(self, wrench):
        return self.noise_


class ForgetsRows(Springs):
    """Returns the result of an earlier fit with the same seed."""

    fitted_compliances: ClassVar = {}

    def learned(self, train, validation, seed):
        self.compliance_ = self.fitted_compliances.setdefault(seed, self.compliance_)


class Remembers(Springs):
    def learned(self, train, validation, seed):
        self.compliance_ += 0.1 * getattr(self, "before_", 0.0)
        self.before_ = self.compliance_


class AnyRobot(Springs):
    def predict(self, q, wrench):
        check_is_fitted(self)
        return wrench @ self.compliance_


class Narrows(Springs):
    def predict_interval(self, q, wrench, coverage):
        interval = super().predict_interval(q, wrench, 1.0 - coverage)
        return Interval(interval.lower, interval.upper, coverage)


class LosesDigits(Springs):
    def save(self, path):
        path.write_text(json.dumps([self.n_joints_, self.compliance_.round(9).tolist()]))


class SeedsEverybody(Springs):
    def learned(self, train, validation, seed):
        np.random.seed(0)  # noqa: NPY002
        random.random()


LosesOption = broken("LosesOption", get_params=lambda self, deep=True: {})
WritesIntoTrain = broken("WritesIntoTrain", learned=lambda self, train, *_: train.q.fill(0.0))
NeedsValidation = broken("NeedsValidation", learned=lambda self, train, rows, seed: len(rows))
ReturnsNothing = broken(
    "ReturnsNothing",
    fit=lambda self, train, **options: Springs.fit(self, train, **options) and None,
)
Talks = broken("Talks", learned=lambda *_: print("epoch 1"))
LooksAtTheBatch = broken(
    "LooksAtTheBatch",
    predict=lambda self, q, wrench: Springs.predict(self, q, wrench - wrench.mean(axis=0)),
)
WidensWithTheBatch = broken(
    "WidensWithTheBatch", half_width=lambda self, wrench: np.abs(wrench).mean() * 1e-6
)

WrongShape = predicting("WrongShape", lambda predicted: predicted[:, :2])
Millimetres = predicting("Millimetres", lambda predicted: 1e3 * predicted)
Noisy = predicting(
    "Noisy",
    lambda values: values + np.random.default_rng().normal(scale=1e-9, size=values.shape),
)

IgnoresSeed = finding(
    "IgnoresSeed",
    lambda model, *_: {"compliance_": model.compliance_ * np.random.default_rng().uniform(0.9)},
)
ChangesOption = finding("ChangesOption", lambda model, *_: {"scale": np.float64(model.scale)})
NoNumber = finding("NoNumber", lambda *_: {"diagnostics_": {"rank": "full"}})


class TakesLabels(Springs):
    """Searches the stack for samples of the requested poses."""

    def predict(self, q, wrench):
        predicted, frame = super().predict(q, wrench), sys._getframe()
        while frame is not None:
            for value in [*frame.f_locals.values()]:
                test = getattr(value, "test", None)
                if isinstance(test, Samples):
                    row_of = {tuple(row): k for k, row in enumerate(test.wrench.tolist())}
                    rows = [row_of.get(tuple(row)) for row in wrench.tolist()]
                    return predicted if None in rows else test.deflection[rows].copy()
            frame = frame.f_back
        return predicted


class WithoutSeed(Springs):
    def fit(self, train, *, robot, validation=None):
        return super().fit(train, robot=robot)


class WithoutOptions:
    fit, predict = Springs.fit, Springs.predict


class NeedsOption(Springs):
    def __init__(self, *, scale: float):
        super().__init__(scale=scale)


BROKEN = [
    (ByPosition, "the constructor takes keywords", "scale can be passed without a name"),
    (Converts, "the constructor takes keywords", "raised TypeError"),
    (WithoutSeed, "the constructor takes keywords", r"has fit\(.*'seed'"),
    (WithoutOptions, "the constructor takes keywords", "no get_params and no set_params"),
    (NeedsOption, "the constructor takes keywords", "scale"),
    (LosesOption, "clone gives", r"get_params names \[\], the constructor \['scale'\]"),
    (ForeignAnnotation, "options can be listed", "raised NameError: name 'NotThere'"),
    (PredictsEarly, "predict before fit", "returned numbers"),
    (CannotFit, "fit learns", r"raised RuntimeError: no licence \(broken_models.py:\d+\)"),
    (WritesIntoTrain, "fit learns", "fit writes into the samples"),
    (ReturnsNothing, "fit learns", "fit returned NoneType"),
    (ChangesOption, "fit learns", r"fit changes scale from 1\.0 to np\.float64"),
    (WrongShape, "predict returns", r"shape \(10, 2\)"),
    (TakesLabels, "predictions come from", "the deflections of the test rows"),
    (Millimetres, "predict returns", "are these mm"),
    (LooksAtTheBatch, "a prediction", "a row predicted one by one differs by up to"),
    (Noisy, "predicting twice", "the second prediction differs by up to"),
    (WritesIntoWrench, "fit and predict touch", "predict writes into wrench"),
    (IgnoresSeed, "the same seed", "a second model differs by up to"),
    (Peeks, "validation rows are not", "fitted with validation rows, it differs"),
    (ForgetsRows, "a fit learns from its own rows", "gives the numbers of the first"),
    (Remembers, "a second fit forgets", "fitted to other rows before differs"),
    (AnyRobot, "joint angles of another robot", "numbers for 5 joints after a fit to 6"),
    (NoNumber, "diagnostics", "raised ValueError: could not convert string"),
    (Narrows, "intervals", "narrower than the interval of 0.5"),
    (WidensWithTheBatch, "an interval", "an interval predicted one by one differs by up to"),
    (LosesDigits, "save and load", "read from its file differs by up to"),
    (Talks, "fit and predict touch", "printed 'epoch 1'"),
    (SeedsEverybody, "fit and predict touch", "of numpy.random, random"),
]

BROKEN_CHOOSERS = [
    (NeedsValidation, "a fit works without", "NoneType"),
    (LearnsFromValidation, "validation rows are not", r"predicts its training rows \d+ times too"),
    (NoiseOfValidation, "validation rows are not", r"its intervals are \d+ times as wide"),
]
"""Broken models with uses_validation=True."""
