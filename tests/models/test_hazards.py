"""Check every model on hazardous samples: it works, warns, or refuses with the cause.

A model that is not named in `hazard_outcomes` works without a warning. If rows cannot teach any
model ("all of one pose"), the engine warns once for all models: see `ROWS`.
"""

from __future__ import annotations

import re
import warnings
from collections.abc import Iterator
from dataclasses import replace
from typing import Any

import numpy as np
import pytest

import stiff_models.transfer.pretraining
import stiff_models.transfer.source_domain
from helpers.hazard_outcomes import ROWS, VARIANTS, expected
from helpers.made_hazards import HAZARDS, Case
from stiff_datasets.twin.kr10_twin import Kr10Twin
from stiff_models.model_catalog import model_info
from stiff_protocols.contract.errors import ModelError, StiffBenchError, StiffBenchWarning
from stiff_protocols.contract.stiffness_model import offers
from stiff_protocols.scoring.sanity import warn_of_rows
from stiff_protocols.splits.random_splits import Holdout

TINY = {
    "width": 8,
    "epochs": 3,
    "pretrain_steps": 3,
    "source_poses": "sobol",
    "members": 2,
    "ard": False,
    "restarts": 0,
    "trees": 5,
    "n_estimators": 5,
    "device": "cpu",
}
"""Options that make a fit take milliseconds, for models that have them."""


@pytest.fixture(scope="module")
def healthy() -> Case:
    data = Kr10Twin().load()
    (split,) = Holdout().splits(data.samples, n_splits=1, seed=0)
    train, validation, test = (
        data.samples.take(rows) for rows in (split.train[::3], split.validation, split.test)
    )
    return Case(data.robot, train, validation, test)


