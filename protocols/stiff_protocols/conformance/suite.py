"""The conformance suite: what a model must do before its row in a table means anything.

Whatever a model raises is the answer to one question, and the suite goes on. The questions about
what a model does on the side come last, when there is something to have been seen.
`conformance.data` does the same for data sets and protocols.
"""

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

from stiff_protocols.conformance.checklist import Check, Checklist, Failed, NotApplicable
from stiff_protocols.conformance.session import LOUD, SMALLEST, Session, options
from stiff_protocols.contract.errors import NotFittedError, NotSavable
from stiff_protocols.contract.stiffness_model import StiffnessModel, offers
from stiff_protocols.contract.types import BenchmarkData, FloatArray, Samples
from stiff_protocols.scoring.sanity import check_units

__all__ = ["Check", "check_model"]

ROUNDING = 1e-5
"""Share of the largest prediction by which single precision may change with the batch size."""
NEAR_BAIT = 0.5
"""A share of their size: no model comes nearer to deflections that follow from nothing."""
GROWN = 10.0
"""So many times the size, and large labels have been learned from."""
COVERAGES = (0.5, 0.95)

_MEND_SEED = "draw all chance from `seed`: rng = np.random.default_rng(seed)"
_MODEL = Checklist()


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
    session = Session(make, data, uses_validation=uses_validation, save=save, load=load)
    return _MODEL.answers(session)


@_MODEL.asks(
    "the constructor takes keywords and only stores them", "leave checks and conversions to fit"
)
def _stores_options(session: Session) -> None:
    """Give the constructor objects that only an assignment leaves alone."""
    model = session.new()
    parameters = inspect.signature(type(model)).parameters.values()
    loose = [p.name for p in parameters if p.kind is not inspect.Parameter.KEYWORD_ONLY]
    if loose:
        raise Failed(
            f"{', '.join(loose)} can be given without a name",
            "write def __init__(self, *, ...): with a star before the first option",
        )
    given = {name: object() for name in model.get_params(deep=False)}
    made = type(model)(**given)
    changed = [name for name, value in given.items() if getattr(made, name, None) is not value]
    early = [name for name in vars(made) if name.endswith("_") and not name.startswith("_")]
    if changed:
        raise Failed(f"{', '.join(changed)} not stored as given")
    if early:
        raise Failed(f"{', '.join(early)} is there before fit")


@_MODEL.asks(
    "get_params, set_params and clone give the options back",
    "inherit sklearn.base.BaseEstimator and store every option under its own name",
)
def _gives_options_back(session: Session) -> None:
    model = session.new()
    params = model.get_params(deep=False)
    wanted = set(inspect.signature(type(model)).parameters)
    if set(params) != wanted:
        raise Failed(f"get_params names {sorted(params)}, the constructor {sorted(wanted)}")
    if model.set_params(**params) is not model:
        raise Failed("set_params does not return the model")
    copy = clone(model)
    for name, value in params.items():
        copied = copy.get_params(deep=False)[name]
        if copied is not value and repr(copied) != repr(value):
            raise Failed(f"clone changes {name} from {value!r}")


@_MODEL.asks(
    "options can be listed",
    "annotate every option with a type that can be imported, or give it a plain default",
)
def _lists_options(session: Session) -> None:
    cls = type(session.new())
    source: Any = cls if hasattr(cls, "__dataclass_fields__") else cls.__init__
    hints = typing.get_type_hints(source, include_extras=True)
    for name, parameter in inspect.signature(cls).parameters.items():
        plain = isinstance(parameter.default, bool | int | float | str)
        if name not in hints and not plain:
            raise Failed(f"{name} has no annotation and no plain default")


@_MODEL.asks(
    "predict before fit is refused",
    "begin predict with sklearn.utils.validation.check_is_fitted(self)",
)
def _refuses_before_fit(session: Session) -> None:
    model = session.new()
    try:
        session.predict(model, session.test.q, session.test.wrench)
    except (NotFittedError, SklearnNotFittedError):
        return
    except Exception as error:
        raise Failed(f"raised {type(error).__name__}: {error}, expected NotFittedError") from error
    raise Failed("returned numbers")


