"""`nested`: a model's options are chosen in its own fit, by cross-validation on the training side.

Trying ten settings and reporting the best test error is tuning on the test part. Here the training
side is divided again by pose. Every candidate is fitted to the inner training parts and scored on
the inner test parts, and the best candidate is fitted again. Only the arguments of `fit` are used,
so the outer test part is not touched.
See G. C. Cawley and N. L. C. Talbot, On over-fitting in model selection, JMLR 11, 2010.

Candidates are every combination of a grid, or some that TPE draws (Bergstra, Bardenet, Bengio and
Kegl, Algorithms for hyper-parameter optimization, 2011) with the package optuna, an extra.
"""

from __future__ import annotations

import itertools
import math
import warnings
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import KW_ONLY, dataclass
from typing import TYPE_CHECKING, Annotated, Any, Literal, Self

import numpy as np
from annotated_types import Ge
from sklearn.base import BaseEstimator, clone
from sklearn.utils.metaestimators import available_if

from stiff_protocols.contract.errors import (
    ConfigError,
    ModelError,
    NotFittedError,
    warn,
)
from stiff_protocols.contract.extras import require
from stiff_protocols.contract.plugin import DEFAULT_GRID, Grid, ModelInfo, Range, in_words
from stiff_protocols.contract.protocol_base import ParseOption
from stiff_protocols.contract.stiffness_model import StiffnessModel, offers, optional
from stiff_protocols.contract.types import FloatArray, Interval, Robot, Samples, Split
from stiff_protocols.scoring.sanity import check_prediction
from stiff_protocols.splits.random_splits import Holdout, KFold
from stiff_protocols.tuning.candidates import read_grids

if TYPE_CHECKING:
    from optuna import Trial

SearchMethod = Literal["grid", "optuna"]
"""grid: every combination of the values; optuna: some that TPE draws, from ranges too."""


def fit_to(
    model: StiffnessModel,
    train: Samples,
    validation: Samples | None,
    *,
    robot: Robot,
    seed: int,
) -> None:
    """Fit a model; without a choice of epoch, it also learns from the validation rows."""
    if validation is not None and not (len(validation) and optional(model, "chooses_epoch")()):
        train, validation = Samples.together(train, validation), None
    model.fit(train, robot=robot, validation=validation, seed=seed)


NOT_TUNED = "not tuned"

MOST_CHECKED = 256
"""Number of combinations of a drawn search that are checked before any computation."""


@dataclass(frozen=True)
class Tried:
    """A candidate's options, its inner error, m (infinite if it failed), and the reason."""

    params: Mapping[str, Any]
    error: float
    failure: str = ""


