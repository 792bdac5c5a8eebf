"""Checks of a model: what must hold before its row in a table means anything."""

from __future__ import annotations

import inspect
import typing
from collections.abc import Callable, Mapping
from functools import partial
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

import numpy as np
from sklearn.base import clone
from sklearn.exceptions import NotFittedError as SklearnNotFittedError

from stiff_protocols.conformance.checked_model import LOUD, SMALLEST, CheckedModel, loud, options
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
    model = CheckedModel(make, data, uses_validation=uses_validation, save=save, load=load)
    return run_checks(MODEL_CHECKS, model)


def the_constructor_takes_keywords_and_only_stores_them(model: CheckedModel) -> None:
    """Leave checks and conversions to fit."""
    made = model.new()
    parameters = inspect.signature(type(made)).parameters.values()
    loose = [p.name for p in parameters if p.kind is not inspect.Parameter.KEYWORD_ONLY]
    if loose:
        raise Failed(
            f"{', '.join(loose)} can be given without a name",
            "write def __init__(self, *, ...): with a star before the first option",
        )
    given = {name: object() for name in made.get_params(deep=False)}  # only assignments keep them
    made = type(made)(**given)
    if changed := [name for name, value in given.items() if getattr(made, name, None) is not value]:
        raise Failed(f"{', '.join(changed)} not stored as given")
    if early := [name for name in vars(made) if name.endswith("_") and not name.startswith("_")]:
        raise Failed(f"{', '.join(early)} is there before fit")


def clone_gives_the_options_back(model: CheckedModel) -> None:
    """Inherit sklearn.base.BaseEstimator and store every option under its own name."""
    made = model.new()
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


def options_can_be_listed(model: CheckedModel) -> None:
    """Annotate every option with a type that can be imported, or give it a plain default."""
    cls = type(model.new())
    source: Any = cls if hasattr(cls, "__dataclass_fields__") else cls.__init__
    hints = typing.get_type_hints(source, include_extras=True)
    for name, parameter in inspect.signature(cls).parameters.items():
        if name not in hints and not isinstance(parameter.default, bool | int | float | str):
            raise Failed(f"{name} has no annotation and no plain default")


def predict_before_fit_is_refused(model: CheckedModel) -> None:
    """Begin predict with sklearn.utils.validation.check_is_fitted(self)."""
    made = model.new()
    try:
        model.predict(made, model.test.q, model.test.wrench)
    except (NotFittedError, SklearnNotFittedError):
        return
    except Exception as error:
        raise Failed(f"raised {type(error).__name__}: {error}, expected NotFittedError") from error
    raise Failed("returned numbers")


def fit_learns_from_measured_rows_and_returns_the_model(model: CheckedModel) -> str:
    """Find the exception of your fit: call fit in Python to see where it comes from."""
    after = options(model.fitted)
    if model.fitted is not model.returned_by_fit:
        wrong = type(model.returned_by_fit).__name__
        raise Failed(f"fit returned {wrong}", "end fit with: return self")
    for name, value in model.options_before_fit.items():
        if after.get(name) != value:
            raise Failed(
                f"fit changes {name} from {value} to {after.get(name, 'nothing')}",
                "keep what fit makes of an option under another name, one that ends in _",
            )
    n_validation = len(model.own_validation or ())
    return f"{len(model.train)} training and {n_validation} validation rows"


def predict_returns_finite_numbers_in_metres(model: CheckedModel) -> str:
    """Return a float64 array (n, 3), one row a sample: x, y, z, in m as train.deflection."""
    if model.prediction.dtype.kind != "f":
        raise Failed(f"predict returned {model.prediction.dtype}, expected float64")
    predicted = model.predict_checked(model.fitted, model.train.q, model.train.wrench)
    check_units(predicted, model.train.deflection)
    return f"{len(model.test)} rows"


def predictions_come_from_what_the_model_was_given(model: CheckedModel) -> None:
    """Predict from q, wrench and what fit has learned; a run holds test deflections elsewhere."""
    predicted, bait, measured = model.prediction, model.test.deflection, model.measured
    is_bait = _size(predicted - bait) < NEAR_BAIT * _size(bait)
    if is_bait or (measured.any() and np.array_equal(predicted, measured)):
        raise Failed("predict returns the deflections of the test rows, which it was not given")


def a_prediction_does_not_depend_on_the_other_rows(model: CheckedModel) -> None:
    """Take means, scales and neighbours in fit from train, never in predict: that is a leak."""
    predict = partial(model.predict_checked, model.fitted)
    _see_no_neighbours("a row", model.prediction, predict, model)


def predicting_twice_gives_the_same_numbers(model: CheckedModel) -> None:
    """Leave chance to fit; switch a network to eval mode."""
    _same("the second prediction", model.prediction, model.predict_test(model.fitted))


