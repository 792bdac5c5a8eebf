"""The questions of the conformance suite for models, one small function each.

The order is the checklist's; questions about what a model does on the side come last, when there
is something to have been seen.
"""

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

from stiff_protocols.conformance.checklist import Failed, NotApplicable
from stiff_protocols.conformance.session import Session
from stiff_protocols.contract.errors import NotFittedError, NotSavable
from stiff_protocols.contract.interfaces import ReportsDiagnostics, SavesItself
from stiff_protocols.contract.types import FloatArray, Samples
from stiff_protocols.scoring.sanity import check_prediction, check_units

ROUNDING = 1e-5
"""Share of the largest prediction by which single precision may change with the batch size."""
SMALLEST = 1e-9  # m; far below what any instrument resolves
NOTHING_TO_SAY = ""


def same(what: str, first: FloatArray, second: FloatArray) -> None:
    """See that two predictions are equal to the bit.

    Raises:
        Failed: they are not.
    """
    if not np.array_equal(first, second):
        far = float(np.abs(first - second).max())
        raise Failed(f"{what} differs by up to {1e3 * far:.3g} mm")


def see_no_neighbours(
    what: str,
    together: FloatArray,
    predict: Callable[[FloatArray, FloatArray], FloatArray],
    rows: Samples,
) -> None:
    """Predict rows one by one and in reverse order: a row must not see the others.

    Args:
        what: name of what is predicted.
        together: (n, k) m, predicted from all rows at once.
        predict: returns (m, k) m for (m, n_joints) q and (m, 6) wrench.
        rows: the n rows.

    Raises:
        Failed: a row's prediction depends on the others.
    """
    q, wrench = rows.q, rows.wrench
    alone = np.concatenate([predict(q[i : i + 1], wrench[i : i + 1]) for i in range(len(q))])
    backwards = predict(q[::-1], wrench[::-1])[::-1]
    for how, other in (("alone", alone), ("in reverse order", backwards)):
        far = float(np.abs(other - together).max())
        if far > SMALLEST + ROUNDING * float(np.abs(together).max()):
            raise Failed(f"{what} predicted {how} differs by up to {1e3 * far:.3g} mm")


def stores_options(session: Session) -> str:
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
    if changed or early:
        raise Failed(
            f"{', '.join(changed)} not stored as given"
            if changed
            else f"{', '.join(early)} is there before fit"
        )
    return NOTHING_TO_SAY


def gives_options_back(session: Session) -> str:
    """Round trip through get_params, set_params and scikit-learn's clone."""
    model = session.new()
    params = model.get_params(deep=False)
    wanted = set(inspect.signature(type(model)).parameters)
    if set(params) != wanted:
        raise Failed(f"get_params names {sorted(params)}, the constructor {sorted(wanted)}")
    if model.set_params(**params) is not model:
        raise Failed("set_params does not return the model")
    copy = clone(model)
    for name, value in params.items():
        if not _same_option(copy.get_params(deep=False)[name], value):
            raise Failed(f"clone changes {name} from {value!r}")
    return NOTHING_TO_SAY


def _same_option(one: object, other: object) -> bool:
    return one is other or repr(one) == repr(other)


def lists_options(session: Session) -> str:
    """See that the command line can read every option's type."""
    cls = type(session.new())
    source: Any = cls if hasattr(cls, "__dataclass_fields__") else cls.__init__
    hints = typing.get_type_hints(source, include_extras=True)
    for name, parameter in inspect.signature(cls).parameters.items():
        plain = isinstance(parameter.default, bool | int | float | str)
        if name not in hints and not plain:
            raise Failed(f"{name} has no annotation and no plain default")
    return NOTHING_TO_SAY


def refuses_before_fit(session: Session) -> str:
    """Predict with a model that was not fitted."""
    model = session.new()
    try:
        session.predict(model, session.test.q, session.test.wrench)
    except (NotFittedError, SklearnNotFittedError):
        return NOTHING_TO_SAY
    except Exception as error:
        raise Failed(f"raised {type(error).__name__}: {error}, expected NotFittedError") from error
    raise Failed("returned numbers")


def fits(session: Session) -> str:
    """Fit for the first time."""
    _ = session.fitted
    n_validation = len(session.validation) if session.uses_validation else 0
    return f"{len(session.train)} training and {n_validation} validation rows"


