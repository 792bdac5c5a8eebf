"""Compare metrics, intervals, inner searches and sensor errors with stored numbers.

After a change put the new numbers here. A change of the intervals raises `INTERVAL_VERSION`. A
change of the inner search raises the version of every model with a grid. Metrics and the sensor's
errors need no version: metrics are computed when results are read, and the sensor's errors are
part of a split's hash.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np
import pytest

from helpers.quick_models import twin_data
from stiff_models.physics.vjm import VirtualJointModel
from stiff_models.regressors.regressor_model import NearestNeighbours
from stiff_protocols.contract.record import Cost
from stiff_protocols.contract.types import FloatArray, Interval, Prediction
from stiff_protocols.scoring.conformal import SplitConformal
from stiff_protocols.scoring.metrics import METRICS
from stiff_protocols.splits.sensor_noise import SensorNoise
from stiff_protocols.tuning.inner_search import InnerSearch

METRIC_VALUES: Mapping[str, Sequence[float]] = {
    "mae": [0.00011880259353580688, 0.00015228417838456803, 0.0001394967372659964],
    "stde": [6.427224645438381e-05, 6.011869487665291e-05, 4.999257880985712e-05],
    "me": [0.00019824096131596983, 0.00019354074633413433, 0.00019779251773362682],
    "rmse": [0.0001350739719380725, 0.00016372149663356687, 0.00014818433670235937],
    "median": [0.00011997885633501751, 0.00017652137178280345, 0.00017361706747608433],
    "p95": [0.00019610946174249355, 0.00019333615082199493, 0.00019478783120824408],
    "r2": [0.8675591751202568, 0.944864220256577, 0.9563231810497546],
    "norm": [0.0002550438116119271],
    "reading": [(0.00011880259353580688 + 0.00015228417838456803 + 0.0001394967372659964) / 3.0],
    "norm-p95": [0.0003051393774577846],
    "norm-max": [0.000317330776141734],
    "true-norm": [2.0 * 0.0002550438116119271],
    "true-p95": [2.0 * 0.0003051393774577846],
    "drawn-norm": [2.0 * 0.0002550438116119271],
    "relative": [0.2267622414772854],
    "removed": [1.0 - 0.2267622414772854],
    "skill": [0.3560456890154393],
    "coverage": [0.8181818181818182, 0.6363636363636364, 0.6363636363636364],
    "coverage-3d": [0.2727272727272727],
    "width": [0.0004113502298488508, 0.00039971738621249765, 0.0003382288197887183],
    "fit-time": [2.0],
    "latency": [0.001],
    "throughput": [4000.0],
    "memory": [1048576.0],
}
LOWER = (
    (-3.225979567027346e-05, -3.940628939043086e-05, -0.00048334409491684513),
    (-0.0002130448189948327, 0.00010796167580171372, -0.0007109037115185033),
)
UPPER = (
    (0.0006907910522459632, 0.0006625662209768559, -6.547346531209981e-06),
    (4.7353826674786925e-05, 0.00036076919483545185, -0.000539190715265049),
)
INNER_ERRORS = (  # of 1, 3, 5, 10 neighbours, each with both weights
    *(0.0008289128907632226, 0.0008289128907632226, 0.0007587866886548129),
    *(0.0007319922896302305, 0.000787490274026889, 0.0007554757967504036),
    *(0.0009023485411143122, 0.0008559394977557389),
)
SENSOR_ERROR = (  # N and N m, on the first test row, five times the sensor's figures
    *(-0.13978165735332795, -0.43786634838199306, 0.12948428421883906),
    *(-0.008780359701813905, -0.0006506901631388385, -0.011727853954186537),
)
SEED = 5


def fixed_numbers(size: float, step: float) -> FloatArray:
    """Return (11, 3) fixed numbers up to a size, m."""
    return np.asarray(size * np.sin(step * np.arange(33.0) ** 2).reshape(11, 3))


def assert_stored(actual: object, expected: object) -> None:
    if np.shape(actual) != np.shape(expected) or not np.allclose(
        actual, expected, rtol=1e-9, atol=1e-12
    ):
        message = "numbers changed: see the first lines of this file"
        pytest.fail(f"{message}\n{expected}\nbecame\n{actual}", pytrace=False)


@pytest.mark.parametrize("key", METRICS)
def test_a_metric_of_fixed_predictions(key: str) -> None:
    measured = fixed_numbers(1e-3, 0.7)
    predicted = measured + fixed_numbers(2e-4, 0.9)
    half = np.abs(fixed_numbers(3e-4, 0.4))
    prediction = Prediction(
        rows=np.arange(11),
        predicted=predicted,
        measured=measured,
        interval=Interval(predicted - half, predicted + half, coverage=0.8),
        reference=measured + fixed_numbers(3e-4, 1.3),
        bound_deflections={"truth": measured - fixed_numbers(2e-4, 0.9)},
    )
    cost = Cost(2.0, 0.25, 0.001, 4000.0, 2**20)
    assert key in METRIC_VALUES, f"a new metric: put its value here, {METRICS[key]}"
    assert_stored([*METRICS[key].values(prediction, cost).values()], METRIC_VALUES[key])


def test_split_conformal_intervals() -> None:
    data = twin_data()
    train, test_samples = data.samples.take(np.arange(60)), data.samples.take(np.array([100, 101]))
    model = SplitConformal(VirtualJointModel(), coverage=0.8)
    model.fit(train, robot=data.robot, seed=SEED)
    assert_stored(len(model.residuals_), 15)
    interval = model.predict_interval(test_samples.q, test_samples.wrench, 0.8)
    assert_stored(interval.lower, LOWER)
    assert_stored(interval.upper, UPPER)


def test_the_choice_of_an_inner_search() -> None:
    data = twin_data()
    grid = {"neighbours": (1, 3, 5, 10), "weights": ("uniform", "distance")}
    search = InnerSearch(NearestNeighbours(), grid, folds=3)
    search.fit(data.samples.take(np.arange(60)), robot=data.robot, seed=SEED)
    assert_stored([candidate.error for candidate in search.scores_], INNER_ERRORS)
    assert_stored(search.best_params_["neighbours"], 3)
    assert search.best_params_["weights"] == "distance"


def test_the_errors_of_the_sensor() -> None:
    samples = twin_data().samples.take(np.arange(60))
    _, split = SensorNoise(levels="1,5").splits(samples, n_splits=1, seed=SEED)
    assert_stored(split.test[:3], [19, 21, 23])
    assert split.wrench_error is not None
    assert_stored(split.wrench_error[0], SENSOR_ERROR)