def the_same_seed_gives_the_same_model(model: CheckedModel) -> None:
    """Draw all chance from `seed`: rng = np.random.default_rng(seed)."""
    first, again = model.prediction, model.prediction_beside_validation
    if not np.array_equal(first, again):  # is it chance, or validation rows?
        again = model.prediction_again
    _same("a second model", first, again)


def validation_rows_are_not_learned_from(model: CheckedModel) -> str:
    """Ignore `validation`, or say uses_validation=True in the ModelInfo."""
    if not model.uses_validation:
        _ = model.prediction
        beside = model.prediction_beside_validation
        _same_unless_by_chance("fitted with validation rows, it", model, beside)
        return ""
    _ = model.prediction
    first, other = model.fitted, model.fitted_beside_loud_validation
    predicted = model.predict(other, model.other.q, model.other.wrench)
    times = _size(predicted) / max(_size(model.other.deflection), SMALLEST)
    found = f"it predicts its training rows {times:.0f} times too large"
    if times <= GROWN and offers(first, "predict_interval") and offers(other, "predict_interval"):
        times = _width(model, other) / max(_width(model, first), SMALLEST)
        found = f"its intervals are {times:.0f} times as wide"
    if times > GROWN:
        raise Failed(
            f"with validation deflections x {LOUD:g} {found}",
            "let validation rows choose an epoch, and fit every number to train alone",
        )
    return "they choose an epoch"


def a_fit_works_without_validation_rows(model: CheckedModel) -> None:
    """Keep the last epoch if validation is None."""
    _ = model.prediction, model.prediction_elsewhere


def a_fit_learns_from_its_own_rows(model: CheckedModel) -> None:
    """Let a fit that is remembered be remembered by its rows too, not by its seed alone."""
    first, elsewhere = model.prediction, [model.prediction_elsewhere]
    if model.uses_validation:  # a kept answer may go by whether there are validation rows
        elsewhere.append(model.predict_test(model.fitted_beside_loud_validation))
    if not any(np.array_equal(first, other) for other in elsewhere):
        return
    large = model.new()
    model.fit(large, loud(model.other), model.own_validation, seed=1)
    if _size(model.predict_test(large)) > GROWN * _size(first):
        raise Failed("a new model that is fitted to other rows gives the numbers of the first")
    raise NotApplicable("predicts the same whatever rows it is fitted to")


def a_second_fit_forgets_the_first(model: CheckedModel) -> None:
    """Compute every attribute that ends in _ anew in fit."""
    _ = model.prediction, model.prediction_elsewhere
    refitted = model.fitted_elsewhere
    model.fit(refitted, model.train, model.own_validation)
    what = "a model that was fitted to other rows before"
    _same_unless_by_chance(what, model, model.predict_test(refitted))


def joint_angles_of_another_robot_are_refused(model: CheckedModel) -> None:
    """Keep the number of joints in fit and raise ValueError if q.shape[1] is another."""
    _ = model.prediction
    q, wrench = model.test.q, model.test.wrench
    for other in (q[:, :-1], np.hstack([q, q[:, :1]])):
        try:
            model.predict(model.fitted, other, wrench)
        except Exception:
            continue
        raise Failed(f"numbers for {other.shape[1]} joints after a fit to {q.shape[1]}")


def no_load_gives_no_deflection(model: CheckedModel) -> None:
    """Predict finite numbers."""
    _ = model.prediction
    unloaded = np.zeros_like(model.test.wrench)
    most = _size(model.predict(model.fitted, model.test.q, unloaded))
    if most > SMALLEST:  # so it is in physics; learners need not know it
        raise NotApplicable(f"predicts up to {1e3 * most:.3g} mm without load")


def diagnostics_can_be_printed(model: CheckedModel) -> str:
    """Make diagnostics_ a dict of names with units and numbers."""
    fitted = model.fitted
    if not hasattr(fitted, "diagnostics_"):
        raise NotApplicable("has no diagnostics_")
    if not isinstance(fitted.diagnostics_, Mapping):
        raise Failed(f"diagnostics_ is a {type(fitted.diagnostics_).__name__}")
    for name, value in fitted.diagnostics_.items():
        if not isinstance(name, str):
            raise Failed(f"{name!r} is no name")
        float(value)
    return f"{len(fitted.diagnostics_)} numbers"


def intervals_fit_the_rows_and_widen_with_coverage(model: CheckedModel) -> None:
    """Return contract.types.Interval(lower, upper, coverage) with (n, 3) bounds in m."""
    fitted, n = _with_intervals(model), len(model.test)
    widths = []
    for coverage in COVERAGES:
        found = model.interval(fitted, model.test.q, model.test.wrench, coverage)
        if found.lower.shape != (n, 3) or found.coverage != coverage:
            raise Failed(
                f"interval of shape {found.lower.shape} and coverage {found.coverage}, expected "
                f"({n}, 3) and {coverage}"
            )
        widths.append(found.upper - found.lower)
    if (widths[1] < widths[0]).any():
        raise Failed("an interval of coverage 0.95 is narrower than that of 0.5")


