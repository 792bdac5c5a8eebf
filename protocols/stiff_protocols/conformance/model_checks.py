"""Checks of a model: requirements for a valid row in a table."""

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

from stiff_protocols.conformance.checked_model import INFLATION, SMALLEST, CheckedModel, inflated
from stiff_protocols.conformance.checks import Check, Failed, NotApplicable, run_checks
from stiff_protocols.contract.errors import NotFittedError, NotSavable
from stiff_protocols.contract.stiffness_model import StiffnessModel, offers
from stiff_protocols.contract.types import BenchmarkData, FloatArray
from stiff_protocols.scoring.sanity import check_units

ROUNDING = 1e-5
"""Share of the largest prediction by which single precision may change with the batch size."""
NEAR_BAIT = 0.5
"""Share of their size: no model predicts random deflections with a smaller error."""
GROWN = 10.0
"""Factor of growth that shows that a model learned from large labels."""
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

    It is fitted five times, or six times if it uses validation rows. One or two more fits follow
    if fits are unexpectedly equal or different.

    Args:
        make: function that returns a new model with the options to check, such as the class.
        data: at least 10 samples (else a DataError) with their robot; at most 48 are used.
        uses_validation: as in the model's `ModelInfo`.
        save: function that writes a fitted model to a file; None: the model's own `save`, if any.
        load: function that reads such a file (`stiff_models.load`); None: the round trip is not
            checked.
    """
    model = ModelChecks(make, data, uses_validation=uses_validation, save=save, load=load)
    return run_checks(model)


class ModelChecks(CheckedModel):
    """The checks, in their order; the first check of a fit or a prediction reports its error."""

    def the_constructor_takes_keywords_and_only_stores_them(self) -> None:
        """Give every option a default, and leave checks and conversions to fit."""
        made = self.new()
        parameters = inspect.signature(type(made)).parameters.values()
        loose = [p.name for p in parameters if p.kind is not inspect.Parameter.KEYWORD_ONLY]
        if loose:
            raise Failed(
                f"{', '.join(loose)} can be passed without a name",
                "write def __init__(self, *, ...): with a star before the first option",
            )
        given = {name: object() for name in made.get_params(deep=False)}  # only assigned: kept
        made = type(made)(**given)
        if changed := [name for name in given if getattr(made, name, None) is not given[name]]:
            raise Failed(f"{', '.join(changed)} not stored as given")
        if early := [name for name in vars(made) if name.endswith("_") and name[0] != "_"]:
            raise Failed(f"{', '.join(early)} exists before fit")

    def clone_gives_the_options_back(self) -> None:
        """Inherit sklearn.base.BaseEstimator and store every option under its own name."""
        made = self.new()
        params = made.get_params(deep=False)
        option_names = set(inspect.signature(type(made)).parameters)
        if set(params) != option_names:
            raise Failed(
                f"get_params names {sorted(params)}, the constructor {sorted(option_names)}"
            )
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
        """Find the exception of your fit: call fit in Python to see its origin."""
        self.fitted()
        if self.fit_faults:
            raise self.fit_faults[0]
        n_validation = len(self.parts["own"] or ())
        return f"{len(self.train)} training and {n_validation} validation rows"

    def predict_returns_finite_numbers_in_metres(self) -> str:
        """Return a float64 array (n, 3), one row per sample: x, y, z in m, as train.deflection."""
        if self.predicted().dtype.kind != "f":
            raise Failed(f"predict returned {self.predicted().dtype}, expected float64")
        predicted = self.predict(self.fitted(), self.train.q, self.train.wrench)
        check_units(predicted, self.train.deflection)
        return f"{len(self.test)} rows"

    def predictions_come_from_what_the_model_was_given(self) -> None:
        """Predict from q, wrench and fitted attributes; a run keeps test deflections separate."""
        predicted, bait, measured = self.predicted(), self.test.deflection, self.measured
        is_bait = _size(predicted - bait) < NEAR_BAIT * _size(bait)
        if is_bait or (measured.any() and np.array_equal(predicted, measured)):
            raise Failed(
                "predict returns the deflections of the test rows, which are not its input"
            )

    def a_prediction_does_not_depend_on_the_other_rows(self) -> None:
        """Compute means, scales and neighbours in fit from train; in predict it is a leak."""
        fitted = self.fitted()
        self._see_no_neighbours("a row", lambda q, wrench: self.predict(fitted, q, wrench))

    def predicting_twice_gives_the_same_numbers(self) -> None:
        """Use random numbers only in fit; switch a network to eval mode."""
        _same("the second prediction", self.predicted(), self.predict_test(self.fitted()))

    def the_same_seed_gives_the_same_model(self) -> None:
        """Draw all random numbers from `seed`: rng = np.random.default_rng(seed)."""
        first, again = self.predicted(), self.predicted("train", "validation")
        if not np.array_equal(first, again):  # due to randomness, or to validation rows
            again = self.predicted_again()
        _same("a second model", first, again)

    def validation_rows_are_not_learned_from(self) -> str:
        """Ignore `validation`, or set uses_validation=True in the ModelInfo."""
        self.predicted()
        if not self.uses_validation:
            with_validation = self.predicted("train", "validation")
            self._same_unless_by_chance("fitted with validation rows, it", with_validation)
            return ""
        first, other_model = self.fitted(), self.fitted("other", "loud")
        predicted = self.predict(other_model, self.other_samples.q, self.other_samples.wrench)
        times = _size(predicted) / max(_size(self.other_samples.deflection), SMALLEST)
        symptom = f"it predicts its training rows {times:.0f} times too large"
        if times <= GROWN and offers(first, "predict_interval"):
            times = self._width(other_model) / max(self._width(first), SMALLEST)
            symptom = f"its intervals are {times:.0f} times as wide"
        if times > GROWN:
            raise Failed(
                f"with validation deflections x {INFLATION:g} {symptom}",
                "let validation rows choose an epoch, and fit every number only to train",
            )
        return "they choose an epoch"

    def a_fit_works_without_validation_rows(self) -> None:
        """Keep the last epoch if validation is None."""
        self.predicted()
        self.predicted("other", "none")

    def a_fit_takes_samples_that_state_more(self) -> None:
        """Ignore train.order, train.approach and train.after, or use them."""
        self.predicted()
        self.fitted("stated")

    def a_fit_learns_from_its_own_rows(self) -> None:
        """Cache a fit by its rows and its seed, not only by its seed."""
        first, elsewhere = self.predicted(), [self.predicted("other", "none")]
        if self.uses_validation:  # a cached fit may depend on whether there are validation rows
            elsewhere.append(self.predicted("other", "loud"))
        if not any(np.array_equal(first, other_prediction) for other_prediction in elsewhere):
            return
        large = self.new()
        self.fit(large, inflated(self.other_samples), self.parts["own"], seed=1)
        if _size(self.predict_test(large)) > GROWN * _size(first):
            raise Failed("a new model that is fitted to other rows gives the numbers of the first")
        raise NotApplicable("predicts the same after a fit to other rows")

    def a_second_fit_forgets_the_first(self) -> None:
        """Compute every attribute that ends in _ again in each fit."""
        self.predicted()
        self.predicted("other", "none")
        refitted = self.fitted("other", "none")
        self.fit(refitted, self.train, self.parts["own"])
        what = "a model that was fitted to other rows before"
        self._same_unless_by_chance(what, self.predict_test(refitted))

    def joint_angles_of_another_robot_are_refused(self) -> None:
        """Store the number of joints in fit; raise ValueError if q.shape[1] differs."""
        self.predicted()
        q, wrench = self.test.q, self.test.wrench
        for other_q in (q[:, :-1], np.hstack([q, q[:, :1]])):
            try:
                self.answer(self.fitted(), other_q, wrench)
            except Exception:
                continue
            raise Failed(f"numbers for {other_q.shape[1]} joints after a fit to {q.shape[1]}")

    def no_load_gives_no_deflection(self) -> None:
        """Predict finite numbers."""
        self.predicted()
        unloaded = np.zeros_like(self.test.wrench)
        most = _size(self.predict(self.fitted(), self.test.q, unloaded))
        if most > SMALLEST:  # physics requires it, learners need not follow it
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
                raise Failed(f"{name!r} is not a text")
            float(value)
        return f"{len(fitted.diagnostics_)} numbers"

    def intervals_fit_the_rows_and_widen_with_coverage(self) -> None:
        """Return contract.types.Interval(lower, upper, coverage) with (n, 3) bounds in m."""
        fitted, n = self._with_intervals(), len(self.test)
        widths = []
        for coverage in COVERAGES:
            interval = self.interval(fitted, self.test.q, self.test.wrench, coverage)
            if interval.lower.shape != (n, 3) or interval.coverage != coverage:
                raise Failed(
                    f"interval of shape {interval.lower.shape} and coverage {interval.coverage}, "
                    f"expected ({n}, 3) and {coverage}"
                )
            widths.append(interval.upper - interval.lower)
        if (widths[1] < widths[0]).any():
            raise Failed("an interval of coverage 0.95 is narrower than the interval of 0.5")

    def an_interval_does_not_depend_on_the_other_rows(self) -> None:
        """Compute scales and quantiles in fit from train; in predict_interval it is a leak."""
        fitted = self._with_intervals()

        def around(q: FloatArray, wrench: FloatArray) -> FloatArray:
            # relative to the predictions, which another check covers
            interval = self.interval(fitted, q, wrench, COVERAGES[0])
            middle = self.predict(fitted, q, wrench)
            return np.hstack([interval.lower - middle, interval.upper - middle])

        self._see_no_neighbours("an interval", around)

    def save_and_load_give_the_same_numbers(self) -> None:
        """Store everything that predict needs in attributes that end in _."""
        fitted = self.fitted()
        save = self.save or (type(fitted).save if offers(fitted, "save") else None)
        if self.load is None or save is None:
            raise NotApplicable("not checked here; `bench check` saves and loads like `bench fit`")
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
        self.predicted()  # this check is the last, after all fits and predictions
        if self.side_effects:
            raise self.side_effects[0]

    def _same_unless_by_chance(self, what: str, prediction: FloatArray) -> None:
        """Compare a prediction with the first fit's, if equal fits give equal predictions."""
        first = self.predicted()
        if not np.array_equal(first, prediction) and not np.array_equal(
            first, self.predicted_again()
        ):
            raise NotApplicable("its fits differ from each other")
        _same(what, first, prediction)

    def _see_no_neighbours(
        self, what: str, predict: Callable[[FloatArray, FloatArray], FloatArray]
    ) -> None:
        """Check that predictions one by one and in reverse order are equal.

        `predict` returns (n, k) m for n rows.
        """
        self.predicted()
        q, wrench = self.test.q, self.test.wrench
        together = predict(q, wrench)
        single = np.concatenate([predict(q[i : i + 1], wrench[i : i + 1]) for i in range(len(q))])
        backwards = predict(q[::-1], wrench[::-1])[::-1]
        for order, prediction in (("one by one", single), ("in reverse order", backwards)):
            far = _size(prediction - together)
            if far > SMALLEST + ROUNDING * _size(together):
                raise Failed(f"{what} predicted {order} differs by up to {1e3 * far:.3g} mm")

    def _with_intervals(self) -> StiffnessModel:
        fitted = self.fitted()
        if not offers(fitted, "predict_interval"):
            raise NotApplicable("no predict_interval; split-conformal intervals are used")
        self.predicted()
        return fitted

    def _width(self, fitted: StiffnessModel) -> float:
        interval = self.interval(fitted, self.test.q, self.test.wrench, 0.9)
        return float(np.median(interval.upper - interval.lower))


def _same(what: str, first: FloatArray, second: FloatArray) -> None:
    if not np.array_equal(first, second):
        raise Failed(f"{what} differs by up to {1e3 * _size(first - second):.3g} mm")


def _size(values: FloatArray) -> float:
    return float(np.abs(values).max())
