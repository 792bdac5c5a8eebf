"""Candidates that a tree-structured Parzen estimator draws: the package optuna, an extra.

Bergstra, Bardenet, Bengio and Kegl, Algorithms for hyper-parameter optimization, NeurIPS 2011.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from typing import TYPE_CHECKING, Any

from stiff_protocols.contract.errors import ConfigError
from stiff_protocols.contract.search_space import Grid, Range

if TYPE_CHECKING:
    from optuna.distributions import BaseDistribution


def require_optuna() -> None:
    """See that the package is there.

    Raises:
        ConfigError: it is not.
    """
    try:
        import optuna  # noqa: F401
    except ImportError:
        raise ConfigError(
            "search=optuna needs the package optuna: pip install 'stiffbench[tune]'"
        ) from None


def try_drawn(
    grid: Grid, error_of: Callable[[Mapping[str, Any]], float], *, trials: int, seed: int
) -> None:
    """Try `trials` candidates, each drawn with the errors of those before.

    Args:
        grid: what to draw from.
        error_of: returns a candidate's error; infinite where it failed.
        trials: how many.
        seed: of the draws.
    """
    import optuna

    said = optuna.logging.get_verbosity()
    optuna.logging.set_verbosity(optuna.logging.ERROR)
    try:
        study = optuna.create_study(sampler=optuna.samplers.TPESampler(seed=seed))
        distributions = {name: _distribution(values) for name, values in grid.items()}
        for _ in range(trials):
            trial = study.ask(distributions)
            error = error_of(
                {name: _value(values, trial.params[name]) for name, values in grid.items()}
            )
            if math.isfinite(error):
                study.tell(trial, error)
            else:
                study.tell(trial, state=optuna.trial.TrialState.FAIL)
    finally:
        optuna.logging.set_verbosity(said)


def _distribution(values: Sequence[Any] | Range) -> BaseDistribution:
    """Return what optuna draws from: places in a list, which may hold anything, or numbers."""
    from optuna.distributions import (
        CategoricalDistribution,
        FloatDistribution,
        IntDistribution,
    )

    if not isinstance(values, Range):
        return CategoricalDistribution(range(len(values)))
    if values.whole:
        return IntDistribution(int(values.low), int(values.high), log=values.log)
    return FloatDistribution(values.low, values.high, log=values.log)


def _value(values: Sequence[Any] | Range, drawn: Any) -> Any:
    """Return the option's value; three digits of it, so that what is printed is what was tried."""
    if not isinstance(values, Range):
        return values[drawn]
    if values.whole:
        return drawn
    return min(max(float(f"{drawn:.3g}"), values.low), values.high)