@dataclass(eq=False, repr=False)
class InnerSearch(BaseEstimator, StiffnessModel):  # type: ignore[misc]
    """A model with the best of several candidate options; it replaces the model.

    Attributes:
        model: model to copy, set up and fit; it is not changed.
        grid: options and their candidates; if empty, the model is fitted with its own options.
        search: "grid" tries every combination, "optuna" some combinations drawn by TPE.
        trials: number of drawn combinations.
        folds: inner parts, by pose.
        validation_fraction: of an inner training part's poses, may choose the epoch.
        scores_: every candidate, in the order of the grid, or in which they were drawn.
        best_params_: the chosen options, the first of equally good ones.
        model_: the fitted model with them.
        diagnostics_: the model's diagnostics, the number of candidates, and the best inner error.
    """

    model: StiffnessModel
    grid: Grid
    _: KW_ONLY
    search: SearchMethod = "grid"
    trials: int = 20
    folds: int = 3
    validation_fraction: float = 0.2

    @property
    def regime(self) -> str:
        """Return how the model uses training labels, and whether nothing is chosen."""
        _, first = next(self._candidates())
        return ", ".join(
            filter(None, [getattr(first, "regime", ""), "" if self.grid else NOT_TUNED])
        )

    def check_params(self) -> None:
        """Check every candidate before anything is computed; of a range, both ends.

        ConfigError: a candidate's options do not fit together, candidates cannot be compared, there
        is a range where every combination is to be tried, or a package is missing.
        """
        if self.grid and self.search == "optuna":
            require("search=optuna", "optuna")
        for name, values in self.grid.items():
            if isinstance(values, Range) and self.search == "grid":
                raise ConfigError(
                    f"{name} is a range, which search=grid cannot try "
                    "(valid: a list of values, or search=optuna)"
                )
        regimes = set()
        for params, model in self._candidates():
            try:
                optional(model, "check_params")()
            except ConfigError as error:
                raise ConfigError(f"{in_words(params)}: {error}") from error
            regimes.add(getattr(model, "regime", ""))
        if len(regimes) > 1:
            raise ConfigError(
                "candidates that use training labels differently cannot be compared "
                f"({', '.join(sorted(regime or 'the usual way' for regime in regimes))})"
            )

    def check_robot(self, robot: Robot) -> None:
        """Raise ConfigError if a candidate does not support the robot."""
        for _, model in self._candidates():
            optional(model, "check_robot")(robot)

    def chooses_epoch(self) -> bool:
        """Return whether validation rows choose the epoch of any candidate."""
        return any(optional(model, "chooses_epoch")() for _, model in self._candidates())

    def missing(self) -> str:
        """Return what is missing on this machine for a candidate; "" for nothing."""
        for _, model in self._candidates():
            if reason := optional(model, "missing")():
                return str(reason)
        return ""

    def fit(
        self, train: Samples, *, robot: Robot, validation: Samples | None = None, seed: int = 0
    ) -> Self:
        """Choose the options on training and validation rows together, then fit the model.

        Rows are divided by pose. If validation rows are given, every inner training part gives
        some of its own rows to a candidate that chooses an epoch; the last fit gets the given rows.
        `seed` determines the divisions, the search, and every fit.

        Raises:
            ConfigError: there are too few poses for the inner parts.
            ModelError: no candidate can be fitted, or the best candidate cannot be fitted again.
        """
        self.best_params_: Mapping[str, Any] = {}
        self.scores_: tuple[Tried, ...] = ()
        report: dict[str, float] = {}
        if self.grid:
            self.scores_ = self._searched(train, robot, validation, seed)
            best = min(self.scores_, key=lambda tried: tried.error)
            if best.failure:
                raise ModelError(f"every candidate failed; {in_words(best.params)}: {best.failure}")
            self.best_params_ = best.params
            report = {
                "candidates": float(len(self.scores_)),
                "inner error of the chosen [mm]": best.error * 1000.0,
            }
        self.model_ = self._with(self.best_params_)
        fit_to(self.model_, train, validation, robot=robot, seed=seed)
        model_diagnostics = getattr(self.model_, "diagnostics_", {})
        self.diagnostics_ = {**model_diagnostics, **report}
        return self

    def predict(self, q: FloatArray, wrench: FloatArray) -> FloatArray:
        """Return the chosen model's (n, 3) deflection [m] for `q` [rad] and `wrench` [N, N m]."""
        return self._fitted().predict(q, wrench)

    @available_if(lambda search: offers(search.model, "predict_interval"))  # type: ignore[untyped-decorator]
    def predict_interval(self, q: FloatArray, wrench: FloatArray, coverage: float) -> Interval:
        """Return the chosen model's interval; only of a model that gives intervals."""
        return self._fitted().predict_interval(q, wrench, coverage)

    def _fitted(self) -> StiffnessModel:
        if not hasattr(self, "model_"):
            raise NotFittedError("InnerSearch: call fit before predict")
        fitted: StiffnessModel = self.model_
        return fitted

    def _candidates(self) -> Iterator[tuple[Mapping[str, Any], StiffnessModel]]:
        """Yield every combination of values (of a drawn search the first ones), unfitted.

        A range's ends stand for it.
        """
        values = [
            (values.low, values.high) if isinstance(values, Range) else values
            for values in self.grid.values()
        ]
        combinations: Iterator[tuple[Any, ...]] = itertools.product(*values)
        if self.search == "optuna":  # which draws a few of what may be millions
            combinations = itertools.islice(combinations, MOST_CHECKED)
        for combination in combinations:
            params = dict(zip(self.grid, combination, strict=True))
            yield params, self._with(params)

    def _searched(
        self, train: Samples, robot: Robot, validation: Samples | None, seed: int
    ) -> tuple[Tried, ...]:
        """Return every candidate's inner error; failed candidates are omitted with a warning."""
        rows = train if validation is None else Samples.together(train, validation)
        parts = KFold(folds=self.folds, validation_fraction=self.validation_fraction).splits(
            rows,
            n_splits=None,
            seed=int(np.random.default_rng(seed).integers(2**31)),  # `seed` has all of 32 bits
        )
        tried_candidates: dict[str, Tried] = {}  # a candidate may be drawn again

        def error_of(params: Mapping[str, Any]) -> float:
            words = in_words(params)
            if words not in tried_candidates:
                tried_candidates[words] = self._tried(
                    params, rows, parts, robot, validation is None, seed
                )
            return tried_candidates[words].error

        if self.search == "optuna":
            self._draw(error_of, seed)
        else:
            for params, _ in self._candidates():
                error_of(params)
        for words, score in tried_candidates.items():
            if score.failure:
                left_out = f"candidate {words} left out: {score.failure}"
                warn(left_out, stacklevel=1)
        return tuple(tried_candidates.values())

    def _tried(
        self,
        params: Mapping[str, Any],
        rows: Samples,
        parts: Sequence[Split],
        robot: Robot,
        learns_all: bool,
        seed: int,
    ) -> Tried:
        """Return a candidate's mean Euclidean error on the test rows of all parts, m."""
        distances = []
        try:
            for part in parts:
                model, test = self._with(params), rows.take(part.test)
                learned = np.r_[part.train, part.validation] if learns_all else part.train
                validation = None if learns_all else rows.take(part.validation)
                with warnings.catch_warnings():  # those of the last fit are the ones to read
                    warnings.simplefilter("ignore")
                    fit_to(model, rows.take(learned), validation, robot=robot, seed=seed)
                    predicted = np.asarray(model.predict(test.q, test.wrench))
                check_prediction(predicted, len(test))
                distances.append(np.linalg.norm(predicted - test.deflection, axis=1))
        except Exception as raised:  # a plugin's, whatever it is: this candidate's alone
            return Tried(params, math.inf, f"{type(raised).__name__}: {raised}")
        return Tried(params, float(np.concatenate(distances).mean()))

    def _draw(self, error_of: Callable[[Mapping[str, Any]], float], seed: int) -> None:
        """Try the candidates that TPE draws."""
        require("search=optuna", "optuna")
        import optuna

        def objective(trial: Trial) -> float:
            error = error_of({name: _value(trial, name, self.grid[name]) for name in self.grid})
            return error if math.isfinite(error) else math.nan  # a failed trial teaches nothing

        verbosity = optuna.logging.get_verbosity()
        optuna.logging.set_verbosity(optuna.logging.CRITICAL)
        try:
            study = optuna.create_study(sampler=optuna.samplers.TPESampler(seed=seed))
            study.optimize(objective, n_trials=self.trials)
        finally:
            optuna.logging.set_verbosity(verbosity)

    def _with(self, params: Mapping[str, Any]) -> StiffnessModel:
        made: StiffnessModel = clone(self.model).set_params(**params)
        return made


