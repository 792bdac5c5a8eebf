"""Checks of a model: what must hold before its row in a table means anything."""

from __future__ import annotations

import inspect
import typing
from collections.abc import Callable, Mapping
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

import numpy as np
from sklearn.base import clone
from sklearn.exceptions import NotFittedError as SklearnNotFittedError

from stiff_protocols.conformance.checked_model import LOUD, SMALLEST, CheckedModel, loud
from stiff_protocols.conformance.checks import Check, Failed, NotApplicable, run_checks
from stiff_protocols.contract.errors import NotFittedError, NotSavable
from stiff_protocols.contract.stiffness_model import StiffnessModel, offers
from stiff_protocols.contract.types import BenchmarkData, FloatArray
from stiff_protocols.scoring.sanity import check_units

ROUNDING = 1e-5
"""Share of the largest prediction by which single precision may change with the batch size."""
NEAR_BAIT = 0.5
"""A share of their size: no model comes nearer to deflections that follow from nothing."""
GROWN = 10.0
"""So many times the size, and large labels have been learned from."""
COVERAGES = (0.5, 0.95)


def check_model(
    make: Callable[[], StiffnessModel],
    data: BenchmarkData,
    *,
    uses_validation: bool,
    save: Callable[[StiffnessModel, Path], None] | None = None,
    load: Callable[[Path], StiffnessModel] | None = None,
) -> list[Check]:
    """Check a model on a small data set.

    It is fitted four times, five times if it uses validation rows, and once or twice more where
    fits are the same that should differ, or differ that should be the same.

    Args:
        make: returns a new model with the options to be checked; the class itself will do.
        data: at least 10 samples (else a DataError), of which 48 at most are used, and their robot.
        uses_validation: as in the model's `ModelInfo`.
        save: writes a fitted model to a file; None: the model's own `save`, if it has one.
        load: reads a file that was saved so (`stiff_models.load`); None: the round trip is not
            checked.
    """
    model = ModelChecks(make, data, uses_validation=uses_validation, save=save, load=load)
    return run_checks(model)


