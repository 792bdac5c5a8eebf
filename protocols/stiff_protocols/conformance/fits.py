"""The questions of the conformance suite that compare several fits of a model."""

from __future__ import annotations

import numpy as np

from stiff_protocols.conformance.checklist import Failed, NotApplicable
from stiff_protocols.conformance.checks import NOTHING_TO_SAY, SMALLEST, same, see_no_neighbours
from stiff_protocols.conformance.session import LOUD, Session
from stiff_protocols.contract.interfaces import PredictsInterval
from stiff_protocols.contract.types import FloatArray

COVERAGES = (0.5, 0.95)


def widen(session: Session) -> str:
    """See that intervals have the rows' shape and widen with the coverage."""
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
    return NOTHING_TO_SAY


def row_by_row(session: Session) -> str:
    """Ask for the bounds' distances from the predictions one by one and in reverse order."""
    model = _model(session)

    def around(q: FloatArray, wrench: FloatArray) -> FloatArray:
        # beside the predictions, which are another question's
        found = session.interval(model, q, wrench, COVERAGES[0])
        middle = session.predict(session.fitted, q, wrench)
        return np.hstack([found.lower - middle, found.upper - middle])

    see_no_neighbours(
        "an interval", around(session.test.q, session.test.wrench), around, session.test
    )
    return NOTHING_TO_SAY


def _model(session: Session) -> PredictsInterval:
    model = session.fitted
    if not isinstance(model, PredictsInterval):
        raise NotApplicable("has no predict_interval; split-conformal intervals serve it")
    _ = session.prediction
    return model


GROWN = 10.0
"""So many times the size, and large labels have been learned from."""
_MEND_VALIDATION = "let validation rows choose an epoch, and fit every number to train alone"


def same_seed(session: Session) -> str:
    """Fit a second new model to the same rows."""
    first, again = session.prediction, session.prediction_again(with_validation=True)
    if not session.uses_validation and not np.array_equal(first, again):
        again = session.prediction_again(with_validation=False)  # is it chance, or validation rows?
    same("a second model", first, again)
    return NOTHING_TO_SAY


def leaves_validation(session: Session) -> str:
    """Fit with and without validation rows, or with large ones where they choose an epoch."""
    if session.uses_validation:
        return _only_chooses_on_validation(session)
    first, given = session.prediction, session.prediction_again(with_validation=True)
    if not np.array_equal(first, given):
        if not np.array_equal(first, session.prediction_again(with_validation=False)):
            raise NotApplicable("no two of its fits are the same")
        same("fitted with validation rows, it", first, given)
    return NOTHING_TO_SAY


def _only_chooses_on_validation(session: Session) -> str:
    """See that large validation deflections enlarge neither predictions nor intervals."""
    _ = session.prediction
    first, model = session.fitted, session.fitted_beside_loud_validation
    predicted = session.predict(model, session.other.q, session.other.wrench)
    times = _size(predicted) / max(_size(session.other.deflection), SMALLEST)
    if times > GROWN:
        raise Failed(
            f"with validation deflections x {LOUD:g} it predicts its training rows {times:.0f} "
            "times too large",
            _MEND_VALIDATION,
        )
    if isinstance(first, PredictsInterval) and isinstance(model, PredictsInterval):
        times = _width(session, model) / max(_width(session, first), SMALLEST)
        if times > GROWN:
            raise Failed(
                f"with validation deflections x {LOUD:g} its intervals are {times:.0f} "
                "times as wide",
                _MEND_VALIDATION,
            )
    return "they choose an epoch"


def fits_without_validation(session: Session) -> str:
    """Fit with validation=None, which every protocol may give."""
    _ = session.prediction
    session.predict_test(session.fitted_elsewhere)
    return NOTHING_TO_SAY


def learns_from_its_rows(session: Session) -> str:
    """Compare fits to other rows: an answer that was kept from an earlier fit is the earlier's."""
    first, elsewhere = session.prediction, [session.prediction_elsewhere]
    if session.uses_validation:  # a kept answer may go by whether there are validation rows
        elsewhere.append(session.predict_test(session.fitted_beside_loud_validation))
    if not any(np.array_equal(first, other) for other in elsewhere):
        return NOTHING_TO_SAY
    if _size(session.predict_test(session.fitted_to_loud_rows)) > GROWN * _size(first):
        raise Failed("a new model that is fitted to other rows gives the numbers of the first")
    raise NotApplicable("predicts the same whatever rows it is fitted to")


def forgets(session: Session) -> str:
    """Fit one model to other rows first; it must then equal one that never saw them."""
    first, refitted = session.prediction, session.prediction_after_refit()
    if not np.array_equal(first, refitted):
        again = session.prediction_again(with_validation=session.uses_validation)
        if not np.array_equal(first, again):
            raise NotApplicable("no two of its fits are the same")
        same("a model that was fitted to other rows before", first, refitted)
    return NOTHING_TO_SAY


def keeps_options(session: Session) -> str:
    """Compare the options before and after a fit."""
    before, after = session.options_around_fit
    for name, value in before.items():
        if after.get(name) != value:
            raise Failed(f"fit changes {name} from {value} to {after.get(name, 'nothing')}")
    return NOTHING_TO_SAY


def _size(values: FloatArray) -> float:
    return float(np.abs(values).max())


def _width(session: Session, model: PredictsInterval) -> float:
    found = session.interval(model, session.test.q, session.test.wrench, 0.9)
    return float(np.median(found.upper - found.lower))
