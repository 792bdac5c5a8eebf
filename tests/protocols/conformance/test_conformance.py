"""Check that the conformance suite passes valid models and names a broken rule."""

from __future__ import annotations

import re

import numpy as np
import pytest

from helpers.broken_models import (
    BROKEN,
    BROKEN_CHOOSERS,
    CannotFit,
    Noisy,
    Springs,
    broken,
    finding,
    predicting,
    reader,
)
from stiff_protocols.conformance.model_checks import check_model
from stiff_protocols.contract.errors import DataError, NotSavable
from stiff_protocols.contract.types import BenchmarkData


def failures(cls, fanuc, *, uses_validation=False):
    checks = check_model(cls, fanuc, uses_validation=uses_validation, load=reader(cls))
    return [check for check in checks if check.status == "failed"]


def test_a_model_that_keeps_the_contract_passes_every_question(fanuc):
    checks = check_model(Springs, fanuc, uses_validation=False, load=reader(Springs))
    assert {check.name: check.reason for check in checks if check.status != "passed"} == {}


@pytest.mark.parametrize(
    ("cls", "name", "reason", "uses_validation"),
    [(*row, False) for row in BROKEN] + [(*row, True) for row in BROKEN_CHOOSERS],
    ids=[row[0].__name__ for row in BROKEN + BROKEN_CHOOSERS],
)
def test_a_model_that_breaks_one_rule_fails_that_question_with_advice_how_to_fix_it(
    cls, name, reason, uses_validation, fanuc
):
    failed = failures(cls, fanuc, uses_validation=uses_validation)
    if cls is Noisy:  # fits cannot be told apart from predictions that are not repeatable
        by_chance = ("the same", "save", "a prediction", "an interval")
        failed = [check for check in failed if not check.name.startswith(by_chance)]
    assert len(failed) == 1, failed
    assert failed[0].name.startswith(name)
    assert re.search(reason, failed[0].reason), failed[0].reason
    assert failed[0].advice


def test_when_fit_fails_the_questions_that_need_it_are_not_applicable(fanuc):
    checks = check_model(CannotFit, fanuc, uses_validation=False)
    assert [check.status for check in checks].count("failed") == 1
    reasons = [check.reason for check in checks if check.status == "not applicable"]
    assert set(reasons) == {"see 'fit learns from measured rows and returns the model'"}
    assert len(reasons) > 10


def refuse_to_save(self, path):
    raise NotSavable("its weights are not ours")


OFFSET = predicting("Offset", lambda deflection: deflection + 1e-4)
NOMINAL = finding("Nominal", lambda *_: {"compliance_": np.full((6, 3), 1e-6)})
LICENSED = broken("Licensed", save=refuse_to_save)


@pytest.mark.parametrize(
    ("cls", "name", "reason"),
    [
        (OFFSET, "no load gives no deflection", "predicts up to 0.1 mm without load"),
        (NOMINAL, "a fit learns from its own rows", "predicts the same after a fit to other rows"),
        (LICENSED, "save and load give the same numbers", "its weights are not ours"),
    ],
)
def test_what_a_model_may_do_is_said_and_no_failure(cls, name, reason, fanuc):
    checks = {c.name: c for c in check_model(cls, fanuc, uses_validation=False, load=print)}
    assert checks[name].status == "not applicable" and checks[name].reason.startswith(reason)


def test_a_constructor_that_raises_is_one_failure_and_too_few_samples_are_refused(fanuc):
    def refuse():
        raise SystemExit("no display")

    (failed,) = failures(refuse, fanuc)
    assert failed.name == "the constructor takes keywords and only stores them"
    assert "raised SystemExit: no display" in failed.reason
    few = BenchmarkData(fanuc.samples.take(np.arange(9)), fanuc.robot)
    with pytest.raises(DataError, match="9 samples are too few"):
        check_model(Springs, few, uses_validation=False)


@pytest.mark.parametrize(("uses_validation", "n_fits"), [(False, 5), (True, 6)])
def test_a_model_is_fitted_a_few_times_when_nothing_is_wrong(uses_validation, n_fits, fanuc):
    class Counts(Springs):
        fits = 0

        def fit(self, train, **options):
            Counts.fits += 1
            return super().fit(train, **options)

    assert not failures(Counts, fanuc, uses_validation=uses_validation)
    assert Counts.fits == n_fits
