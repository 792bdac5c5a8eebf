"""Regions in which one model is better: made differences are found, noise is not."""

from __future__ import annotations

import numpy as np
import pytest

from helpers.compared_results import N_POSES, case_in, made_data, spread, store_results
from stiff_bench.analysis.comparison import paired_results
from stiff_bench.analysis.comparison_text import place_text
from stiff_bench.analysis.verdict import Question
from stiff_bench.analysis.where import best_divisions, where_better
from stiff_bench.store.samples import data_content, stored_data

ALL = [np.arange(N_POSES)]
APART = {"a": spread(1e-4, 1e-5, 1), "b": spread(2e-4, 1e-5, 2)}


def places_in(folder, tests=ALL, **models):
    case, data = case_in(store_results(folder, models, tests=tests))
    return where_better(*paired_results(case, "a", "b"), data, Question()), data


def worse_where(mask, by=3e-4):
    """Return errors of about 0.1 mm that are larger at some rows."""
    errors = 1e-4 + np.random.default_rng(1).normal(0.0, 1e-5, N_POSES) + by * mask

    def of(_, rows):
        return np.column_stack([errors[rows], np.zeros((len(rows), 2))])

    return of


def test_a_model_that_is_worse_under_heavy_loads_is_worse_only_there(tmp_path):
    force = np.linalg.norm(made_data().samples.wrench[:, :3], axis=1)
    heavy = force > np.quantile(force, 2 / 3)
    places, _ = places_in(tmp_path, a=spread(1e-4, 1e-5, seed=2), b=worse_where(heavy))
    light, middle, hard = [
        place for place in best_divisions(places) if place.factor.name == "force"
    ]
    assert [place.verdict for place in (light, middle, hard)] == ["equivalent", "equivalent", "a"]
    assert hard.values == pytest.approx((force[heavy].min(), force.max()))
    difference = hard.means[0] - hard.means[1]
    assert difference == pytest.approx(-3e-4, rel=0.1)
    assert hard.estimate.low < difference < hard.estimate.high < -2e-4
    assert (light.n_samples, middle.n_samples, hard.n_samples) == (14, 13, 13)
    assert place_text(hard) == f"force {hard.values[0]:.0f} to {hard.values[1]:.0f} N"


def test_the_division_of_each_kind_that_explains_most_is_shown(tmp_path):
    data = made_data()
    torque = np.abs(stored_data(data_content(data)).torque[:, 3])
    high = data.samples.group == "far"
    b = worse_where((torque > np.quantile(torque, 2 / 3)) + 1.0 * high)
    places, stored = places_in(tmp_path, a=spread(1e-4, 1e-5, seed=2), b=b)
    np.testing.assert_array_equal(stored.tcp, data.robot.tcp_position(data.samples.q))
    factor_names = {place.factor.kind: place.factor.name for place in best_divisions(places)}
    assert factor_names["joint torque"] == f"torque on {stored.robot.joint_names[3]}"
    assert factor_names["pose region"] == "part of the plan"
    assert [p.values for p in best_divisions(places) if p.factor.kind == "pose region"] == [
        "far",
        "near",
    ]
    # group, reach, height, force, six joints; the loads have no torque at the TCP to divide by
    assert len(places) == 2 + 9 * 3


def test_noise_gives_no_verdict(tmp_path):
    for seed in range(3):
        places, _ = places_in(
            tmp_path / str(seed), a=spread(0.0, 1e-3, 2 * seed), b=spread(0.0, 1e-3, 2 * seed + 1)
        )
        assert {place.verdict for place in places} == {"open"}


def test_p_values_are_corrected_for_all_places_that_were_looked_at(tmp_path):
    places, _ = places_in(tmp_path, a=spread(1e-4, 1e-6), b=worse_where(np.ones(N_POSES)))
    largest = 2 * 0.5**13  # A is better at each of 13 poses
    assert min(place.estimate.p_value for place in best_divisions(places)) > largest
    assert {place.verdict for place in places} == {"a"}


@pytest.mark.parametrize(("n_tested", "n_places"), [(8, 0), (30, 0), (33, 2 + 9 * 3)])
def test_a_division_needs_enough_poses_in_every_part(tmp_path, n_tested, n_places):
    all_rows = np.arange(N_POSES)
    # ten of a group are left
    spare_rows = all_rows[(all_rows >= N_POSES // 2) & (all_rows < N_POSES - 10)]
    tested_rows = (
        all_rows[:8] if n_tested == 8 else np.setdiff1d(all_rows, spare_rows[: N_POSES - n_tested])
    )
    places, _ = places_in(tmp_path, [tested_rows], **APART)
    assert len(places) == n_places
    assert bool(best_divisions(places)) == (n_places > 0)


def test_a_sample_that_several_splits_test_counts_once(tmp_path):
    once_places, thrice_places = (
        places_in(tmp_path / str(times), ALL * times, **APART)[0] for times in (1, 3)
    )
    assert [p.n_samples for p in once_places] == [p.n_samples for p in thrice_places]
    assert [p.estimate.p_value for p in once_places] == pytest.approx(
        [p.estimate.p_value for p in thrice_places]
    )