class ModelChecks(CheckedModel):
    """The checks, in their order; the first of them that needs a fit or a prediction reports it."""

    def the_constructor_takes_keywords_and_only_stores_them(self) -> None:
        """Leave checks and conversions to fit."""
        made = self.new()
        parameters = inspect.signature(type(made)).parameters.values()
        loose = [p.name for p in parameters if p.kind is not inspect.Parameter.KEYWORD_ONLY]
        if loose:
            raise Failed(
                f"{', '.join(loose)} can be given without a name",
                "write def __init__(self, *, ...): with a star before the first option",
            )
        given = {name: object() for name in made.get_params(deep=False)}  # only assigned: kept
        made = type(made)(**given)
        if changed := [name for name in given if getattr(made, name, None) is not given[name]]:
            raise Failed(f"{', '.join(changed)} not stored as given")
        if early := [name for name in vars(made) if name.endswith("_") and name[0] != "_"]:
            raise Failed(f"{', '.join(early)} is there before fit")

    def clone_gives_the_options_back(self) -> None:
        """Inherit sklearn.base.BaseEstimator and store every option under its own name."""
        made = self.new()
        params = made.get_params(deep=False)
        wanted = set(inspect.signature(type(made)).parameters)
        if set(params) != wanted:
            raise Failed(f"get_params names {sorted(params)}, the constructor {sorted(wanted)}")
        if made.set_params(**params) is not made:
            raise Failed("set_params does not return the model")
        copied = clone(made).get_params(deep=False)
        for name, value in params.items():
            if copied[name] is not value and repr(copied[name]) != repr(value):
                raise Failed(f"clone changes {name} from {value!r}")

    def options_can_be_listed(self) -> None:
        """Annotate every option with a type that can be imported, or give it a plain default."""
        cls = type(self.new())
        source: Any = cls if hasattr(cls, "__dataclass_fields__") else cls.__init__
        hints = typing.get_type_hints(source, include_extras=True)
        for name, parameter in inspect.signature(cls).parameters.items():
            if name not in hints and not isinstance(parameter.default, bool | int | float | str):
                raise Failed(f"{name} has no annotation and no plain default")

    def predict_before_fit_is_refused(self) -> None:
        """Begin predict with sklearn.utils.validation.check_is_fitted(self)."""
        made = self.new()
        try:
            self.answer(made, self.test.q, self.test.wrench)
        except (NotFittedError, SklearnNotFittedError):
            return
        except Exception as error:
            reason = f"raised {type(error).__name__}: {error}, expected NotFittedError"
            raise Failed(reason) from error
        raise Failed("returned numbers")

    def fit_learns_from_measured_rows_and_returns_the_model(self) -> str:
        """Find the exception of your fit: call fit in Python to see where it comes from."""
        self.fitted()
        if self.fit_faults:
            raise self.fit_faults[0]
        n_validation = len(self.parts["own"] or ())
        return f"{len(self.train)} training and {n_validation} validation rows"

    def predict_returns_finite_numbers_in_metres(self) -> str:
        """Return a float64 array (n, 3), one row a sample: x, y, z, in m as train.deflection."""
        if self.predicted().dtype.kind != "f":
            raise Failed(f"predict returned {self.predicted().dtype}, expected float64")
        predicted = self.predict(self.fitted(), self.train.q, self.train.wrench)
        check_units(predicted, self.train.deflection)
        return f"{len(self.test)} rows"

    def predictions_come_from_what_the_model_was_given(self) -> None:
        """Predict from q, wrench and what fit has learned; a run holds test deflections apart."""
        predicted, bait, measured = self.predicted(), self.test.deflection, self.measured
        is_bait = _size(predicted - bait) < NEAR_BAIT * _size(bait)
        if is_bait or (measured.any() and np.array_equal(predicted, measured)):
            raise Failed("predict returns the deflections of the test rows, which it was not given")

    def a_prediction_does_not_depend_on_the_other_rows(self) -> None:
        """Take means, scales and neighbours in fit from train, never in predict: that is a leak."""
        fitted = self.fitted()
        self._see_no_neighbours("a row", lambda q, wrench: self.predict(fitted, q, wrench))

    def predicting_twice_gives_the_same_numbers(self) -> None:
        """Leave chance to fit; switch a network to eval mode."""
        _same("the second prediction", self.predicted(), self.predict_test(self.fitted()))

    def the_same_seed_gives_the_same_model(self) -> None:
        """Draw all chance from `seed`: rng = np.random.default_rng(seed)."""
        first, again = self.predicted(), self.predicted("train", "validation")
        if not np.array_equal(first, again):  # is it chance, or validation rows?
            again = self.predicted_again()
        _same("a second model", first, again)

    def validation_rows_are_not_learned_from(self) -> str:
        """Ignore `validation`, or say uses_validation=True in the ModelInfo."""
        self.predicted()
        if not self.uses_validation:
            beside = self.predicted("train", "validation")
            self._same_unless_by_chance("fitted with validation rows, it", beside)
            return ""
        first, other = self.fitted(), self.fitted("other", "loud")
        predicted = self.predict(other, self.other.q, self.other.wrench)
        times = _size(predicted) / max(_size(self.other.deflection), SMALLEST)
        symptom = f"it predicts its training rows {times:.0f} times too large"
        if times <= GROWN and offers(first, "predict_interval"):
            times = self._width(other) / max(self._width(first), SMALLEST)
            symptom = f"its intervals are {times:.0f} times as wide"
        if times > GROWN:
            raise Failed(
                f"with validation deflections x {LOUD:g} {symptom}",
                "let validation rows choose an epoch, and fit every number to train alone",
            )
        return "they choose an epoch"

    def a_fit_works_without_validation_rows(self) -> None:
        """Keep the last epoch if validation is None."""
        self.predicted()
        self.predicted("other", "none")

    def a_fit_learns_from_its_own_rows(self) -> None:
        """Let a fit that is remembered be remembered by its rows too, not by its seed alone."""
        first, elsewhere = self.predicted(), [self.predicted("other", "none")]
        if self.uses_validation:  # a kept answer may go by whether there are validation rows
            elsewhere.append(self.predicted("other", "loud"))
        if not any(np.array_equal(first, other) for other in elsewhere):
            return
        large = self.new()
        self.fit(large, loud(self.other), self.parts["own"], seed=1)
        if _size(self.predict_test(large)) > GROWN * _size(first):
            raise Failed("a new model that is fitted to other rows gives the numbers of the first")
        raise NotApplicable("predicts the same whatever rows it is fitted to")

    def a_second_fit_forgets_the_first(self) -> None:
        """Compute every attribute that ends in _ anew in fit."""
        self.predicted()
        self.predicted("other", "none")
        refitted = self.fitted("other", "none")
        self.fit(refitted, self.train, self.parts["own"])
        what = "a model that was fitted to other rows before"
        self._same_unless_by_chance(what, self.predict_test(refitted))

    def joint_angles_of_another_robot_are_refused(self) -> None:
        """Keep the number of joints in fit and raise ValueError if q.shape[1] is another."""
        self.predicted()
        q, wrench = self.test.q, self.test.wrench
        for other in (q[:, :-1], np.hstack([q, q[:, :1]])):
            try:
                self.answer(self.fitted(), other, wrench)
            except Exception:
                continue
            raise Failed(f"numbers for {other.shape[1]} joints after a fit to {q.shape[1]}")

    def no_load_gives_no_deflection(self) -> None:
        """Predict finite numbers."""
        self.predicted()
        unloaded = np.zeros_like(self.test.wrench)
        most = _size(self.predict(self.fitted(), self.test.q, unloaded))
        if most > SMALLEST:  # so it is in physics; learners need not know it
            raise NotApplicable(f"predicts up to {1e3 * most:.3g} mm without load")

    def diagnostics_can_be_printed(self) -> str:
        """Make diagnostics_ a dict of names with units and numbers."""
        fitted = self.fitted()
        if not hasattr(fitted, "diagnostics_"):
            raise NotApplicable("no diagnostics_")
        if not isinstance(fitted.diagnostics_, Mapping):
            raise Failed(f"diagnostics_ is a {type(fitted.diagnostics_).__name__}")
        for name, value in fitted.diagnostics_.items():
            if not isinstance(name, str):
                raise Failed(f"{name!r} is no name")
            float(value)
        return f"{len(fitted.diagnostics_)} numbers"

    def intervals_fit_the_rows_and_widen_with_coverage(self) -> None:
        """Return contract.types.Interval(lower, upper, coverage) with (n, 3) bounds in m."""
        fitted, n = self._with_intervals(), len(self.test)
        widths = []
        for coverage in COVERAGES:
            found = self.interval(fitted, self.test.q, self.test.wrench, coverage)
            if found.lower.shape != (n, 3) or found.coverage != coverage:
                raise Failed(
                    f"interval of shape {found.lower.shape} and coverage {found.coverage}, "
                    f"expected ({n}, 3) and {coverage}"
                )
            widths.append(found.upper - found.lower)
        if (widths[1] < widths[0]).any():
            raise Failed("an interval of coverage 0.95 is narrower than that of 0.5")

    def an_interval_does_not_depend_on_the_other_rows(self) -> None:
        """Take scales and quantiles in fit from train; in predict_interval that is a leak."""
        fitted = self._with_intervals()

        def around(q: FloatArray, wrench: FloatArray) -> FloatArray:
            # about the predictions, which are another check's
            found = self.interval(fitted, q, wrench, COVERAGES[0])
            middle = self.predict(fitted, q, wrench)
            return np.hstack([found.lower - middle, found.upper - middle])

        self._see_no_neighbours("an interval", around)

    def save_and_load_give_the_same_numbers(self) -> None:
        """Keep what predict needs in attributes that end in _."""
        fitted = self.fitted()
        save = self.save or (type(fitted).save if offers(fitted, "save") else None)
        if self.load is None or save is None:
            raise NotApplicable(
                "not checked here; `bench check` saves and loads as `bench fit` does"
            )
        first = self.predicted()
        with TemporaryDirectory() as folder:
            path = Path(folder) / "model.stiff"
            try:
                save(fitted, path)
            except NotSavable as error:
                raise NotApplicable(str(error)) from error
            loaded = self.load(path)
        _same("the model read from its file", first, self.predict_test(loaded))

    def fit_and_predict_touch_nothing_else(self) -> None:
        """Keep changes to the model itself."""
        self.predicted()  # this check is the last, when there is something to have been seen
        if effects := [*self.side_effects, *self.replaced_functions()]:
            raise effects[0]

    def _same_unless_by_chance(self, what: str, other: FloatArray) -> None:
        """See that this is the first fit's prediction, where another like it gives the same."""
        first = self.predicted()
        if not np.array_equal(first, other) and not np.array_equal(first, self.predicted_again()):
            raise NotApplicable("no two of its fits are the same")
        _same(what, first, other)

    def _see_no_neighbours(
        self, what: str, predict: Callable[[FloatArray, FloatArray], FloatArray]
    ) -> None:
        """Predict the test rows one by one and in reverse order: a row must not see the others.

        `predict` returns (n, k) m of n rows.
        """
        self.predicted()
        q, wrench = self.test.q, self.test.wrench
        together = predict(q, wrench)
        alone = np.concatenate([predict(q[i : i + 1], wrench[i : i + 1]) for i in range(len(q))])
        backwards = predict(q[::-1], wrench[::-1])[::-1]
        for how, other in (("alone", alone), ("in reverse order", backwards)):
            far = _size(other - together)
            if far > SMALLEST + ROUNDING * _size(together):
                raise Failed(f"{what} predicted {how} differs by up to {1e3 * far:.3g} mm")

    def _with_intervals(self) -> StiffnessModel:
        fitted = self.fitted()
        if not offers(fitted, "predict_interval"):
            raise NotApplicable("no predict_interval; split-conformal intervals are used")
        self.predicted()
        return fitted

    def _width(self, fitted: StiffnessModel) -> float:
        found = self.interval(fitted, self.test.q, self.test.wrench, 0.9)
        return float(np.median(found.upper - found.lower))


def _same(what: str, first: FloatArray, second: FloatArray) -> None:
    if not np.array_equal(first, second):
        raise Failed(f"{what} differs by up to {1e3 * _size(first - second):.3g} mm")


def _size(values: FloatArray) -> float:
    return float(np.abs(values).max())
