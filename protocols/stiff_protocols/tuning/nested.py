"""`nested`: `holdout` in which every model's options are chosen on the training side first."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Annotated

from annotated_types import Ge

from stiff_protocols.contract.interfaces import PredictsInterval, StiffnessModel
from stiff_protocols.contract.plugin import DEFAULT_GRID, Grid
from stiff_protocols.splits.random_splits import Holdout
from stiff_protocols.tuning.inner_search import InnerSearch, InnerSearchWithIntervals, Search


@dataclass(kw_only=True, eq=False)
class Nested(Holdout):
    """`holdout`'s divisions; an inner cross-validation by pose chooses the options.

    Attributes:
        grid: candidates: the name of a grid of each model's catalogue line, or a TOML file
            with a table a model. An option that was set stays as it was set.
        search: "grid" tries every combination, "optuna" some that TPE draws; both need the
            package optuna.
        trials: number of candidates of search=optuna.
        inner_folds: number of folds of the training poses.
    """

    grid: str = DEFAULT_GRID
    search: Search = "grid"
    trials: Annotated[int, Ge(1)] = 20
    inner_folds: Annotated[int, Ge(2)] = 3

    def tuned(self, model: StiffnessModel, grid: Grid) -> StiffnessModel:
        """Return the model that chooses from `grid` in its own fit."""
        own = isinstance(model, PredictsInterval)
        return (InnerSearchWithIntervals if own else InnerSearch)(
            model,
            grid,
            search=self.search,
            trials=self.trials,
            folds=self.inner_folds,
            validation_fraction=self.validation_fraction,
        )
