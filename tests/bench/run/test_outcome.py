"""What a model's process sends is believed as far as it can be true, and no further."""

from __future__ import annotations

import pickle
from dataclasses import replace

import numpy as np
import orjson
import pytest

from helpers.run_requests import planned
from stiff_bench.plan.cells import cell_tasks
from stiff_bench.run.cell import fit_task, score
from stiff_bench.run.fit import FitOutcome, fit_and_predict
from stiff_bench.run.outcome import outcome_text, read_outcome
from stiff_protocols.contract.errors import DataError
from stiff_protocols.contract.types import Interval


@pytest.fixture(scope="module")
def task():
    (task,) = cell_tasks(planned(datasets=("fanuc-r2000ic",)))
    return replace(task, cell=replace(task.cell, coverage=0.8))


@pytest.fixture(scope="module")
def fitted(task):
    outcome = fit_and_predict(fit_task(task))
    assert outcome.fitted is not None, outcome.failure
    return outcome.fitted


def test_an_outcome_comes_back_bit_by_bit(fitted):
    curves = {"one": np.array([[1.0, 0.1, np.nan]])}
    sent = replace(fitted, diagnostics={"stiffness": np.inf}, curves=curves)
    found = read_outcome(outcome_text(FitOutcome(sent, warnings=("a word",))))
    assert found.warnings == ("a word",) and found.fitted.cost == sent.cost
    for name in ("predicted", "of_training"):
        assert getattr(found.fitted, name).tobytes() == getattr(sent, name).tobytes()
    assert found.fitted.interval.upper.tobytes() == sent.interval.upper.tobytes()
    assert found.fitted.diagnostics == sent.diagnostics
    np.testing.assert_array_equal(found.fitted.curves["one"], curves["one"])


FAILED = {"failure": "x", "cause": "y", "warnings": []}


@pytest.mark.parametrize(
    "text",
    [
        *(b"", b"rubbish", b"[]", b"null", b"[" * 10_000, pickle.dumps({"fitted": None})),
        *map(orjson.dumps, ({}, {**FAILED, "failure": ""}, {**FAILED, "warnings": [1]})),
        *map(orjson.dumps, ({**FAILED, "fitted": 3}, {**FAILED, "fitted": {"predicted": 1}})),
    ],
)
def test_a_text_that_is_no_outcome_is_refused(text):
    with pytest.raises(DataError, match="its process sent no outcome of a fit"):
        read_outcome(text)


@pytest.mark.parametrize(
    ("path", "forged"),
    [
        *((("predicted",), one) for one in (None, "zero", [[1, 2], [3]], {"x": 1}, 1e400)),
        (("cost",), [1.0]),
        (("cost",), ["x"] * 5),
        (("interval",), [[[1.0] * 3], [[0.0] * 3], 0.8]),
        (("chosen",), {"a": 1}),
        (("diagnostics",), {"a": "many"}),
        (("curves",), {"a": [1.0]}),
        (("calibration_samples",), "many"),
    ],
)
def test_an_entry_of_an_outcome_that_is_none_is_refused(fitted, path, forged):
    content = orjson.loads(outcome_text(FitOutcome(fitted)))
    content["fitted"][path[0]] = forged
    with pytest.raises(DataError, match="its process sent no outcome of a fit"):
        read_outcome(orjson.dumps(content))


@pytest.mark.parametrize(
    "changes",
    [
        {"predicted": np.zeros((1, 3))},
        {"predicted": np.full((9, 3), np.nan)},
        {"of_training": np.zeros((1, 3))},
        {"commands": np.zeros((9, 6))},
        {"interval": Interval(np.zeros((1, 3)), np.ones((1, 3)), 0.8)},
        {"interval": Interval(np.zeros((9, 3)), np.ones((9, 3)), 0.1)},
        {"calibration_samples": 10_000},
        {"curves": {"a": np.zeros((5000, 3))}},
    ],
)
def test_numbers_that_cannot_be_true_fail_the_cell_and_are_named(task, fitted, changes):
    result = score(task, "r", FitOutcome(replace(fitted, **changes)))
    assert (result.status, result.cause) == ("failed", "ModelError") and result.failure
    assert result.prediction is None


def test_costs_that_nothing_can_have_fail_the_cell(task, fitted):
    for changes in ({"fit_s": -1.0}, {"latency_s": np.nan}, {"memory_bytes": -1}):
        cost = fitted.cost._replace(**changes)
        assert score(task, "r", FitOutcome(replace(fitted, cost=cost))).status == "failed"
