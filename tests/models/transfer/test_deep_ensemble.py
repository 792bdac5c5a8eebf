"""Check `deep-ensemble`: the mean of its members, and intervals from their spread."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from stiff_models.transfer.deep_ensemble import DeepEnsemble, common_error
from stiff_models.transfer.ft_mlp import FtMlp

SMALL = {"width": 16, "pretrain_steps": 30, "epochs": 20, "device": "cpu"}

pytestmark = pytest.mark.usefixtures("small_source")


@pytest.fixture(scope="module")
def ensemble(parts):
    robot, train, held_out, _ = parts
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr("stiff_models.transfer.source_domain.POSE_BUDGET", 120)
        return DeepEnsemble(**SMALL, members=3).fit(train, robot=robot, validation=held_out, seed=4)


@pytest.mark.slow
def test_intervals_contain_the_prediction_grow_with_coverage_and_with_disagreement(ensemble, parts):
    test = parts[3]
    middle = ensemble.predict(test.q, test.wrench)
    wide_interval, narrow_interval = (
        ensemble.predict_interval(test.q, test.wrench, c) for c in (0.9, 0.5)
    )
    assert (wide_interval.lower < narrow_interval.lower).all() and (
        narrow_interval.upper < wide_interval.upper
    ).all()
    np.testing.assert_allclose((wide_interval.lower + wide_interval.upper) / 2, middle, atol=1e-12)
    spread = np.std([m.predict(test.q, test.wrench) for m in ensemble.members_], axis=0)
    width = wide_interval.upper - wide_interval.lower
    expected = 2 * 1.6448536269514722 * np.sqrt(spread**2 + ensemble.noise_**2)  # 95 % quantile
    training_range = ensemble.training_range_
    is_inside = ((training_range.lower <= test.q) & (test.q <= training_range.upper)).all(axis=1)
    size = np.linalg.norm(test.wrench.reshape(-1, 2, 3), axis=2).sum(axis=1)
    is_inside &= size <= training_range.force + training_range.torque
    assert is_inside.sum() > 20 and (width[~is_inside] > expected[~is_inside]).all()
    stretch = training_range.stretch(test.q, test.wrench)[:, None]
    np.testing.assert_allclose(width[is_inside], (stretch * expected)[is_inside])


@pytest.mark.slow
def test_its_noise_comes_from_training_poses_and_never_from_validation_labels(parts):
    robot, train, held_out, _ = parts
    wild_labels = replace(held_out, deflection=held_out.deflection * 1000.0)
    ensemble, wild_ensemble = (
        DeepEnsemble(**SMALL, members=2, training="normal").fit(
            train, robot=robot, validation=rows, seed=4
        )
        for rows in (held_out, wild_labels)
    )
    np.testing.assert_array_equal(ensemble.noise_, wild_ensemble.noise_)
    single = FtMlp(**SMALL).fit(train, robot=robot, seed=4)
    residual = np.sqrt(
        ((single.predict(train.q, train.wrench) - train.deflection) ** 2).mean(axis=0)
    )
    assert (
        ensemble.noise_ > residual * 0.8
    ).all()  # held out, and not what the weights have fitted


@pytest.mark.parametrize("members", [2, 5])
@pytest.mark.parametrize("scatter", [0.0, 0.3, 0.6])
def test_common_errors_and_the_spread_make_up_the_error_of_the_mean(members, scatter):
    rng, common = np.random.default_rng(0), np.array([1.0, 2.0, 0.5])

    def networks(number):
        errors = rng.normal(size=(20_000, 3)) * common  # of all networks at a pose
        return errors + scatter * rng.normal(size=(number, 20_000, 3))

    common_part, member_errors = common_error(networks(2), members), networks(members)
    expected = (member_errors.mean(axis=0) ** 2).mean(axis=0)
    combined = common_part**2 + member_errors.var(axis=0).mean(axis=0)
    np.testing.assert_allclose(combined, expected, rtol=0.1)