def fit_returns_model(session: Session) -> str:
    """See that `make().fit(...).predict(...)` can be written."""
    if session.returned_by_fit is not session.fitted:
        raise Failed(f"fit returned {type(session.returned_by_fit).__name__}")
    return NOTHING_TO_SAY


def predicts(session: Session) -> str:
    """Predict rows that were not fitted to."""
    predicted = session.prediction
    if predicted.dtype.kind != "f":
        raise Failed(f"predict returned {predicted.dtype}, expected float64")
    return f"{len(session.test)} rows"


def in_metres(session: Session) -> str:
    """Compare the size of predictions with that of the deflections fitted to."""
    _ = session.prediction
    predicted = session.predict(session.fitted, session.train.q, session.train.wrench)
    check_prediction(predicted, len(session.train))
    check_units(predicted, session.train.deflection)
    return NOTHING_TO_SAY


def row_by_row(session: Session) -> str:
    """Predict the test rows one by one and in reverse order: a row must not see the others."""

    def predicted(q: FloatArray, wrench: FloatArray) -> FloatArray:
        found = session.predict(session.fitted, q, wrench)
        check_prediction(found, len(q))
        return found

    see_no_neighbours("a row", session.prediction, predicted, session.test)
    return NOTHING_TO_SAY


def repeatable(session: Session) -> str:
    """Predict the same rows twice."""
    same("the second prediction", session.prediction, session.predict_test(session.fitted))
    return NOTHING_TO_SAY


def leaves_inputs(session: Session) -> str:
    """Look at the arrays that `predict` was given; those that fit gets are read-only."""
    _ = session.prediction
    if session.overwritten:
        raise Failed(f"predict writes into {' and '.join(sorted(session.overwritten))}")
    return NOTHING_TO_SAY


def refuses_other_robot(session: Session) -> str:
    """Predict at joint angles of a robot with one joint more or less."""
    _ = session.prediction
    q, wrench = session.test.q, session.test.wrench
    for other in (q[:, :-1], np.hstack([q, q[:, :1]])):
        try:
            session.predict(session.fitted, other, wrench)
        except Exception:
            continue
        raise Failed(f"numbers for {other.shape[1]} joints after a fit to {q.shape[1]}")
    return NOTHING_TO_SAY


def nothing_without_load(session: Session) -> str:
    """Say whether no load means no deflection: so it is in physics, learners need not know it."""
    _ = session.prediction
    unloaded = np.zeros_like(session.test.wrench)
    most = float(np.abs(session.predict(session.fitted, session.test.q, unloaded)).max())
    if most > SMALLEST:
        raise NotApplicable(f"predicts up to {1e3 * most:.3g} mm without load")
    return NOTHING_TO_SAY


def diagnostics(session: Session) -> str:
    """See that diagnostics can be printed under a table."""
    model = session.fitted
    if not isinstance(model, ReportsDiagnostics):
        raise NotApplicable("has no diagnostics_")
    if not isinstance(model.diagnostics_, Mapping):
        raise Failed(f"diagnostics_ is a {type(model.diagnostics_).__name__}")
    for name, value in model.diagnostics_.items():
        if not isinstance(name, str):
            raise Failed(f"{name!r} is no name")
        float(value)
    return f"{len(model.diagnostics_)} numbers"


def saves(session: Session) -> str:
    """Write the fitted model, read it, and predict."""
    if not isinstance(session.fitted, SavesItself):
        raise NotApplicable("has no save")
    if session.load is None:
        raise NotApplicable("nothing to read the file with was given")
    first = session.prediction
    with TemporaryDirectory() as folder:
        path = Path(folder) / "model.stiff"
        try:
            session.fitted.save(path)
        except NotSavable as error:
            raise NotApplicable(str(error)) from error
        loaded = session.load(path)
    same("the model read from its file", first, session.predict_test(loaded))
    return NOTHING_TO_SAY


def silent(session: Session) -> str:
    """Look at what went to standard output, which belongs to the tables."""
    _ = session.prediction
    if session.printed:
        raise Failed(f"printed {session.printed.strip().splitlines()[0][:60]!r} and the like")
    return NOTHING_TO_SAY


def leaves_random_state(session: Session) -> str:
    """Look at the global random states, which belong to everybody."""
    _ = session.prediction
    if session.disturbed:
        raise Failed(f"changes the global random state of {', '.join(sorted(session.disturbed))}")
    return NOTHING_TO_SAY
