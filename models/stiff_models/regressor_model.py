"""What the families share that are a scikit-learn-style regressor on encoded samples."""

from __future__ import annotations

import warnings
from abc import abstractmethod
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from typing import Any, Self

import numpy as np
from sklearn.multioutput import MultiOutputRegressor
from sklearn.utils import get_tags

from stiff_models.standardised_model import Rows, StandardisedModel
from stiff_protocols.errors import StiffBenchWarning
from stiff_protocols.types import FloatArray, Robot, Samples


@dataclass(kw_only=True, eq=False, repr=False)
class RegressorModel(StandardisedModel):
    """Base of the families whose learner has scikit-learn's `fit` and `predict`."""

    def fit(
        self,
        train: Samples,
        *,
        robot: Robot,
        validation: Samples | None = None,
        seed: int = 0,
    ) -> Self:
        """Fit the regressor to `train`; few families look at `validation`.

        Raises:
            ModelError: the regressor cannot be fitted.
        """
        rows = self._standardised(robot, train)
        self.regressor_ = self._regressor(seed)
        with numpys_seed(seed):
            self._learn(rows, None if validation is None else self._rows(robot, validation))
        self.robot_ = robot
        return self

    @abstractmethod
    def _regressor(self, seed: int) -> Any:
        """Return a new regressor of (n, 3) targets with scikit-learn's `fit` and `predict`."""

    def _learn(self, train: Rows, validation: Rows | None) -> None:
        """Fit `regressor_`."""
        with told_as_ours():
            self.regressor_.fit(*train)

    def _predict(self, q: FloatArray, wrench: FloatArray) -> FloatArray:
        with told_as_ours():
            predicted = self.regressor_.predict(self._inputs(self.robot_, q, wrench))
        return self.output_scaler_.undo(predicted)


def for_three_outputs(regressor: Any) -> Any:
    """Return a regressor of the three axes: one copy an axis where it has one output only."""
    several = get_tags(regressor).target_tags.multi_output
    return regressor if several else MultiOutputRegressor(regressor)


@contextmanager
def told_as_ours() -> Iterator[None]:
    """Turn what a regressor says of the samples into our warnings, which stand beside a result.

    What it says of its code (deprecations, changes to come) stays what it is.
    """
    with warnings.catch_warnings(record=True) as caught:
        warnings.simplefilter("always")
        yield
    for text, category in dict.fromkeys((str(w.message), w.category) for w in caught):
        if not issubclass(category, UserWarning | RuntimeWarning):
            warnings.warn(text, category, stacklevel=4)
            continue
        finding = " ".join(text.split()).partition(" You might")[0]  # advice on other data
        if category is RuntimeWarning:  # numpy's, which does not say whose arithmetic it was
            finding = f"the regressor's arithmetic: {finding}"
        warnings.warn(finding, StiffBenchWarning, stacklevel=4)


@contextmanager
def numpys_seed(seed: int) -> Iterator[None]:
    """Let what draws from numpy's global state (libsvm does) follow `seed`, and leave no trace."""
    state = np.random.get_state()  # noqa: NPY002
    np.random.seed(seed % 2**32)  # noqa: NPY002
    try:
        yield
    finally:
        np.random.set_state(state)  # noqa: NPY002
