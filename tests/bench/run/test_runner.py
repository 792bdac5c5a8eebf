"""One fit: intervals, units, unavailable models, and shared seeds."""

from __future__ import annotations

import os
import sys
import time
import types
from dataclasses import replace

import numpy as np
import pytest
from sklearn.base import BaseEstimator

from helpers.broken_models import Converts, Springs, broken, predicting
from helpers.run_requests import computed, planned, with_model
from stiff_bench.plan.fits import fit_tasks
from stiff_bench.plan.registry import build_registry
from stiff_bench.run.execution import compute_fit
from stiff_bench.run.fit import CURVE_POINTS
from stiff_bench.store.database import ResultStore
from stiff_models.physics.vjm import VirtualJointModel
from stiff_protocols.contract.errors import ConfigError
from stiff_protocols.contract.plugin import ProtocolInfo
from stiff_protocols.contract.types import Interval, Split
from stiff_protocols.scoring.metrics import METRICS

FITS = []
MIB = 2**20


class Scaled(BaseEstimator):
    """Predicts training rows times a factor, and their mean elsewhere."""

    def __init__(self, factor: float = 1.0):
        self.factor = factor

    def fit(self, train, *, robot, validation=None, seed=0):
        FITS.append((train, validation, seed))
        self.train_ = train
        return self

    def predict(self, q, wrench):
        is_training_row = (q[:, None, :] == self.train_.q).all(axis=2)
        nearest = self.train_.deflection[is_training_row.argmax(axis=1)]
        mean = self.train_.deflection.mean(axis=0)
        return self.factor * np.where(is_training_row.any(axis=1)[:, None], nearest, mean)


class Sure(Scaled):
    """Predicts its own intervals."""

    def predict_interval(self, q, wrench, coverage):
        predicted = self.predict(q, wrench)
        return Interval(predicted - coverage, predicted + coverage, coverage)


@pytest.fixture()
def task_of(tasks_of):
    """A function that returns a FANUC fit with a given model class."""

    def make(cls, coverage=None, protocol="holdout", model="vjm", **params):
        task = tasks_of((model,), "fanuc-r2000ic", protocol)[0]
        task = replace(task, fit=replace(task.fit, coverage=coverage))
        return with_model(task, cls, **params)

    FITS.clear()
    return make


def values(result, metric):
    return [*METRICS[metric].of_result(result).values()]


def test_split_conformal_intervals_do_not_change_the_point_metrics(task_of):
    plain = computed(task_of(Scaled))
    assert plain.prediction.interval is None and len(FITS) == 1
    absent_metrics = {metric.key for metric in METRICS.values() if metric.needs_interval}
    absent_metrics |= {"true-norm", "true-p95", "drawn-norm"}  # the data are measured
    assert {key for key in METRICS if values(plain, key)} == set(METRICS) - absent_metrics
    result = computed(task_of(Scaled, 0.9))
    np.testing.assert_array_equal(result.prediction.predicted, plain.prediction.predicted)
    assert values(result, "mae") == values(plain, "mae")
    assert result.calibration_samples == 9  # of the 34 poses of the training side
    assert sorted(len(train) for train, _, _ in FITS) == [25, 34, 34]
    interval, measured = result.prediction.interval, result.prediction.measured
    inside = (interval.lower <= measured) & (measured <= interval.upper)
    assert values(result, "coverage") == list(inside.mean(axis=0))
    assert values(result, "width") == list((interval.upper - interval.lower).mean(axis=0))


def test_a_model_with_intervals_of_its_own_is_fitted_once(task_of):
    result = computed(task_of(Sure, 0.75))
    assert result.calibration_samples == 0 and len(FITS) == 1
    assert values(result, "width") == pytest.approx([1.5] * 3)
    assert values(result, "coverage") == [1.0] * 3


def test_rows_that_choose_an_epoch_are_given_to_both_fits_and_calibrate_nothing(task_of):
    result = computed(task_of(Scaled, 0.9, model="ft-mlp@training=best"))
    (first, validation, _), (second, also, _) = FITS
    assert len(first) == 27 and len(second) == 27 - result.calibration_samples == 18
    np.testing.assert_array_equal(validation.deflection, also.deflection)
    assert len(validation) == 7


def test_a_training_side_too_small_for_the_coverage_keeps_the_point_metrics_and_says_why(task_of):
    result = computed(task_of(Scaled, 0.95))
    assert len(FITS) == 1
    assert result.prediction.interval is None and values(result, "mae")
    assert not values(result, "coverage")
    (warning,) = result.warnings
    assert warning.startswith("no intervals: coverage 0.95 needs at least 19 calibration samples")
    assert "half of the 34 training poses are 17" in warning