@_MODEL.asks(
    "fit learns from measured rows",
    "the reason is the exception of your fit; call fit in Python to see where it comes from",
)
def _fits(session: Session) -> str:
    _ = session.fitted
    n_validation = len(session.validation) if session.uses_validation else 0
    return f"{len(session.train)} training and {n_validation} validation rows"


@_MODEL.asks("fit returns the model", "end fit with: return self")
def _fit_returns_model(session: Session) -> None:
    if session.fitted is not session.returned_by_fit:
        raise Failed(f"fit returned {type(session.returned_by_fit).__name__}")


@_MODEL.asks(
    "fit leaves the options alone",
    "keep what fit makes of an option under another name, one that ends in _",
)
def _keeps_options(session: Session) -> None:
    after = options(session.fitted)
    for name, value in session.options_before_fit.items():
        if after.get(name) != value:
            raise Failed(f"fit changes {name} from {value} to {after.get(name, 'nothing')}")


@_MODEL.asks(
    "predict returns (n, 3) finite numbers", "return a float64 array, one row a sample: x, y, z"
)
def _predicts(session: Session) -> str:
    predicted = session.prediction
    if predicted.dtype.kind != "f":
        raise Failed(f"predict returned {predicted.dtype}, expected float64")
    return f"{len(session.test)} rows"


@_MODEL.asks(
    "predictions come from what the model was given",
    "predict from q, wrench and what fit has learned; a run holds test deflections elsewhere",
)
def _takes_no_label(session: Session) -> None:
    """Compare with the deflections that lie about in this process."""
    predicted, bait = session.prediction, session.test.deflection
    is_bait = _size(predicted - bait) < NEAR_BAIT * _size(bait)
    measured = session.measured
    if is_bait or (measured.any() and np.array_equal(predicted, measured)):
        raise Failed("predict returns the deflections of the test rows, which it was not given")


@_MODEL.asks("predictions are in metres", "train.deflection is in m; predict the same unit")
def _in_metres(session: Session) -> None:
    _ = session.prediction
    predicted = session.predict_checked(session.fitted, session.train.q, session.train.wrench)
    check_units(predicted, session.train.deflection)


@_MODEL.asks(
    "a row's prediction does not depend on the other rows",
    "take means, scales and neighbours in fit from train, never in predict: that is a leak",
)
def _row_by_row(session: Session) -> None:
    predict = partial(session.predict_checked, session.fitted)
    _see_no_neighbours("a row", session.prediction, predict, session.test)


@_MODEL.asks(
    "predicting twice gives the same numbers", "leave chance to fit; switch a network to eval mode"
)
def _repeatable(session: Session) -> None:
    _same("the second prediction", session.prediction, session.predict_test(session.fitted))


@_MODEL.asks("predict leaves its inputs alone", "copy an array before you change it")
def _leaves_inputs(session: Session) -> None:
    """Look at the arrays that `predict` was given; those that fit gets are read-only."""
    _ = session.prediction
    if session.overwritten:
        raise Failed(f"predict writes into {' and '.join(sorted(session.overwritten))}")


@_MODEL.asks("the same seed gives the same model", _MEND_SEED)
def _same_seed(session: Session) -> None:
    first, again = session.prediction, session.prediction_again(with_validation=True)
    if not session.uses_validation and not np.array_equal(first, again):
        again = session.prediction_again(with_validation=False)  # is it chance, or validation rows?
    _same("a second model", first, again)


@_MODEL.asks(
    "validation rows are not learned from",
    "ignore `validation`, or say uses_validation=True in the ModelInfo",
)
def _leaves_validation(session: Session) -> str:
    """Fit with and without validation rows, or with large ones where they choose an epoch."""
    if session.uses_validation:
        _only_chooses_on_validation(session)
        return "they choose an epoch"
    _ = session.prediction
    given = session.prediction_again(with_validation=True)
    _same_unless_by_chance("fitted with validation rows, it", session, given)
    return ""


@_MODEL.asks("fits without validation rows", "validation may be None: keep the last epoch then")
def _fits_without_validation(session: Session) -> None:
    _ = session.prediction
    session.predict_test(session.fitted_elsewhere)


