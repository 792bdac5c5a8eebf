"""Check options chosen in the fit: inner rows, the choice, and errors."""

from __future__ import annotations

import sys

import numpy as np
import pytest
from sklearn.base import BaseEstimator, clone

from helpers.made_samples import samples_with
from stiff_datasets.measured.fanuc_r2000ic import FanucR2000iC
from stiff_models.regressors.regressor_model import NearestNeighbours
from stiff_models.transfer.dt_cnn import DtCnn
from stiff_models.transfer.ft_mlp import FtMlp
from stiff_protocols.conformance.model_checks import check_model
from stiff_protocols.contract.errors import (
    ConfigError,
    ModelError,
    NotFittedError,
    StiffBenchWarning,
)
from stiff_protocols.contract.plugin import Range
from stiff_protocols.tuning.inner_search import InnerSearch

FITS = []
BEST = 3.0


class Shifted(BaseEstimator):
    """Predict the mean plus |level - 3| mm, and record the arguments of `fit`."""

    def __init__(self, level=0.0, epochs=True, label="a"):
        self.level = level
        self.epochs = epochs
        self.label = label

    def chooses_epoch(self):
        return self.epochs

    def fit(self, train, *, robot, validation=None, seed=0):
        if self.level < 0:
            raise ValueError(f"level {self.level:g} is negative")
        FITS.append((self.get_params(), train, validation, seed))
        self.mean_ = train.deflection.mean(axis=0)
        self.diagnostics_ = {"level": self.level}
        return self

    def predict(self, q, wrench):
        return np.tile(self.mean_ + 1e-3 * abs(self.level - BEST), (len(q), 1))


@pytest.fixture(autouse=True)
def no_fits():
    FITS.clear()


@pytest.fixture()
def samples(rng):
    """Return a function that makes numbered poses of two rows with small deflections."""

    def make(first, n_poses):
        pose = np.repeat(np.arange(first, first + n_poses), 2)
        q = np.repeat(pose[:, None].astype(float), 6, axis=1)
        deflection = rng.normal(scale=1e-5, size=(len(pose), 3))
        return samples_with(q, np.zeros(q.shape), deflection, pose_id=pose.astype(str))

    return make


def poses(samples):
    return set(samples.pose_id.tolist()) if samples is not None else set()


def fit_and_choose(search, train, validation=None, seed=4):
    return search.fit(train, robot=None, validation=validation, seed=seed).best_params_


def test_the_obviously_better_candidate_is_chosen_and_fitted_to_all_of_the_training_side(samples):
    train = samples(0, 12)
    search = InnerSearch(Shifted(), {"level": (0.0, 1.0, 3.0, 7.0)})
    assert fit_and_choose(search, train) == {"level": 3.0}
    (*_, (params, last_train, _, seed)) = FITS
    assert params["level"] == 3.0 and last_train is train and seed == 4
    assert all(validation is None for _, _, validation, _ in FITS)  # as there are none
    assert sorted({len(train_rows) for _, train_rows, _, _ in FITS}) == [16, 24]
    np.testing.assert_allclose(search.predict(train.q, train.wrench)[0], train.deflection.mean(0))
    errors = [candidate.error for candidate in search.scores_]
    np.testing.assert_allclose(errors, [3e-3 * 3**0.5, 2e-3 * 3**0.5, 0, 4e-3 * 3**0.5], atol=4e-5)
    assert search.diagnostics_["level"] == 3.0 and search.diagnostics_["candidates"] == 4.0
    assert search.diagnostics_["inner error of the chosen [mm]"] == 1e3 * min(errors)


