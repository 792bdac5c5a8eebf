"""Models with a scikit-learn-style regressor on encoded samples, and their base class.

They include the reference models `zero`, `mean` and `knn`.
"""

from __future__ import annotations

import warnings
from abc import abstractmethod
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from typing import Annotated, Any, Literal

import numpy as np
from annotated_types import Ge, Gt
from sklearn.ensemble import HistGradientBoostingRegressor
from sklearn.multioutput import MultiOutputRegressor
from sklearn.neighbors import KNeighborsRegressor
from sklearn.utils import get_tags

from stiff_models.fitted_model import FittedModel
from stiff_models.networks.encoded_model import EncodedModel, StandardisedRows
from stiff_models.physics.vjm import OnPhysics
from stiff_protocols.contract.errors import ModelError, warn
from stiff_protocols.contract.types import FloatArray, Robot, Samples


@dataclass(kw_only=True, eq=False, repr=False)
class RegressorModel(EncodedModel):
    """Base of the families whose learner has scikit-learn's `fit` and `predict`."""

    def _fit(self, train: Samples, robot: Robot, validation: Samples | None, seed: int) -> None:
        rows = self._trained_rows(robot, train)
        self.regressor_ = self._regressor(seed)
        with numpys_seed(seed):
            self._learn(rows, None if validation is None else self._standardised(robot, validation))

    @abstractmethod
    def _regressor(self, seed: int) -> Any:
        """Return a new regressor of (n, 3) targets with scikit-learn's `fit` and `predict`."""

    def _learn(self, train: StandardisedRows, validation: StandardisedRows | None) -> None:
        with sklearn_warnings_as_stiffbench():
            self.regressor_.fit(*train)

    def _predict(self, q: FloatArray, wrench: FloatArray) -> FloatArray:
        with sklearn_warnings_as_stiffbench():
            predicted = self.regressor_.predict(self._features(self.robot_, q, wrench))
        return self.output_scaler_.undo(predicted)


def for_three_outputs(regressor: Any) -> Any:
    """Return a regressor of the three axes: one copy per axis if it has only one output."""
    several = get_tags(regressor).target_tags.multi_output
    return regressor if several else MultiOutputRegressor(regressor)


@contextmanager
def sklearn_warnings_as_stiffbench() -> Iterator[None]:
    """Turn a regressor's warnings about samples into stiffbench warnings, which results store.

    Warnings about its code (deprecations, future changes) are not changed.
    """
    with warnings.catch_warnings(record=True) as caught:
        warnings.simplefilter("always")
        yield
    for text, category in dict.fromkeys((str(w.message), w.category) for w in caught):
        if not issubclass(category, UserWarning | RuntimeWarning):
            warnings.warn(text, category, stacklevel=4)
            continue
        finding = " ".join(text.split()).partition(" You might")[0]  # advice on other data
        if category is RuntimeWarning:  # numpy does not name the source of its warnings
            finding = f"the regressor's arithmetic: {finding}"
        warn(finding, stacklevel=4)


@contextmanager
def numpys_seed(seed: int) -> Iterator[None]:
    """Seed numpy's global state (libsvm uses it) inside the block, and restore it afterwards."""
    state = np.random.get_state()  # noqa: NPY002
    np.random.seed(seed % 2**32)  # noqa: NPY002
    try:
        yield
    finally:
        np.random.set_state(state)  # noqa: NPY002


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


@dataclass(kw_only=True, eq=False, repr=False)
class NearestNeighbours(RegressorModel):
    """k nearest neighbours in standardised features, Euclidean distance.

    Attributes:
        neighbours: number of training samples that are averaged.
        weights: "uniform", or "distance" (inverse distance).
    """

    neighbours: Annotated[int, Ge(1)] = 5
    weights: Literal["uniform", "distance"] = "distance"

    def _regressor(self, seed: int) -> Any:
        return KNeighborsRegressor(n_neighbors=self.neighbours, weights=self.weights)

    def _learn(self, train: StandardisedRows, validation: StandardisedRows | None) -> None:
        if len(train[0]) < self.neighbours:
            raise ModelError(
                f"neighbours is {self.neighbours}, but there are only {len(train[0])} training "
                "samples; use fewer neighbours"
            )
        super()._learn(train, validation)


@dataclass(kw_only=True, eq=False, repr=False)
class BoostingModel(RegressorModel):
    """Histogram gradient boosting, squared error, one ensemble per axis.

    The defaults suit about a hundred samples. All trees are kept: an early stop would cost
    training rows.

    Attributes:
        trees: number of trees per axis.
        learning_rate: factor on the correction of each tree.
        leaves: most leaves of a tree.
        leaf_samples: fewest training samples of a leaf.
    """

    trees: Annotated[int, Ge(1)] = 200
    learning_rate: Annotated[float, Gt(0.0)] = 0.05
    leaves: Annotated[int, Ge(2)] = 8
    leaf_samples: Annotated[int, Ge(1)] = 5

    def _regressor(self, seed: int) -> Any:
        return for_three_outputs(
            HistGradientBoostingRegressor(
                max_iter=self.trees,
                learning_rate=self.learning_rate,
                max_leaf_nodes=self.leaves,
                min_samples_leaf=self.leaf_samples,
                early_stopping=False,
                random_state=seed,
            )
        )


@dataclass(kw_only=True, eq=False, repr=False)
class VjmBoosting(OnPhysics, BoostingModel):
    """Physics plus a gradient-boosting residual."""