@_MODEL.asks(
    "a fit learns from its own rows",
    "a fit that is remembered must be remembered by its rows too, not by its seed alone",
)
def _learns_from_its_rows(session: Session) -> None:
    """Compare fits to other rows: an answer that was kept from an earlier fit is the earlier's."""
    first, elsewhere = session.prediction, [session.prediction_elsewhere]
    if session.uses_validation:  # a kept answer may go by whether there are validation rows
        elsewhere.append(session.predict_test(session.fitted_beside_loud_validation))
    if not any(np.array_equal(first, other) for other in elsewhere):
        return
    if _size(session.predict_test(session.fitted_to_loud_rows)) > GROWN * _size(first):
        raise Failed("a new model that is fitted to other rows gives the numbers of the first")
    raise NotApplicable("predicts the same whatever rows it is fitted to")


@_MODEL.asks("a second fit forgets the first", "compute every attribute that ends in _ anew in fit")
def _forgets(session: Session) -> None:
    """Fit one model to other rows first; it must then equal one that never saw them."""
    _ = session.prediction
    refitted = session.prediction_after_refit()
    _same_unless_by_chance("a model that was fitted to other rows before", session, refitted)


@_MODEL.asks(
    "joint angles of another robot are refused",
    "keep the number of joints in fit and raise ValueError if q.shape[1] is another",
)
def _refuses_other_robot(session: Session) -> None:
    _ = session.prediction
    q, wrench = session.test.q, session.test.wrench
    for other in (q[:, :-1], np.hstack([q, q[:, :1]])):
        try:
            session.predict(session.fitted, other, wrench)
        except Exception:
            continue
        raise Failed(f"numbers for {other.shape[1]} joints after a fit to {q.shape[1]}")


@_MODEL.asks("no load, no deflection", "predict finite numbers")
def _nothing_without_load(session: Session) -> None:
    """Say whether no load means no deflection: so it is in physics, learners need not know it."""
    _ = session.prediction
    unloaded = np.zeros_like(session.test.wrench)
    most = float(np.abs(session.predict(session.fitted, session.test.q, unloaded)).max())
    if most > SMALLEST:
        raise NotApplicable(f"predicts up to {1e3 * most:.3g} mm without load")


@_MODEL.asks(
    "diagnostics can be printed", "make diagnostics_ a dict of names with units and numbers"
)
def _diagnostics(session: Session) -> str:
    model = session.fitted
    if not hasattr(model, "diagnostics_"):
        raise NotApplicable("has no diagnostics_")
    if not isinstance(model.diagnostics_, Mapping):
        raise Failed(f"diagnostics_ is a {type(model.diagnostics_).__name__}")
    for name, value in model.diagnostics_.items():
        if not isinstance(name, str):
            raise Failed(f"{name!r} is no name")
        float(value)
    return f"{len(model.diagnostics_)} numbers"


@_MODEL.asks(
    "intervals fit the rows and widen with coverage",
    "return contract.types.Interval(lower, upper, coverage) with (n, 3) bounds in m",
)
def _intervals_widen(session: Session) -> None:
    model = _model(session)
    q, wrench = session.test.q, session.test.wrench
    widths = []
    for coverage in COVERAGES:
        found = session.interval(model, q, wrench, coverage)
        if found.lower.shape != (len(q), 3) or found.coverage != coverage:
            raise Failed(
                f"interval of shape {found.lower.shape} and coverage {found.coverage}, expected "
                f"({len(q)}, 3) and {coverage}"
            )
        widths.append(found.upper - found.lower)
    if (widths[1] < widths[0]).any():
        raise Failed("an interval of coverage 0.95 is narrower than that of 0.5")


@_MODEL.asks(
    "a row's interval does not depend on the other rows",
    "take scales and quantiles in fit from train, never in predict_interval: that is a leak",
)
def _interval_row_by_row(session: Session) -> None:
    """Ask for the bounds' distances from the predictions one by one and in reverse order."""
    model = _model(session)

    def around(q: FloatArray, wrench: FloatArray) -> FloatArray:
        # beside the predictions, which are another question's
        found = session.interval(model, q, wrench, COVERAGES[0])
        middle = session.predict(session.fitted, q, wrench)
        return np.hstack([found.lower - middle, found.upper - middle])

    _see_no_neighbours(
        "an interval", around(session.test.q, session.test.wrench), around, session.test
    )


