"""The prior learned on other robots, of which docs/findings.md has a table."""

from __future__ import annotations

import family_prior
import numpy as np
import pytest

from stiff_datasets.twin.robot_twin import ArmFamily
from stiff_models.physics.full_vjm import FullVjm
from stiff_protocols.springs.identification import PRIOR_SPREAD


@pytest.fixture()
def arm():
    data = ArmFamily(robot=3).load()
    return data.robot, data.samples.take(np.arange(2))


@pytest.mark.slow
def test_a_robots_prior_is_learned_without_it(arm, monkeypatch):
    robot, springs = arm[0], family_prior.learned("vjm")
    before = family_prior.family.__wrapped__("vjm", robot.name)
    other = {**springs, robot.name: (np.arange(6.0), np.full(6, 1e-3))}
    monkeypatch.setattr(family_prior, "learned", lambda key: other)
    np.testing.assert_array_equal(family_prior.family.__wrapped__("vjm", robot.name), before)
    assert not np.allclose(family_prior.family.__wrapped__("vjm", "gp180"), before)


@pytest.mark.filterwarnings("ignore:.*training samples give")
def test_with_the_laws_spread_springs_that_nothing_identifies_are_those_of_the_model(arm):
    robot, train = arm
    springs = FullVjm().fit(train, robot=robot).springs_
    assert not springs.known.any()
    law = family_prior.law("vjm-full", robot)
    matrix = family_prior.regressors("vjm-full", robot, train)(train.q, train.wrench)
    compliance = family_prior.most_probable(
        matrix.reshape(-1, 18), train.deflection.reshape(-1), law, np.full(18, PRIOR_SPREAD)
    )
    np.testing.assert_allclose(compliance, springs.compliance, rtol=1e-3)