def an_interval_does_not_depend_on_the_other_rows(model: CheckedModel) -> None:
    """Take scales and quantiles in fit from train, never in predict_interval: that is a leak."""
    fitted = _with_intervals(model)

    def around(q: FloatArray, wrench: FloatArray) -> FloatArray:
        # about the predictions, which are another check's
        found = model.interval(fitted, q, wrench, COVERAGES[0])
        middle = model.predict(fitted, q, wrench)
        return np.hstack([found.lower - middle, found.upper - middle])

    _see_no_neighbours("an interval", around(model.test.q, model.test.wrench), around, model)


def save_and_load_give_the_same_numbers(model: CheckedModel) -> None:
    """Keep what predict needs in attributes that end in _."""
    fitted = model.fitted
    save = model.save or (type(fitted).save if offers(fitted, "save") else None)
    if model.load is None or save is None:
        raise NotApplicable("not checked here; `bench check` saves and loads as `bench fit` does")
    first = model.prediction
    with TemporaryDirectory() as folder:
        path = Path(folder) / "model.stiff"
        try:
            save(fitted, path)
        except NotSavable as error:
            raise NotApplicable(str(error)) from error
        loaded = model.load(path)
    _same("the model read from its file", first, model.predict_test(loaded))


def fit_and_predict_touch_nothing_else(model: CheckedModel) -> None:
    """Keep changes to the model itself."""
    _ = model.prediction
    if effects := [*model.side_effects, *model.replaced_functions()]:
        raise effects[0]


MODEL_CHECKS = (
    the_constructor_takes_keywords_and_only_stores_them,
    clone_gives_the_options_back,
    options_can_be_listed,
    predict_before_fit_is_refused,
    fit_learns_from_measured_rows_and_returns_the_model,
    predict_returns_finite_numbers_in_metres,
    predictions_come_from_what_the_model_was_given,
    a_prediction_does_not_depend_on_the_other_rows,
    predicting_twice_gives_the_same_numbers,
    the_same_seed_gives_the_same_model,
    validation_rows_are_not_learned_from,
    a_fit_works_without_validation_rows,
    a_fit_learns_from_its_own_rows,
    a_second_fit_forgets_the_first,
    joint_angles_of_another_robot_are_refused,
    no_load_gives_no_deflection,
    diagnostics_can_be_printed,
    intervals_fit_the_rows_and_widen_with_coverage,
    an_interval_does_not_depend_on_the_other_rows,
    save_and_load_give_the_same_numbers,
    fit_and_predict_touch_nothing_else,  # last, when there is something to have been seen
)


def _same(what: str, first: FloatArray, second: FloatArray) -> None:
    if not np.array_equal(first, second):
        raise Failed(f"{what} differs by up to {1e3 * _size(first - second):.3g} mm")


def _same_unless_by_chance(what: str, model: CheckedModel, other: FloatArray) -> None:
    """See that this is the first fit's prediction, where another like it gives the same."""
    first = model.prediction
    if not np.array_equal(first, other) and not np.array_equal(first, model.prediction_again):
        raise NotApplicable("no two of its fits are the same")
    _same(what, first, other)


def _see_no_neighbours(
    what: str,
    together: FloatArray,
    predict: Callable[[FloatArray, FloatArray], FloatArray],
    model: CheckedModel,
) -> None:
    """Predict the test rows one by one and in reverse order: a row must not see the others.

    `together` is (n, k) m, predicted from all n rows at once.
    """
    q, wrench = model.test.q, model.test.wrench
    alone = np.concatenate([predict(q[i : i + 1], wrench[i : i + 1]) for i in range(len(q))])
    backwards = predict(q[::-1], wrench[::-1])[::-1]
    for how, other in (("alone", alone), ("in reverse order", backwards)):
        far = _size(other - together)
        if far > SMALLEST + ROUNDING * _size(together):
            raise Failed(f"{what} predicted {how} differs by up to {1e3 * far:.3g} mm")


def _with_intervals(model: CheckedModel) -> StiffnessModel:
    fitted: StiffnessModel = model.fitted
    if not offers(fitted, "predict_interval"):
        raise NotApplicable("has no predict_interval; split-conformal intervals serve it")
    _ = model.prediction
    return fitted


def _size(values: FloatArray) -> float:
    return float(np.abs(values).max())


def _width(model: CheckedModel, fitted: StiffnessModel) -> float:
    found = model.interval(fitted, model.test.q, model.test.wrench, 0.9)
    return float(np.median(found.upper - found.lower))