def _value(trial: Trial, name: str, values: Sequence[Any] | Range) -> Any:
    """Return the trial's value of an option.

    Optuna draws the place in a list, which may hold anything. Of a number it keeps three digits,
    so that what is printed is what was tried.
    """
    if not isinstance(values, Range):
        return values[trial.suggest_categorical(name, range(len(values)))]
    if values.is_integer:
        return trial.suggest_int(name, int(values.low), int(values.high), log=values.log)
    drawn = trial.suggest_float(name, values.low, values.high, log=values.log)
    return min(max(float(f"{drawn:.3g}"), values.low), values.high)


@dataclass(kw_only=True, eq=False)
class Nested(Holdout):
    """`holdout`'s divisions; an inner cross-validation by pose chooses the options.

    Attributes:
        grid: candidates: the name of a grid of each model's catalogue line, or a TOML file
            with a table a model. An option that was set stays as it was set.
        search: "grid" tries every combination, "optuna" some that TPE draws with the package
            optuna.
        trials: number of candidates of search=optuna.
        inner_folds: number of folds of the training poses.
    """

    grid: str = DEFAULT_GRID
    search: SearchMethod = "grid"
    trials: Annotated[int, Ge(1)] = 20
    inner_folds: Annotated[int, Ge(2)] = 3

    def grids(self, models: Sequence[ModelInfo], parse: ParseOption) -> Mapping[str, Grid]:
        """Return the candidates of `grid`; ConfigError: it has none for any of the models."""
        return read_grids(self.grid, f"nested.grid={self.grid}", models, parse)

    def tuned(self, model: StiffnessModel, grid: Grid) -> StiffnessModel:
        """Return the model that chooses from `grid` in its own fit."""
        return InnerSearch(
            model,
            grid,
            search=self.search,
            trials=self.trials,
            folds=self.inner_folds,
            validation_fraction=self.validation_fraction,
        )