@pytest.fixture(scope="module", autouse=True)
def small_source() -> Iterator[None]:
    """Train on a source of few poses without the cache, whose look-up takes longer."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(stiff_models.transfer.source_domain, "POSE_BUDGET", 16)
        patch.setattr(stiff_models.transfer.pretraining, "remembered", lambda _, compute: compute())
        yield


def tiny_model(variant: str, **options: Any) -> Any:
    key, variant_options = VARIANTS[variant]
    info = model_info(key)
    if info.missing():
        pytest.skip(info.missing())
    model = info.load()()
    if missing := getattr(model, "missing", str)():
        pytest.skip(missing)
    params = model.get_params()
    tiny = {name: value for name, value in TINY.items() if name in params}
    return model.set_params(**tiny | variant_options | options)


def fit_without_warnings(variant: str, case: Case) -> Any:
    """Fit a tiny model and ignore its warnings, which another test checks."""
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", StiffBenchWarning)
        return tiny_model(variant).fit(case.train, robot=case.robot)


def outcome(model: Any, case: Case) -> str:
    """Fit and predict; return "works", "warns: ..." or "fails: ..."."""
    with warnings.catch_warnings(record=True) as caught:
        warnings.simplefilter("always")
        try:
            model.fit(case.train, robot=case.robot, validation=case.validation, seed=1)
            for samples in (case.train, case.test):
                predicted = model.predict(samples.q, samples.wrench)
                assert predicted.shape == (len(samples), 3) and np.isfinite(predicted).all()
        except StiffBenchError as error:
            assert "\n" not in str(error)
            return f"fails: {error}"
    assert {warning.category for warning in caught} <= {StiffBenchWarning}
    messages = dict.fromkeys(str(warning.message) for warning in caught)
    return f"warns: {' | '.join(messages)}" if messages else "works"


MATRIX = [
    (variant, hazard)
    for hazard in HAZARDS
    for variant in VARIANTS
    if "validation" not in hazard or model_info(VARIANTS[variant][0]).uses_validation
]
"""All pairs except hazards of validation rows with models that use none."""


def pairwise() -> set[tuple[str, str]]:
    """Choose the fast suite's part of the matrix: a walk along its diagonal.

    Every model is tested on one hazard; the next model's is one further. Every hazard is tested
    with the first model of each of its outcomes.
    """
    chosen_pairs = set()
    for start, variant in enumerate(VARIANTS):
        pairs = [pair for pair in MATRIX if pair[0] == variant]
        chosen_pairs.add(pairs[start % len(pairs)])
    first_variants = {
        (hazard, expected(hazard, variant)): variant for variant, hazard in reversed(MATRIX)
    }
    return chosen_pairs | {(variant, hazard) for (hazard, _), variant in first_variants.items()}


FAST = pairwise()
TURNED_FAST = ("knn", "vjm", "mlp")


@pytest.mark.parametrize(
    ("variant", "hazard"),
    [pytest.param(*pair, marks=[pytest.mark.slow] * (pair not in FAST)) for pair in MATRIX],
)
def test_a_model_works_or_says_what_is_wrong_with_the_samples(variant, hazard, healthy):
    case = HAZARDS[hazard](healthy)
    assert re.match(expected(hazard, variant), outcome(tiny_model(variant), case))


@pytest.mark.parametrize(
    "variant",
    [pytest.param(v, marks=[pytest.mark.slow] * (v not in TURNED_FAST)) for v in VARIANTS],
)
def test_a_whole_turn_of_an_endless_joint_changes_no_prediction_and_no_interval(variant, healthy):
    turns = 2.0 * np.pi * np.array([1, 0, 0, -2, 0, 1])
    limits = np.where(turns == 0.0, healthy.robot.upper, np.inf)
    robot = replace(healthy.robot, lower=-limits, upper=limits)
    test = healthy.test.take(np.arange(10))
    model = tiny_model(variant)
    if "angle_encoding" in model.get_params():
        model.set_params(angle_encoding="raw")
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", StiffBenchWarning)
        model.fit(healthy.train, robot=robot)
    predicted, turned = (model.predict(q, test.wrench) for q in (test.q, test.q + turns))
    np.testing.assert_allclose(turned, predicted, rtol=0, atol=1e-9)
    if offers(type(model), "predict_interval"):
        widths = [
            model.predict_interval(q, test.wrench, 0.9).half_width for q in (test.q, test.q + turns)
        ]
        np.testing.assert_allclose(*widths, rtol=0, atol=1e-9)


@pytest.mark.parametrize("hazard", HAZARDS)
def test_what_rows_cannot_teach_any_model_is_said_once(hazard, healthy):
    with warnings.catch_warnings(record=True) as caught:
        warnings.simplefilter("always")
        warn_of_rows(HAZARDS[hazard](healthy).train)
    messages = [str(warning.message) for warning in caught]
    rows = hazard.partition(",")[0]  # without the validation rows
    patterns = [ROWS[rows]] if rows in ROWS else []
    assert len(messages) == len(patterns) and all(map(re.search, patterns, messages))
    assert all(warning.category is StiffBenchWarning for warning in caught)


@pytest.mark.parametrize("hazard", ["1 row", "no deflection", "deflection only along z"])
@pytest.mark.parametrize("variant", ["mlp", "residual-mlp", "ridge", "gp", "sklearn mlp"])
def test_a_learner_leaves_no_decimetres_where_the_deflection_does_not_vary(
    variant, hazard, healthy
):
    case = HAZARDS[hazard](healthy)
    largest = np.abs(case.train.deflection).max(axis=0)
    model = fit_without_warnings(variant, case)
    predicted = np.abs(model.predict(case.train.q, case.train.wrench)).max(axis=0)
    assert (predicted <= 1e-8 + 5 * largest.max()).all()


@pytest.mark.parametrize(
    ("variant", "atol"), [("vjm", 1e-12), ("vjm-full", 1e-10), ("vjm-full, ridge", 1e-12)]
)
def test_linear_springs_scale_with_the_load_whatever_its_size(variant, atol, healthy):
    test = healthy.test
    model = tiny_model(variant).fit(healthy.train, robot=healthy.robot)
    predicted = model.predict(test.q, test.wrench)
    np.testing.assert_allclose(model.predict(test.q, 1e6 * test.wrench), 1e6 * predicted, rtol=1e-9)
    for hazard in ("loads x 1e6", "loads x 1e-6"):
        case = HAZARDS[hazard](healthy)
        scaled = tiny_model(variant).fit(case.train, robot=case.robot)
        np.testing.assert_allclose(
            scaled.predict(case.test.q, case.test.wrench), predicted, rtol=1e-6, atol=atol
        )


@pytest.mark.slow
@pytest.mark.parametrize("variant", ["knn", "vjm", "bayes-springs", "mlp", "forest"])
def test_arrays_of_any_kind_and_no_rows_are_predicted_and_what_is_no_number_is_refused(
    variant, healthy
):
    test = healthy.test
    model = fit_without_warnings(variant, healthy)
    q, wrench = (np.asarray(a, dtype=np.float32).astype(float) for a in (test.q, test.wrench))
    expected_prediction = model.predict(q, wrench)
    strided_wrench = np.repeat(wrench, 2, axis=1)[:, ::2]  # not contiguous
    for arrays in (
        (q.astype(np.float32), wrench.astype(np.float32)),
        (np.asfortranarray(q), strided_wrench),
        (q.tolist(), wrench.tolist()),
    ):
        # the order of memory may change the order of sums
        np.testing.assert_allclose(
            model.predict(*arrays), expected_prediction, rtol=1e-5, atol=1e-12
        )
    assert model.predict(np.empty((0, 6)), np.empty((0, 6))).shape == (0, 3)
    q[2, 1] = np.nan
    with pytest.raises(ModelError, match=r"q\[2\] is .*nan.*, expected finite numbers"):
        model.predict(q, wrench)


DIVERGING = [
    ("mlp", {"learning_rate": 1e30, "epochs": 1}, "fails: train: the loss is nan after 1 steps"),
    ("mlp", {"learning_rate": 1e6, "epochs": 1}, "warns: train: the loss rose from"),
    ("mlp", {"learning_rate": 10.0, "epochs": 60}, "warns: train: .*every row the same output"),
    ("ft-mlp", {"learning_rate": 1e30}, "fails: fine-tune: the loss is nan"),
    ("ft-mlp", {"learning_rate": 1e6, "freeze": "full"}, "warns: fine-tune: the loss rose from"),
    ("compliance-net", {"learning_rate": 1e6}, "warns: fine-tune: .*every row the same output"),
]


@pytest.mark.parametrize(("variant", "options", "pattern"), DIVERGING)
def test_a_diverging_training_says_so_with_its_learning_rate(variant, options, pattern, healthy):
    case = replace(healthy, validation=None)
    rate = re.escape(f"use a learning rate below {options['learning_rate']:g}")
    assert re.search(f"{pattern}.*{rate}", outcome(tiny_model(variant, **options), case))
