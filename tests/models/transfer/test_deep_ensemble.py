"""`deep-ensemble`: the mean of its members, and intervals from their spread."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from stiff_models.transfer.deep_ensemble import DeepEnsemble, common_error
from stiff_models.transfer.ft_mlp import FtMlp

SMALL = {"width": 16, "pretrain_steps": 30, "epochs": 20, "device": "cpu"}


@pytest.fixture(scope="module")
def ensemble(parts):
    robot, train, held_out, _ = parts
    return DeepEnsemble(**SMALL, members=3).fit(train, robot=robot, validation=held_out, seed=4)


def test_intervals_contain_the_prediction_grow_with_coverage_and_with_disagreement(ensemble, parts):
    test = parts[3]
    middle = ensemble.predict(test.q, test.wrench)
    wide, narrow = (ensemble.predict_interval(test.q, test.wrench, c) for c in (0.9, 0.5))
    assert (wide.lower < narrow.lower).all() and (narrow.upper < wide.upper).all()
    np.testing.assert_allclose((wide.lower + wide.upper) / 2, middle, atol=1e-12)
    spread = np.std([m.predict(test.q, test.wrench) for m in ensemble.members_], axis=0)
    width = wide.upper - wide.lower
    expected = 2 * 1.6448536269514722 * np.sqrt(spread**2 + ensemble.noise_**2)  # 95 % quantile
    learned = ensemble.training_range_
    inside = ((learned.lower <= test.q) & (test.q <= learned.upper)).all(axis=1)
    size = np.linalg.norm(test.wrench.reshape(-1, 2, 3), axis=2).sum(axis=1)
    inside &= size <= learned.force + learned.torque
    assert inside.sum() > 20 and (width[~inside] > expected[~inside]).all()
    stretch = learned.stretch(test.q, test.wrench)[:, None]
    np.testing.assert_allclose(width[inside], (stretch * expected)[inside])


def test_its_noise_comes_from_training_poses_and_never_from_validation_labels(parts):
    robot, train, held_out, _ = parts
    wild = replace(held_out, deflection=held_out.deflection * 1000.0)
    calm, same = (
        DeepEnsemble(**SMALL, members=2, training="normal").fit(
            train, robot=robot, validation=rows, seed=4
        )
        for rows in (held_out, wild)
    )
    np.testing.assert_array_equal(calm.noise_, same.noise_)
    alone = FtMlp(**SMALL).fit(train, robot=robot, seed=4)
    residual = np.sqrt(
        ((alone.predict(train.q, train.wrench) - train.deflection) ** 2).mean(axis=0)
    )
    assert (calm.noise_ > residual * 0.8).all()  # held out, and not what the weights have fitted


@pytest.mark.parametrize("members", [2, 5])
@pytest.mark.parametrize("scatter", [0.0, 0.3, 0.6])
def test_common_errors_and_the_spread_make_up_the_error_of_the_mean(members, scatter):
    rng, common = np.random.default_rng(0), np.array([1.0, 2.0, 0.5])

    def networks(number):
        errors = rng.normal(size=(20_000, 3)) * common  # of all networks at a pose
        return errors + scatter * rng.normal(size=(number, 20_000, 3))

    found, all_of_them = common_error(networks(2), members), networks(members)
    expected = (all_of_them.mean(axis=0) ** 2).mean(axis=0)
    together = found**2 + all_of_them.var(axis=0).mean(axis=0)
    np.testing.assert_allclose(together, expected, rtol=0.1)
