"""Check statistics over robots against textbook formulas, counts and another library."""

from __future__ import annotations

import math
from itertools import product

import numpy as np
import pytest
from scipy import stats
from statsmodels.stats.weightstats import ttost_paired

from stiff_protocols.contract.errors import DataError
from stiff_protocols.scoring.over_robots import (
    MARGIN,
    equivalence_p_value,
    mean_ratio,
    sign_flip_p_value,
    without_one,
)


def test_the_mean_ratio_is_geometric_with_students_interval(rng):
    logs = rng.normal(-0.5, 0.3, size=12)
    result = mean_ratio(logs)
    low, high = stats.t.interval(0.95, 11, logs.mean(), stats.sem(logs))
    assert result.ratio == pytest.approx(stats.gmean(np.exp(logs)))
    assert (result.low, result.high, result.n_robots) == pytest.approx(
        (math.exp(low), math.exp(high), 12)
    )


def test_the_p_value_is_the_share_of_all_signs_with_a_mean_as_far_from_zero(rng):
    differences = rng.normal(0.2, 0.4, size=8)
    means = [np.mean(differences * signs) for signs in product((-1, 1), repeat=8)]
    share = np.mean(np.abs(means) >= abs(differences.mean()) - 1e-12)
    assert sign_flip_p_value(differences) == pytest.approx(share)


def test_twelve_robots_that_agree_give_the_smallest_p_value_of_4096_signs():
    assert sign_flip_p_value(np.linspace(0.1, 0.5, 12)) == pytest.approx(2 / 4096)
    assert sign_flip_p_value(np.zeros(12)) == 1.0


def test_equal_models_are_told_apart_no_more_often_than_the_level(rng):
    p_values = [sign_flip_p_value(rng.normal(size=7)) for _ in range(400)]
    assert np.mean(np.array(p_values) < 0.05) < 0.08


def test_equivalence_is_that_of_two_one_sided_t_tests(rng):
    differences = rng.normal(0.0, 0.03, size=12)
    expected, *_ = ttost_paired(differences, np.zeros(12), -MARGIN, MARGIN)
    assert equivalence_p_value(differences) == pytest.approx(expected)
    assert equivalence_p_value(differences + 1.0) > 0.99


def test_without_one_leaves_each_robot_out_once(rng):
    logs = rng.normal(size=5)
    expected = [stats.gmean(np.exp(np.delete(logs, robot))) for robot in range(5)]
    assert without_one(logs) == pytest.approx(expected)


@pytest.mark.parametrize("numbers", [[0.1], [], [0.1, np.nan]])
def test_one_robot_or_no_number_is_refused(numbers):
    for function in (mean_ratio, sign_flip_p_value, equivalence_p_value, without_one):
        with pytest.raises(DataError):
            function(numbers)
