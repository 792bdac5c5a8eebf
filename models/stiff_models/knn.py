"""`knn`: the mean of the most similar training samples."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Annotated, Any, Literal

from annotated_types import Ge
from sklearn.neighbors import KNeighborsRegressor

from stiff_models.regressor_model import RegressorModel
from stiff_models.standardised_model import Rows
from stiff_protocols.errors import ModelError


@dataclass(kw_only=True, eq=False, repr=False)
class NearestNeighbours(RegressorModel):
    """k nearest neighbours in standardised features, Euclidean distance.

    Attributes:
        neighbours: how many training samples are averaged.
        weights: "uniform", or "distance" (inverse distance).
    """

    neighbours: Annotated[int, Ge(1)] = 5
    weights: Literal["uniform", "distance"] = "distance"

    def _regressor(self, seed: int) -> Any:
        return KNeighborsRegressor(n_neighbors=self.neighbours, weights=self.weights)

    def _learn(self, train: Rows, validation: Rows | None) -> None:
        if len(train[0]) < self.neighbours:
            raise ModelError(f"neighbours {self.neighbours}: only {len(train[0])} training samples")
        super()._learn(train, validation)