CHANGES = {
    "rows predicted again": lambda predicted: predicted - predicted.mean(axis=0),
    "in reverse order": lambda predicted: (
        predicted * np.linspace(1.0, 2.0, len(predicted))[:, None]
    ),
    "differ by up to": lambda predicted: predicted + np.random.default_rng().normal(size=(1, 3)),
    "int64": lambda predicted: predicted.astype(np.int64),
}


@pytest.mark.parametrize("words", CHANGES)
def test_predictions_that_bench_check_refuses_fail_in_a_run_too(task_of, words):
    result = compute_fit(task_of(predicting("Odd", CHANGES[words])), "r")
    assert result.status == "failed" and words in result.failure


def test_a_model_that_fit_does_not_return_or_whose_option_changes_fails_in_a_run_too(task_of):
    silent = broken(
        "Silent", fit=lambda self, train, **options: Springs.fit(self, train, **options) and None
    )
    assert "return self" in compute_fit(task_of(silent), "r").failure
    result = compute_fit(task_of(Converts, scale=2), "r")
    assert result.status == "failed" and "scale from 2 to 2.0" in result.failure


def test_the_reference_is_a_vjm_identified_on_the_same_training_side(task_of):
    task = task_of(Scaled)
    result = computed(task)
    ours = computed(replace(task, model=task_of(VirtualJointModel).model))
    np.testing.assert_array_equal(result.prediction.reference, ours.prediction.predicted)
    assert values(ours, "skill") == [0.0] and values(result, "skill")[0] < 0.0


