"""The rule for verdicts: conditions for a winner and for equivalence, and the correction."""

from __future__ import annotations

from dataclasses import replace
from itertools import combinations

import numpy as np
import pytest

from stiff_bench.results.significance import (
    Estimate,
    Question,
    SharedErrors,
    corrected_p_values,
    decide,
    decide_pairs,
    estimates,
)
from stiff_protocols.scoring.bootstrap import pose_errors
from stiff_protocols.scoring.paired import Posterior, corrected_t, holm, wilcoxon_signed_rank

POSES = np.arange(40).astype(str)


def estimate(low, high, p_value, equivalent=0.0):
    posterior = Posterior(0.0, equivalent, 1.0 - equivalent)
    return Estimate(low, high, p_value, posterior)


@pytest.mark.parametrize(
    ("results", "verdict"),
    [
        ([estimate(-2e-5, -1e-5, 0.01)], "a"),
        ([estimate(1e-5, 2e-5, 0.01)], "b"),
        ([estimate(-2e-5, -1e-5, 0.01), estimate(-2e-5, 1e-6, 0.01)], "open"),
        ([estimate(-2e-5, -1e-6, 0.06)], "open"),
        # no difference found is not equivalent
        ([estimate(-1e-4, 1e-4, 0.9, 0.94)], "open"),
        ([estimate(-1e-6, 1e-6, 0.9, 0.96), estimate(-1e-4, 1e-4, 0.9, 0.94)], "open"),
        # a certain difference below the tracker's resolution is no difference
        ([estimate(-2e-6, -1e-6, 0.001, 0.99)], "equivalent"),
    ],
)
def test_a_verdict_needs_the_test_and_every_interval_or_every_probability(results, verdict):
    assert decide(results, 0.95) == verdict


def test_a_lower_confidence_decides_earlier():
    assert decide([estimate(-2e-5, -1e-6, 0.06)], 0.9) == "a"


def errors_of(rng, *means, n_splits=5):
    """Return errors of models with these mean errors, m, that scatter by 0.02 mm."""
    errors = [mean + 2e-5 * rng.normal(size=(n_splits, len(POSES))) for mean in means]
    columns = np.column_stack([model_errors.ravel() for model_errors in errors])
    split_means = np.column_stack([model_errors.mean(axis=1) for model_errors in errors])
    poses = pose_errors(np.tile(POSES, n_splits), columns)
    return SharedErrors(split_means if n_splits > 1 else None, 0.2, poses)


@pytest.mark.parametrize("n_splits", [1, 5])
def test_a_pair_the_other_way_round_has_the_other_verdict(rng, n_splits):
    errors = errors_of(rng, 1e-4, 2e-4, n_splits=n_splits)
    assert decide_pairs(errors, [(0, 1), (1, 0)], Question()) == ["a", "b"]


def test_a_level_that_the_test_of_the_pair_just_meets_decides(rng):
    """Corrected t over splits, Wilcoxon over the poses of one split; Holm over all pairs."""
    pairs = [*combinations(range(4), 2)]
    a, b = np.transpose(pairs)
    for n_splits in (1, 5):
        errors = errors_of(rng, 1e-4, 1.2e-4, 1.3e-4, 1.25e-4, n_splits=n_splits)
        if n_splits > 1:
            differences = errors.of_splits[:, a] - errors.of_splits[:, b]
            p_values = [corrected_t(column, 0.2).p_value for column in differences.T]
        else:
            totals = errors.of_poses.totals
            p_values = [wilcoxon_signed_rank(totals[:, i] - totals[:, j]) for i, j in pairs]
        corrected_values = corrected_p_values(errors)[a, b]
        assert corrected_values == pytest.approx(holm(p_values), rel=1e-12)
        for pair_values, expected in ((None, p_values), (corrected_values, [*corrected_values])):
            for number, p_value in enumerate(expected[:3]):
                verdicts = [
                    decide_pairs(errors, pairs, Question(0.0, 1.0 - level), pair_values)
                    for level in (0.99 * p_value, 1.01 * p_value)
                ]
                assert verdicts[0][number] == "open"
                assert verdicts[1][number] == ("a" if p_value < 0.5 else "open")


def test_poses_are_a_second_opinion_whose_p_value_is_computed_on_request(rng):
    errors = errors_of(rng, 1e-4, 2e-4)
    quick, full = (
        estimates(errors, [(0, 1)], Question(), all_p_values=has_all)[1][0]
        for has_all in (False, True)
    )
    assert np.isnan(quick.p_value) and 0.0 < full.p_value < 1e-6
    assert quick == replace(full, p_value=quick.p_value)


def test_the_interval_over_poses_is_the_middle_of_the_draws(rng):
    """Many poses give the normal interval; equal differences give no width."""
    a, b = np.abs(rng.normal(size=(2, 400)))
    errors = SharedErrors(None, 0.2, pose_errors(np.arange(400), np.column_stack([a, b, b + 1.0])))
    ((pair, equal),) = estimates(errors, [(0, 1), (2, 1)], Question())
    half = 1.96 * (a - b).std() / 20.0
    assert pair.high - pair.low == pytest.approx(2 * half, rel=0.05)
    assert (pair.low + pair.high) / 2 == pytest.approx((a - b).mean(), abs=0.1 * half)
    assert (equal.low, equal.high) == pytest.approx((1.0, 1.0))


def test_a_value_that_is_no_mean_over_rows_is_decided_only_by_its_splits():
    of_splits = np.array([[1.0, 2.0], [1.1, 2.2], [0.9, 2.1]])
    for values, verdicts in ((of_splits, ["a"]), (None, None)):
        errors = SharedErrors(values, 0.2, None)
        assert decide_pairs(errors, [(0, 1)], Question(rope=0.0)) == verdicts
        assert (corrected_p_values(errors) is None) == (verdicts is None)