@_MODEL.asks(
    "save and load give the same numbers", "keep what predict needs in attributes that end in _"
)
def _saves(session: Session) -> None:
    model, save, load = session.fitted, session.save, session.load
    save_itself = model.save if offers(model, "save") else None
    if load is None or (save is None and save_itself is None):
        raise NotApplicable("not checked here; `bench check` saves and loads as `bench fit` does")
    first = session.prediction
    with TemporaryDirectory() as folder:
        path = Path(folder) / "model.stiff"
        try:
            if save is not None:
                save(model, path)
            elif save_itself is not None:
                save_itself(path)
        except NotSavable as error:
            raise NotApplicable(str(error)) from error
        loaded = load(path)
    _same("the model read from its file", first, session.predict_test(loaded))


@_MODEL.asks("prints nothing", "use stiff_protocols.contract.progress.report or logging")
def _silent(session: Session) -> None:
    _ = session.prediction
    if session.printed:
        raise Failed(f"printed {session.printed.strip().splitlines()[0][:60]!r} and the like")


@_MODEL.asks("leaves global random states alone", _MEND_SEED)
def _leaves_random_state(session: Session) -> None:
    _ = session.prediction
    if session.disturbed:
        raise Failed(f"changes the global random state of {', '.join(sorted(session.disturbed))}")


@_MODEL.asks(
    "keeps stiffbench's own functions", "inherit from a class of ours, or wrap its function"
)
def _leaves_our_functions(session: Session) -> None:
    _ = session.prediction
    if names := sorted(session.restored()):
        raise Failed(f"replaces {names[0]}" + (f" and {len(names) - 1} more" * (len(names) > 1)))


def _same(what: str, first: FloatArray, second: FloatArray) -> None:
    if not np.array_equal(first, second):
        far = float(np.abs(first - second).max())
        raise Failed(f"{what} differs by up to {1e3 * far:.3g} mm")


def _same_unless_by_chance(what: str, session: Session, other: FloatArray) -> None:
    """See that this is the first fit's prediction, where another like it gives the same."""
    first = session.prediction
    if np.array_equal(first, other):
        return
    if not np.array_equal(first, session.prediction_again(with_validation=session.uses_validation)):
        raise NotApplicable("no two of its fits are the same")
    _same(what, first, other)


def _see_no_neighbours(
    what: str,
    together: FloatArray,
    predict: Callable[[FloatArray, FloatArray], FloatArray],
    rows: Samples,
) -> None:
    """Predict rows one by one and in reverse order: a row must not see the others.

    `together` is (n, k) m, predicted from all n rows at once.
    """
    q, wrench = rows.q, rows.wrench
    alone = np.concatenate([predict(q[i : i + 1], wrench[i : i + 1]) for i in range(len(q))])
    backwards = predict(q[::-1], wrench[::-1])[::-1]
    for how, other in (("alone", alone), ("in reverse order", backwards)):
        far = float(np.abs(other - together).max())
        if far > SMALLEST + ROUNDING * float(np.abs(together).max()):
            raise Failed(f"{what} predicted {how} differs by up to {1e3 * far:.3g} mm")


def _only_chooses_on_validation(session: Session) -> None:
    """See that large validation deflections enlarge neither predictions nor intervals."""
    _ = session.prediction
    first, model = session.fitted, session.fitted_beside_loud_validation
    predicted = session.predict(model, session.other.q, session.other.wrench)
    times = _size(predicted) / max(_size(session.other.deflection), SMALLEST)
    found = f"it predicts its training rows {times:.0f} times too large"
    if times <= GROWN and offers(first, "predict_interval") and offers(model, "predict_interval"):
        times = _width(session, model) / max(_width(session, first), SMALLEST)
        found = f"its intervals are {times:.0f} times as wide"
    if times > GROWN:
        raise Failed(
            f"with validation deflections x {LOUD:g} {found}",
            "let validation rows choose an epoch, and fit every number to train alone",
        )


def _model(session: Session) -> StiffnessModel:
    model = session.fitted
    if not offers(model, "predict_interval"):
        raise NotApplicable("has no predict_interval; split-conformal intervals serve it")
    _ = session.prediction
    return model


def _size(values: FloatArray) -> float:
    return float(np.abs(values).max())


def _width(session: Session, model: StiffnessModel) -> float:
    found = session.interval(model, session.test.q, session.test.wrench, 0.9)
    return float(np.median(found.upper - found.lower))
