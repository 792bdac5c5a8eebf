"""The conformance suite: what a model must do before its row in a table means anything.

Nothing here trusts the model: whatever it raises is the answer to one question, and the suite goes
on. `conformance_data` does the same for data sets and protocols.
"""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

from stiff_protocols.conformance import checks as ask
from stiff_protocols.conformance import fits
from stiff_protocols.conformance import fits as intervals
from stiff_protocols.conformance.checklist import Check, Question, answers
from stiff_protocols.conformance.session import Session
from stiff_protocols.contract.interfaces import StiffnessModel
from stiff_protocols.contract.types import BenchmarkData

__all__ = ["Check", "check_model"]

_MEND_SEED = "draw all chance from `seed`: rng = np.random.default_rng(seed)"
_MODEL_QUESTIONS: tuple[Question[Session], ...] = (
    Question(
        "the constructor takes keywords and only stores them",
        ask.stores_options,
        "leave checks and conversions to fit",
    ),
    Question(
        "get_params, set_params and clone give the options back",
        ask.gives_options_back,
        "inherit sklearn.base.BaseEstimator and store every option under its own name",
    ),
    Question(
        "options can be listed",
        ask.lists_options,
        "annotate every option with a type that can be imported, or give it a plain default",
    ),
    Question(
        "predict before fit is refused",
        ask.refuses_before_fit,
        "begin predict with sklearn.utils.validation.check_is_fitted(self)",
    ),
    Question(
        "fit learns from measured rows",
        ask.fits,
        "the reason is the exception of your fit; call fit in Python to see where it comes from",
    ),
    Question("fit returns the model", ask.fit_returns_model, "end fit with: return self"),
    Question(
        "fit leaves the options alone",
        fits.keeps_options,
        "keep what fit makes of an option under another name, one that ends in _",
    ),
    Question(
        "predict returns (n, 3) finite numbers",
        ask.predicts,
        "return a float64 array, one row a sample: x, y, z",
    ),
    Question(
        "predictions are in metres",
        ask.in_metres,
        "train.deflection is in m; predict the same unit",
    ),
    Question(
        "a row's prediction does not depend on the other rows",
        ask.row_by_row,
        "take means, scales and neighbours in fit from train, never in predict: that is a leak",
    ),
    Question(
        "predicting twice gives the same numbers",
        ask.repeatable,
        "leave chance to fit; switch a network to eval mode",
    ),
    Question(
        "predict leaves its inputs alone",
        ask.leaves_inputs,
        "copy an array before you change it",
    ),
    Question("the same seed gives the same model", fits.same_seed, _MEND_SEED),
    Question(
        "validation rows are not learned from",
        fits.leaves_validation,
        "ignore `validation`, or say uses_validation=True in the ModelInfo",
    ),
    Question(
        "fits without validation rows",
        fits.fits_without_validation,
        "validation may be None: keep the last epoch then",
    ),
    Question(
        "a fit learns from its own rows",
        fits.learns_from_its_rows,
        "a fit that is remembered must be remembered by its rows too, not by its seed alone",
    ),
    Question(
        "a second fit forgets the first",
        fits.forgets,
        "compute every attribute that ends in _ anew in fit",
    ),
    Question(
        "joint angles of another robot are refused",
        ask.refuses_other_robot,
        "keep the number of joints in fit and raise ValueError if q.shape[1] is another",
    ),
    Question("no load, no deflection", ask.nothing_without_load, "predict finite numbers"),
    Question(
        "diagnostics can be printed",
        ask.diagnostics,
        "make diagnostics_ a dict of names with units and numbers",
    ),
    Question(
        "intervals fit the rows and widen with coverage",
        intervals.widen,
        "return contract.types.Interval(lower, upper, coverage) with (n, 3) bounds in m",
    ),
    Question(
        "a row's interval does not depend on the other rows",
        intervals.row_by_row,
        "take scales and quantiles in fit from train, never in predict_interval: that is a leak",
    ),
    Question(
        "save and load give the same numbers",
        ask.saves,
        "keep what predict needs in attributes that end in _",
    ),
    Question(
        "prints nothing", ask.silent, "use stiff_protocols.contract.progress.report or logging"
    ),
    Question("leaves global random states alone", ask.leaves_random_state, _MEND_SEED),
)


def check_model(
    make: Callable[[], StiffnessModel],
    data: BenchmarkData,
    *,
    uses_validation: bool,
    load: Callable[[Path], StiffnessModel] | None = None,
) -> list[Check]:
    """Check a model on a small data set.

    It is fitted four times, five times if it uses validation rows, and once or twice more where
    fits are the same that should differ, or differ that should be the same.

    Args:
        make: returns a new model with the options to be checked; the class itself will do.
        data: at least 10 samples, of which 48 at most are used, and their robot.
        uses_validation: as in the model's `ModelInfo`.
        load: reads a file that the model's `save` wrote (`stiff_models.load`); None: the round
            trip is not checked.

    Raises:
        DataError: `data` has too few samples.
    """
    session = Session(make, data, uses_validation=uses_validation, load=load)
    return answers(_MODEL_QUESTIONS, session)
