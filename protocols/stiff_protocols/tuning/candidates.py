"""Candidates of a search come from an Optuna study: every one of a grid, or some that TPE draws.

TPE is the tree-structured Parzen estimator of Bergstra, Bardenet, Bengio and Kegl, Algorithms for
hyper-parameter optimization, NeurIPS 2011. The package optuna is an extra, which is imported when
a search runs.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from typing import TYPE_CHECKING, Any, Literal

from stiff_protocols.contract.extras import require
from stiff_protocols.contract.search_space import Grid, Range

if TYPE_CHECKING:
    from optuna import Trial

Search = Literal["grid", "optuna"]
"""grid: every combination of the values; optuna: some that TPE draws, from ranges too."""


def try_candidates(
    grid: Grid,
    error_of: Callable[[Mapping[str, Any]], float],
    *,
    search: Search,
    trials: int,
    seed: int,
) -> None:
    """Try every candidate of a grid, or as many as `trials`, drawn with the errors seen before.

    Args:
        grid: options and their candidates; lists of values alone for search="grid".
        error_of: returns a candidate's error; infinite where it failed.
        search: "grid" visits the combinations in an order of its own.
        trials: how many TPE draws; one may be drawn again.
        seed: of the draws.
    """
    require("tuning", "optuna")
    import optuna

    def objective(trial: Trial) -> float:
        error = error_of({name: _value(trial, name, values) for name, values in grid.items()})
        return error if math.isfinite(error) else math.nan  # a failed trial teaches TPE nothing

    sampler: optuna.samplers.BaseSampler = optuna.samplers.TPESampler(seed=seed)
    if search == "grid":
        places = {n: range(len(v)) for n, v in grid.items() if not isinstance(v, Range)}
        sampler = optuna.samplers.GridSampler(places, seed=seed)
        trials = math.prod(map(len, places.values()))
    verbosity = optuna.logging.get_verbosity()
    optuna.logging.set_verbosity(optuna.logging.CRITICAL)
    try:
        optuna.create_study(sampler=sampler).optimize(objective, n_trials=trials)
    finally:
        optuna.logging.set_verbosity(verbosity)


def _value(trial: Trial, name: str, values: Sequence[Any] | Range) -> Any:
    """Return the trial's value of an option.

    Optuna draws the place in a list, which may hold anything. Of a number it keeps three digits,
    so that what is printed is what was tried.
    """
    if not isinstance(values, Range):
        return values[trial.suggest_categorical(name, range(len(values)))]
    if values.whole:
        return trial.suggest_int(name, int(values.low), int(values.high), log=values.log)
    drawn = trial.suggest_float(name, values.low, values.high, log=values.log)
    return min(max(float(f"{drawn:.3g}"), values.low), values.high)
