"""Check the metrics against numbers computed by hand."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from sklearn.metrics import r2_score

from stiff_protocols.contract.errors import ConfigError
from stiff_protocols.contract.record import Cost
from stiff_protocols.contract.types import Interval, Prediction
from stiff_protocols.scoring.metrics import METRICS, metric


@pytest.fixture()
def prediction() -> Prediction:
    # errors x: -1, 3; y: 2, 2; z: 0, -4 -> absolute 1, 3; 2, 2; 0, 4
    measured = np.array([[1.0, 0.0, 5.0], [0.0, 1.0, 4.0]])
    predicted = np.array([[0.0, 2.0, 5.0], [3.0, 3.0, 0.0]])
    return Prediction(np.array([0, 1]), predicted, measured)


def by_axis(key, prediction):
    return list(metric(key).values(prediction).values())


def overall(key, prediction):
    return metric(key).values(prediction)[""]


@pytest.mark.parametrize(
    ("key", "values"),
    [
        ("mae", [2.0, 2.0, 2.0]),
        # of the signed errors it would be 2, 0, 2; with n - 1 it would be sqrt(2), 0, sqrt(8)
        ("stde", [1.0, 0.0, 2.0]),
        ("me", [3.0, 2.0, 4.0]),
        ("rmse", [5**0.5, 2.0, 8**0.5]),
        ("median", [2.0, 2.0, 2.0]),
        ("p95", [2.9, 2.0, 3.8]),
    ],
)
def test_metrics_of_an_axis_are_of_its_absolute_errors(prediction, key, values):
    axis_values = metric(key).values(prediction)
    assert axis_values == pytest.approx(dict(zip("xyz", values, strict=True)))


def test_r2_agrees_with_scikit_learn_and_is_absent_where_nothing_varies(rng):
    measured = rng.normal(size=(20, 3))
    measured[:, 1] = 3.0
    predicted = measured + rng.normal(size=(20, 3))
    axis_values = metric("r2").values(Prediction(np.arange(20), predicted, measured))
    assert set(axis_values) == {"x", "z"}
    for axis, column in (("x", 0), ("z", 2)):
        assert axis_values[axis] == pytest.approx(
            r2_score(measured[:, column], predicted[:, column])
        )


def test_norm_and_relative_are_of_the_error_vectors_lengths(prediction):
    first, second = 5**0.5, 29**0.5  # of (-1, 2, 0) and (3, 2, -4)
    assert overall("norm", prediction) == pytest.approx((first + second) / 2)
    assert overall("norm-p95", prediction) == pytest.approx(first + 0.95 * (second - first))
    sizes = 26**0.5 + 17**0.5  # a ratio of means; none without any deflection
    assert overall("relative", prediction) == pytest.approx((first + second) / sizes)
    still = Prediction(prediction.rows, prediction.predicted, np.zeros((2, 3)))
    assert metric("relative").values(still) == {}


def test_skill_compares_the_norm_with_the_references_and_is_absent_without_one(prediction):
    assert metric("skill").values(prediction) == {}
    twice = prediction.measured + 2.0 * (prediction.predicted - prediction.measured)
    assert overall("skill", replace(prediction, reference=twice)) == pytest.approx(0.5)
    assert overall("skill", replace(prediction, reference=prediction.predicted)) == 0.0


def test_coverage_and_width_are_of_each_axis_and_the_bounds_are_inside(prediction):
    # measured x: 1, 0; y: 0, 1; z: 5, 4
    lower = np.array([[1.0, 1.0, 0.0], [-1.0, 2.0, 0.0]])
    upper = np.array([[2.0, 2.0, 4.0], [3.0, 5.0, 4.0]])
    with_interval = replace(prediction, interval=Interval(lower, upper, 0.9))
    assert by_axis("coverage", with_interval) == [1.0, 0.0, 0.5]
    assert by_axis("width", with_interval) == [2.5, 2.0, 4.0]
    assert overall("coverage-3d", with_interval) == 0.0
    around_the_first = Interval(
        lower - [[0.0, 1.0, 0.0], [0.0] * 3], np.add(upper, [[1.0], [0.0]]), 0.9
    )
    assert overall("coverage-3d", replace(prediction, interval=around_the_first)) == 0.5
    for key in ("coverage", "coverage-3d", "width"):
        assert metric(key).needs_interval and metric(key).values(prediction) == {}


@pytest.mark.parametrize(
    ("key", "value"),
    [("fit-time", 1.5), ("latency", 1e-5), ("throughput", 2e5), ("memory", 4096)],
)
def test_costs_are_read_off_and_absent_where_they_are_not_known(prediction, key, value):
    cost = Cost(1.5, 0.1, 1e-5, 2e5, 4096)
    assert metric(key).values(prediction, cost) == {"": value}
    assert metric(key).values(prediction) == {}
    assert metric("memory").values(prediction, cost._replace(memory_bytes=None)) == {}


def test_a_metric_is_found_by_its_key_and_an_unknown_one_refused_with_the_nearest():
    assert all(key == entry.key for key, entry in METRICS.items())
    with pytest.raises(ConfigError, match="unknown metric 'stda'; did you mean 'stde'"):
        metric("stda")
