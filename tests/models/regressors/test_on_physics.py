"""Check learners on physics: `vjm-gp`, `vjm-boosting`, `residual-mlp`."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import get_args

import numpy as np
import pytest

from stiff_models import load
from stiff_models.model_catalog import MODELS, SpringModel
from stiff_models.networks.mlp import ResidualMlp
from stiff_models.physics.fitted_geometry import GeometryModel
from stiff_models.physics.fourier_springs import FourierSprings
from stiff_models.physics.vjm import OnPhysics, fitted_physics
from stiff_models.regressors.gp_model import VjmGp
from stiff_models.regressors.regressor_model import VjmBoosting, ZeroModel

COMPLIANCE = 1.0 / np.array([5e5, 4e5, 3e5, 4e4, 4e4, 3e4])  # rad/(N m)


@dataclass(kw_only=True, eq=False, repr=False)
class OnNothing(OnPhysics, ZeroModel):
    """Stand for a learner that learns nothing."""


def with_vjm_deflections(samples, robot):
    return replace(
        samples, deflection=robot.joint_deflection(COMPLIANCE, samples.q, samples.wrench)
    )


def test_every_spring_model_of_the_catalogue_may_be_the_physics():
    usable = [info for info in MODELS if not info.missing()]
    kinds = (GeometryModel, FourierSprings)
    springs = [info.key for info in usable if issubclass(info.load(), kinds)]
    assert list(get_args(SpringModel)) == springs


@pytest.mark.slow
@pytest.mark.filterwarnings("ignore:joint stiffness not identifiable")
@pytest.mark.parametrize("key", get_args(SpringModel))
def test_a_learner_that_learns_nothing_leaves_the_physics(key, parts):
    robot, train, _, test = parts
    train = train.take(np.arange(40))
    model = OnNothing(physics=key).fit(train, robot=robot)
    physics = fitted_physics(key, train, robot)
    np.testing.assert_array_equal(
        model.predict(test.q, test.wrench), physics.predict(test.q, test.wrench)
    )
    np.testing.assert_equal(model.diagnostics_, physics.diagnostics_)  # some are NaN


@pytest.mark.slow
@pytest.mark.parametrize("key", ["curve-springs", "bayes-springs"])
def test_a_saved_learner_predicts_the_same_on_any_physics(key, parts, tmp_path):
    robot, train, _, test = parts
    model = VjmBoosting(physics=key, trees=5).fit(train.take(np.arange(40)), robot=robot)
    model.save(tmp_path / "model.stiff")
    loaded_model = load(tmp_path / "model.stiff")
    np.testing.assert_array_equal(
        loaded_model.predict(test.q, test.wrench), model.predict(test.q, test.wrench)
    )


@pytest.mark.slow
@pytest.mark.parametrize(
    "make",
    [
        lambda: VjmGp(restarts=0, ard=False),
        lambda: VjmBoosting(trees=5),
        lambda: ResidualMlp(layers=1, width=8, epochs=3, device="cpu"),
    ],
)
def test_samples_of_a_vjm_give_the_vjm_back(make, parts):
    robot, train, _, test = parts
    model = make().fit(with_vjm_deflections(train, robot), robot=robot)
    np.testing.assert_allclose(
        model.predict(test.q, test.wrench), with_vjm_deflections(test, robot).deflection, atol=1e-9
    )
    stiffness = [v for k, v in model.diagnostics_.items() if k.startswith("stiffness ")]
    np.testing.assert_allclose(stiffness, 1.0 / COMPLIANCE, rtol=1e-6)


def test_validation_rows_reach_the_residual_network_and_never_the_physics(parts):
    robot, train, held_out, _ = parts
    fits = [
        ResidualMlp(layers=1, width=8, epochs=30, training="best", device="cpu").fit(
            train, robot=robot, validation=rows, seed=3
        )
        for rows in (held_out, replace(held_out, deflection=-3 * held_out.deflection))
    ]
    np.testing.assert_array_equal(*(fit.physics_.springs_.compliance for fit in fits))
    losses, changed_losses = (fit.curves_["training"][:, 2] for fit in fits)
    assert (losses != changed_losses).all() and np.isfinite([losses, changed_losses]).all()