@pytest.mark.slow
def test_costs_are_measured_and_a_slow_model_does_not_predict_a_thousand_rows(task_of):
    row_counts = []

    class Slow(Scaled):
        def fit(self, train, *, robot, validation=None, seed=0):
            time.sleep(0.03)
            self.held = np.ones(190 * MIB // 8)  # more than earlier tests leave to be freed
            return super().fit(train, robot=robot, validation=validation, seed=seed)

        def predict(self, q, wrench):
            row_counts.append(len(q))
            time.sleep(0.02 + 0.001 * len(q))
            return super().predict(q, wrench)

    cost = computed(task_of(Slow)).cost
    assert max(row_counts) < 100
    assert cost.fit_s > 0.03 and cost.predict_s > 0.028
    assert 0.021 < cost.latency_s < cost.predict_s
    assert 30 < cost.throughput_per_s < 1000
    assert cost.memory_bytes is None or cost.memory_bytes > 100 * MIB


class Curved(Scaled):
    """Has a given training curve."""

    def __init__(self, curve):
        super().__init__()
        self.curves_ = {"training": curve}


def test_a_long_curve_is_thinned_to_points_of_its_own_with_both_ends(task_of):
    steps = np.arange(12_345)
    full_curve = np.column_stack([steps, 1.0 / (1 + steps), np.full(len(steps), np.nan)])
    thinned_curve = computed(task_of(Curved, curve=full_curve)).curves["training"]
    assert thinned_curve.shape == (CURVE_POINTS, 3)
    np.testing.assert_array_equal(thinned_curve[[0, -1]], full_curve[[0, -1]])
    np.testing.assert_array_equal(thinned_curve, full_curve[thinned_curve[:, 0].astype(int)])
    assert np.ptp(np.diff(thinned_curve[:, 0])) <= 1.0


@pytest.mark.parametrize(("factor", "part"), [(1e3, "are these mm?"), (1e-3, "times smaller")])
def test_a_model_a_thousand_times_off_fails_and_is_told_the_unit(task_of, factor, part):
    result = compute_fit(task_of(Scaled, factor=factor), "r")
    assert result.status == "failed" and part in result.failure and "expected m" in result.failure


def test_a_model_that_cannot_be_used_here_is_skipped_with_the_reason(task_of, monkeypatch):
    absent = types.SimpleNamespace(reason=lambda: "no weights here")
    monkeypatch.setitem(sys.modules, "my_weights", absent)
    task = task_of(Scaled)
    info = replace(task.model.info, missing_because="my_weights:reason")
    result = compute_fit(replace(task, model=replace(task.model, info=info)), "r")
    assert result.status == "skipped" and result.failure == "no weights here"
    assert result.prediction is None and not FITS


def test_a_model_whose_prediction_draws_gives_the_same_interval_however_often_it_is_timed(
    task_of, monkeypatch
):
    class Drawing(Sure):
        def fit(self, *args, **options):
            self.rng_ = np.random.default_rng(0)
            return super().fit(*args, **options)

        def predict_interval(self, q, wrench, coverage):
            middle = super().predict(q, wrench) + self.rng_.normal(size=(len(q), 3))
            return Interval(middle - 1.0, middle + 1.0, coverage)

        def predict(self, q, wrench):
            self.rng_.normal()
            return super().predict(q, wrench)

    first = computed(task_of(Drawing, 0.8))
    monkeypatch.setattr("stiff_bench.run.fit.MOST_SINGLE_PREDICTIONS", 3)
    again = computed(task_of(Drawing, 0.8))
    np.testing.assert_array_equal(first.prediction.interval.lower, again.prediction.interval.lower)


def plan(metrics=("mae",), coverage=None, protocol="holdout", registry=None):
    words = {"datasets": ("fanuc-r2000ic",), "protocols": (protocol,)}
    return planned(registry, metrics=metrics, coverage=coverage, **words)


def test_intervals_are_computed_only_for_a_metric_that_needs_them():
    assert plan(("mae",)).coverage is None
    assert plan(("mae", "width")).coverage == 0.9
    assert plan(("coverage",), 0.8).coverage == 0.8


@pytest.mark.parametrize(
    ("metric", "coverage", "part"),
    [
        ("mae", 0.8, "add the metric coverage"),
        ("width", 1.0, "between 0 and 1"),
        ("width", float("nan"), "between 0 and 1"),
    ],
)
def test_a_coverage_that_means_nothing_is_refused(metric, coverage, part):
    with pytest.raises(ConfigError, match=part):
        plan((metric,), coverage)


def test_what_a_model_prints_goes_to_standard_error(task_of, capfd):
    class Prints(Scaled):
        def predict(self, q, wrench):
            print("from Python")
            os.write(1, b"from C\n")
            return super().predict(q, wrench)

    computed(task_of(Prints))
    output = capfd.readouterr()
    assert output.out == "" and "from Python" in output.err and "from C" in output.err


def tasks_under(splits):
    """Return the fits of a third-party protocol with these splits."""

    class ThirdPartyProtocol:
        selects_on_test = pooled = False

        def splits(self, samples, *, n_splits, seed):
            return splits()

    registry = build_registry()
    registry.protocols["theirs"] = ProtocolInfo(key="theirs", target=ThirdPartyProtocol, summary="")
    return list(fit_tasks(plan(protocol="theirs", registry=registry)))


def a_split(train, test):
    return Split(0, np.asarray(train), np.empty(0, dtype=int), np.asarray(test))


@pytest.mark.parametrize(
    ("splits", "message"),
    [
        (lambda: [a_split(range(43), range(-8, 0))], "split 0 has test rows outside 0..42"),
        (lambda: {}["x"], "KeyError: 'x'"),
    ],
)
def test_a_protocol_that_leaks_by_negative_rows_or_raises_is_refused_by_name(splits, message):
    with pytest.raises(ConfigError, match=f"protocol 'theirs': {message}"):
        tasks_under(splits)


@pytest.mark.parametrize(
    ("answer", "part"),
    [
        (np.zeros((9, 2)), "returned ndarray, expected Interval"),
        (Interval(np.zeros((1, 3)), np.ones((1, 3)), 0.9), "returned 1 intervals of coverage 0.9"),
        (Interval(np.zeros((9, 3)), np.ones((9, 3)), 0.1), "expected 9 of coverage 0.9"),
    ],
)
def test_an_interval_that_is_none_is_a_failure(task_of, answer, part):
    class Odd(Scaled):
        def predict_interval(self, q, wrench, coverage):
            return answer

    result = compute_fit(task_of(Odd, 0.9), "r")
    assert (result.status, result.cause) == ("failed", "ModelError")
    assert part in result.failure


@pytest.mark.parametrize("wrong", [np.zeros((5, 2)), "none", [[1, 2, 3], [1]]])
def test_an_invalid_curve_fails_the_cell_and_is_named(task_of, wrong):
    result = compute_fit(task_of(Curved, curve=wrong), "r")
    assert (result.status, result.cause) == ("failed", "ModelError")
    assert result.failure.startswith("curves_['training'] is not an (n, 3) array")


def test_an_option_that_is_infinite_can_be_stored(tasks_of, tmp_path):
    key = "sklearn:linear_model.RANSACRegressor"  # stop_score=inf
    task = tasks_of((key,), "fanuc-r2000ic")[0]
    store = ResultStore(tmp_path)
    store.write_fits([computed(task)])
    assert store.result(task.fit.key).fit.model_params["stop_score"] == "inf"
