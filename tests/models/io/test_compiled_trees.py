"""Compiled trees of scikit-learn in model files: whole ones, and crafted ones."""

from __future__ import annotations

import numpy as np
import pytest
import skops.io
from sklearn.ensemble import (
    GradientBoostingRegressor,
    HistGradientBoostingRegressor,
    RandomForestRegressor,
)
from sklearn.gaussian_process import GaussianProcessRegressor
from sklearn.gaussian_process.kernels import RBF, Matern, WhiteKernel
from sklearn.multioutput import MultiOutputRegressor
from sklearn.neighbors import KNeighborsRegressor
from sklearn.neural_network import MLPRegressor
from sklearn.tree import DecisionTreeRegressor

from stiff_models.io.compiled_trees import check_compiled_trees
from stiff_models.io.saved import TRUSTED
from stiff_protocols.contract.errors import DataError

REGRESSORS = [
    RandomForestRegressor(n_estimators=3, random_state=0),
    MultiOutputRegressor(GradientBoostingRegressor(n_estimators=3)),
    MultiOutputRegressor(HistGradientBoostingRegressor(max_iter=3)),
    GaussianProcessRegressor(RBF() + Matern() * 2.0 + WhiteKernel(), optimizer=None),
    KNeighborsRegressor(algorithm="kd_tree"),
    KNeighborsRegressor(algorithm="ball_tree"),
    MLPRegressor(hidden_layer_sizes=(5,), n_iter_no_change=2, tol=10.0),
]


def there_and_back(estimator):
    assert not set(skops.io.get_untrusted_types(data=skops.io.dumps(estimator))) - set(TRUSTED)
    loaded = skops.io.loads(skops.io.dumps(estimator), trusted=list(TRUSTED))
    check_compiled_trees({"regressor_": loaded})
    return loaded


def data(rng):
    inputs = rng.normal(size=(120, 4))
    return inputs, inputs @ rng.normal(size=(4, 3))


@pytest.mark.parametrize("regressor", REGRESSORS, ids=lambda each: type(each).__name__)
def test_a_regressor_predicts_the_same_bits_after_a_round_trip(regressor, rng):
    regressor.fit(*data(rng))
    loaded = there_and_back(regressor)
    new = rng.normal(size=(30, 4))
    np.testing.assert_array_equal(loaded.predict(new), regressor.predict(new))


@pytest.mark.parametrize(
    ("field", "value"),
    [("left_child", 10**6), ("right_child", 0), ("left_child", -7), ("feature", 99)],
)
def test_a_decision_tree_that_points_outside_of_itself_is_refused(field, value, rng):
    inputs, outputs = data(rng)
    regressor = DecisionTreeRegressor().fit(inputs, outputs)
    state = regressor.tree_.__getstate__()
    state["nodes"][field][0] = value
    regressor.tree_.__setstate__(state)
    with pytest.raises(DataError, match="decision tree whose nodes point outside"):
        there_and_back(regressor)


def test_an_inner_tree_that_says_it_knows_more_features_than_its_ensemble_is_refused(rng):
    """The ensemble alone checks the input; what is inside is handed rows of that width."""
    inputs, outputs = data(rng)
    regressor = GradientBoostingRegressor(n_estimators=2).fit(inputs, outputs[:, 0])
    inner = regressor.estimators_[1, 0]
    inner.n_features_in_ = 10**10
    state = inner.tree_.__getstate__()
    state["nodes"]["feature"][0] = 2 * 10**9
    inner.tree_.__setstate__(state)
    with pytest.raises(DataError, match="decision tree whose nodes point outside"):
        there_and_back(regressor)


@pytest.mark.parametrize(
    ("field", "value", "message"),
    [
        ("left", 10**6, "point outside"),
        ("right", 0, "point outside"),
        ("feature_idx", -1, "point outside"),
        ("is_categorical", 1, "categories"),
    ],
)
def test_a_boosted_tree_that_points_outside_of_itself_is_refused(field, value, message, rng):
    inputs, outputs = data(rng)
    regressor = HistGradientBoostingRegressor(max_iter=2).fit(inputs, outputs[:, 0])
    regressor._predictors[1][0].nodes[field][0] = value
    with pytest.raises(DataError, match=message):
        there_and_back(regressor)


def test_a_decision_tree_that_counts_more_nodes_than_it_has_is_refused(rng):
    regressor = DecisionTreeRegressor(max_depth=2).fit(*data(rng))
    state = regressor.tree_.__getstate__()
    state["node_count"] += 1
    regressor.tree_.__setstate__(state)
    with pytest.raises(DataError, match="more or fewer nodes"):
        check_compiled_trees(regressor)


def test_a_tree_that_two_estimators_share_is_checked_for_the_narrower_one(rng):
    inputs, outputs = data(rng)
    wide = DecisionTreeRegressor().fit(inputs, outputs)
    narrow = RandomForestRegressor(n_estimators=1).fit(inputs[:, :1], outputs)
    narrow.estimators_ = [wide]
    with pytest.raises(DataError, match="decision tree whose nodes point outside"):
        check_compiled_trees([wide, narrow])


def test_a_neighbour_tree_that_points_outside_of_itself_is_refused(rng):
    regressor = KNeighborsRegressor(algorithm="kd_tree").fit(*data(rng))
    state = list(regressor._tree.__getstate__())
    state[1] = state[1] + 5  # the rows' numbers
    regressor._tree.__setstate__(tuple(state))
    with pytest.raises(DataError, match="neighbour tree"):
        there_and_back(regressor)


@pytest.mark.parametrize("shape", [(0, 4), (120, 3), (4,)])
def test_neighbours_of_another_shape_than_the_input_are_refused(shape, rng):
    regressor = KNeighborsRegressor(algorithm="brute").fit(*data(rng))
    regressor._fit_X = np.zeros(shape)
    with pytest.raises(DataError, match="neighbours of shape"):
        there_and_back(regressor)