def test_every_pose_is_scored_once_by_fits_that_did_not_see_it(samples):
    train, validation = samples(0, 12), samples(12, 3)
    fit_and_choose(InnerSearch(Shifted(), {"level": (0.0, 1.0)}, folds=4), train, validation)
    all_poses = poses(train) | poses(validation)
    *inner_fits, (_, last_train, last_validation, _) = FITS
    assert last_train is train and last_validation is validation
    assert len(inner_fits) == 2 * 4
    for candidate_fits in (inner_fits[:4], inner_fits[4:]):  # a candidate after the other
        unseen_poses = [
            all_poses - poses(train_rows) - poses(epoch_rows)
            for _, train_rows, epoch_rows, _ in candidate_fits
        ]
        assert set.union(*unseen_poses) == all_poses and sum(map(len, unseen_poses)) == 15
    for _, train_rows, epoch_rows, _ in inner_fits:
        assert poses(train_rows) and poses(epoch_rows) and not poses(train_rows) & poses(epoch_rows)
        assert poses(train_rows) | poses(epoch_rows) < all_poses


def test_a_candidate_that_chooses_no_epoch_learns_from_the_validation_rows(samples):
    train, validation = samples(0, 12), samples(12, 3)
    search = InnerSearch(Shifted(level=3.0), {"epochs": (True, False), "level": (3.0,)})
    fit_and_choose(search, train, validation)
    sizes = {
        (params["epochs"], len(train_rows), len(poses(epoch_rows)))
        for params, train_rows, epoch_rows, _ in FITS
    }
    assert sizes >= {(True, 16, 2), (False, 20, 0)}  # 10 of 15 poses with two rows
    assert search.chooses_epoch()  # one of them does
    search.set_params(grid={"epochs": (False,)})
    fit_and_choose(search, train, validation)
    _, last_train, last_validation, _ = FITS[-1]
    assert last_validation is None and poses(last_train) == poses(train) | poses(validation)


def test_the_first_of_equally_good_candidates_is_chosen(samples):
    grid = {"label": ("b", "a"), "level": (7.0, 5.0, 1.0)}  # the last two are as far from 3
    assert fit_and_choose(InnerSearch(Shifted(), grid), samples(0, 12)) == {
        "label": "b",
        "level": 5.0,
    }


@pytest.mark.parametrize(
    ("bad_level", "search", "message"),
    [
        (-1.0, "grid", "level=-1.0 left out: ValueError: level -1 is neg"),
        (np.inf, "grid", "level=inf left out: .*not finite"),
        (-1.0, "optuna", "level=-1.0 left out"),
    ],
)
def test_a_candidate_that_fails_is_left_out_and_that_is_said(bad_level, search, message, samples):
    tuned = InnerSearch(Shifted(), {"level": (bad_level, 5.0)}, search=search, trials=6, folds=2)
    with pytest.warns(StiffBenchWarning, match=message):
        assert fit_and_choose(tuned, samples(0, 12)) == {"level": 5.0}
    assert {candidate.params["level"]: candidate.failure != "" for candidate in tuned.scores_} == {
        bad_level: True,
        5.0: False,
    }


def test_when_every_candidate_fails_so_does_the_fit_with_the_firsts_reason(samples):
    search = InnerSearch(Shifted(), {"level": (-1.0, -2.0)})
    with (
        pytest.warns(StiffBenchWarning),
        pytest.raises(ModelError, match=r"every candidate failed; level=-1\.0: ValueError: le"),
    ):
        fit_and_choose(search, samples(0, 12))


def test_with_nothing_to_choose_the_model_is_fitted_once_and_marked(samples):
    search = InnerSearch(Shifted(level=7.0), {})
    assert fit_and_choose(search, samples(0, 12)) == {} and len(FITS) == 1
    assert search.regime == "not tuned" and InnerSearch(Shifted(), {"level": (1.0,)}).regime == ""
    assert search.diagnostics_ == {"level": 7.0}


