"""Check models named `sklearn:module.Class` and `vjm+sklearn:module.Class`."""

from __future__ import annotations

import pickle

import numpy as np
import pytest

from stiff_bench.plan.options import options_of
from stiff_models.networks.encoded_model import Scaler, encode
from stiff_models.regressors.sklearn_model import literal, member
from stiff_protocols.contract.errors import ConfigError, ModelError

FOREST = "sklearn:ensemble.RandomForestRegressor"


def make(key, **options):
    return member(key).load()(**options)


@pytest.mark.parametrize(
    "key, options",
    [
        ("sklearn:svm.SVR", {}),  # one output
        ("vjm+sklearn:ensemble.GradientBoostingRegressor", {"n_estimators": 5}),  # one output
        (FOREST, {"n_estimators": 50}),  # several
        ("vjm+sklearn:linear_model.Ridge", {}),  # several
    ],
)
def test_regressors_of_one_and_of_several_outputs_learn_three_axes(key, options, parts):
    robot, train, _, test = parts
    model = make(key, **options).fit(train, robot=robot, seed=1)
    predicted = model.predict(test.q, test.wrench)
    assert predicted.shape == (len(test), 3) and predicted.dtype == np.float64
    error = np.abs(predicted - test.deflection).mean(axis=0)
    assert (error < np.abs(train.deflection.mean(axis=0) - test.deflection).mean(axis=0)).all()


def test_a_ridge_is_the_closed_form_on_standardised_rows(parts):
    robot, train, _, test = parts
    x = encode(robot, train.q, train.wrench, "raw")
    inputs, outputs = Scaler.of(x), Scaler.of(train.deflection)
    rows = inputs.apply(x)
    weights = np.linalg.solve(
        rows.T @ rows + 3.0 * np.eye(rows.shape[1]), rows.T @ outputs.apply(train.deflection)
    )
    expected = outputs.undo(inputs.apply(encode(robot, test.q, test.wrench, "raw")) @ weights)
    model = make("sklearn:linear_model.Ridge", alpha=3.0, angle_encoding="raw")
    model.fit(train, robot=robot)
    np.testing.assert_allclose(model.predict(test.q, test.wrench), expected, atol=1e-12)


def test_the_seed_reaches_the_regressor_unless_its_own_is_set(parts):
    robot, train, _, test = parts

    def predicted(seed, **options):
        model = make(FOREST, n_estimators=3, **options).fit(train, robot=robot, seed=seed)
        return model.predict(test.q, test.wrench)

    np.testing.assert_array_equal(predicted(1), predicted(1))
    assert np.abs(predicted(1) - predicted(2)).max() > 0
    np.testing.assert_array_equal(predicted(1, random_state=7), predicted(2, random_state=7))


def test_the_options_are_the_regressors_arguments_with_their_documented_types():
    options = options_of(member(FOREST).load())
    assert {"n_estimators", "max_features", "random_state", "angle_encoding"} <= set(options)
    assert options["n_estimators"].default == 100
    assert "int" in options["n_estimators"].description
    assert "physics" not in options
    assert "physics" in options_of(member("vjm+" + FOREST).load())


@pytest.mark.parametrize(
    "text, value",
    [("300", 300), ("None", None), ("true", True), ("sqrt", "sqrt"), ("(10, 10)", (10, 10))],
)
def test_texts_mean_python_literals_where_they_can(text, value):
    assert literal(text) == value and type(literal(text)) is type(value)


@pytest.mark.parametrize("key", [FOREST, f"vjm+{FOREST}", "sklearn:svm.SVR"])
def test_the_class_of_a_key_is_found_again_by_pickle(key):
    cls = member(key).load()
    assert pickle.loads(pickle.dumps(cls)) is cls
    assert pickle.loads(pickle.dumps(cls())).get_params() == cls().get_params()


def test_a_bad_value_is_refused_before_anything_is_computed():
    with pytest.raises(ConfigError, match=r"RandomForestRegressor.*'n_estimators'.*Got -3"):
        make(FOREST, n_estimators=-3).check_params()
    make(FOREST, n_estimators=3).check_params()


@pytest.mark.parametrize(
    "key, hint",
    [
        ("sklearn:RandomForestRegressor", FOREST),
        ("sklearn:linear_model.RandomForestRegressor", FOREST),
        ("sklearn:ensemble.RandomForestRegresor", FOREST),
        ("vjm+sklearn:RandomForestRegressor", "vjm+" + FOREST),
    ],
)
def test_a_key_that_names_nothing_is_refused_with_the_nearest_one(key, hint):
    with pytest.raises(ConfigError) as caught:
        member(key)
    assert f"unknown model {key!r}; did you mean {hint!r}?" in str(caught.value)


@pytest.mark.parametrize(
    "key, reason",
    [
        ("sklearn:ensemble.RandomForestClassifier", "is not a regressor"),
        ("sklearn:preprocessing.StandardScaler", "is not a regressor"),
        ("sklearn:multioutput.MultiOutputRegressor", "requires 'estimator'"),
        ("sklearn:", "unknown model"),
        ("sklearn:ensemble", "unknown model"),
    ],
)
def test_what_is_no_usable_regressor_is_refused_with_its_own_reason(key, reason):
    with pytest.raises(ConfigError, match=reason):
        member(key)


def test_a_regressor_that_cannot_learn_these_samples_says_so(parts):
    robot, train, _, _ = parts
    with pytest.raises(ModelError, match=r"sklearn:isotonic.IsotonicRegression cannot learn"):
        make("sklearn:isotonic.IsotonicRegression").fit(train, robot=robot)


def test_a_regressor_that_draws_from_numpys_global_state_follows_the_seed_and_leaves_no_trace(
    parts,
):
    robot, train, _, _ = parts
    state = np.random.get_state()[1].copy()  # noqa: NPY002
    make("sklearn:svm.SVR").fit(train, robot=robot, seed=3)  # libsvm's seed is drawn there
    np.testing.assert_array_equal(np.random.get_state()[1], state)  # noqa: NPY002