def test_a_drawn_search_comes_near_the_best_value_and_repeats_itself(samples):
    train = samples(0, 12)
    grid = {"level": Range(0.0, 10.0), "label": ("a", "b")}
    search = InnerSearch(Shifted(), grid, search="optuna", trials=30, folds=2)
    first = fit_and_choose(search, train)
    assert abs(first["level"] - BEST) < 0.5  # a draw at random: 1 of 10 comes as near
    assert fit_and_choose(clone(search), train) == first
    assert fit_and_choose(clone(search), train, seed=5) != first
    levels = [candidate.params["level"] for candidate in search.scores_]
    late_distance = np.abs(np.array(levels[-10:]) - BEST)
    assert (
        late_distance.mean() < np.abs(np.array(levels[:10]) - BEST).mean()
    )  # it learned where to look
    assert all(float(f"{level:.3g}") == level for level in levels)


def test_ranges_draw_whole_numbers_or_powers_within_their_ends_and_fit_each_candidate_once(samples):
    grid = {"level": Range(1, 4), "label": Range(1e-4, 1e-2, log=True)}
    search = InnerSearch(Shifted(), {"level": Range(1, 4)}, search="optuna", trials=12, folds=2)
    assert fit_and_choose(search, samples(0, 12)) == {"level": 3}
    levels = [candidate.params["level"] for candidate in search.scores_]
    assert len(levels) == len(set(levels)) <= 4 and {type(level) for level in levels} == {int}
    assert len(FITS) == 2 * len(levels) + 1
    fit_and_choose(search.set_params(grid=grid), samples(0, 12))
    labels = np.array([candidate.params["label"] for candidate in search.scores_])
    assert 1e-4 <= labels.min() < 1e-3 < labels.max() <= 1e-2


@pytest.mark.parametrize(
    ("model", "grid", "message"),
    [
        (Shifted(), {"level": Range(0.0, 1.0)}, "level is a range, which search=grid cannot try"),
        (
            FtMlp(device="cpu"),
            {"freeze": ("full", "layers:9")},
            r"^freeze=layers:9: .*does not have the layer '9'",
        ),
        (
            DtCnn(device="cpu"),
            {"supervision": ("none", "fine-tune")},
            "cannot be compared.*trained on simulated deflections only",
        ),
    ],
    ids=["range", "options", "regimes"],
)
def test_candidates_that_make_no_search_are_refused_before_any_fit(model, grid, message):
    with pytest.raises(ConfigError, match=message):
        InnerSearch(model, grid).check_params()


def test_what_comes_before_the_fit_or_from_too_few_poses_is_refused(samples):
    with pytest.raises(NotFittedError, match="call fit before predict"):
        InnerSearch(Shifted(), {}).predict(np.zeros((1, 6)), np.zeros((1, 6)))
    with pytest.raises(ConfigError, match="4 samples of 2 poses"):
        fit_and_choose(InnerSearch(Shifted(), {"level": (1.0,)}), samples(0, 2))


def test_without_optuna_a_drawn_search_says_how_to_get_it_and_a_grid_is_tried(samples, monkeypatch):
    monkeypatch.setitem(sys.modules, "optuna", None)
    drawn_search = InnerSearch(Shifted(), {"level": (1.0,)}, search="optuna")
    for call in (drawn_search.check_params, lambda: fit_and_choose(drawn_search, samples(0, 12))):
        with pytest.raises(
            ConfigError, match=r"needs the package optuna: pip install 'stiffbench\[tun"
        ):
            call()
    InnerSearch(Shifted(), {}, search="optuna").check_params()  # there is nothing to search
    assert fit_and_choose(InnerSearch(Shifted(), {"level": (1.0, 2.0)}), samples(0, 12)) == {
        "level": 2.0
    }


def test_it_keeps_the_contract_of_models_except_for_its_purpose():
    """It takes its model by position. Without a choice of epochs it learns from all rows."""

    def make():
        return InnerSearch(NearestNeighbours(), {"neighbours": (1, 3)})

    checks = check_model(make, FanucR2000iC().load(), uses_validation=False)
    assert {check.name for check in checks if check.status == "failed"} == {
        "the constructor takes keywords and only stores them",
        "validation rows are not learned from",
    }
    assert sum(check.status == "passed" for check in checks) > 10
