"""Options chosen in the fit: what inner fits are given, what is chosen, what is refused."""

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
    """Predicts the mean of its rows plus |level - 3| mm; remembers what it was given."""

    def __init__(self, level=0.0, epochs=True, other="a"):
        self.level = level
        self.epochs = epochs
        self.other = other

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
    """A function that makes samples of numbered poses, two rows each, of small deflections."""

    def make(first, n_poses):
        pose = np.repeat(np.arange(first, first + n_poses), 2)
        q = np.repeat(pose[:, None].astype(float), 6, axis=1)
        deflection = rng.normal(scale=1e-5, size=(len(pose), 3))
        return samples_with(q, np.zeros(q.shape), deflection, pose_id=pose.astype(str))

    return make


def poses(samples):
    return set(samples.pose_id.tolist()) if samples is not None else set()


def chosen(search, train, validation=None, seed=4):
    return search.fit(train, robot=None, validation=validation, seed=seed).best_params_


def test_the_obviously_better_candidate_is_chosen_and_fitted_to_all_of_the_training_side(samples):
    train = samples(0, 12)
    search = InnerSearch(Shifted(), {"level": (0.0, 1.0, 3.0, 7.0)})
    assert chosen(search, train) == {"level": 3.0}
    (*_, (params, last, _, seed)) = FITS
    assert params["level"] == 3.0 and last is train and seed == 4
    assert all(validation is None for _, _, validation, _ in FITS)  # as there are none
    assert sorted({len(fit) for _, fit, _, _ in FITS}) == [16, 24]
    np.testing.assert_allclose(search.predict(train.q, train.wrench)[0], train.deflection.mean(0))
    errors = [tried.error for tried in search.scores_]
    np.testing.assert_allclose(errors, [3e-3 * 3**0.5, 2e-3 * 3**0.5, 0, 4e-3 * 3**0.5], atol=4e-5)
    assert search.diagnostics_["level"] == 3.0 and search.diagnostics_["candidates"] == 4.0
    assert search.diagnostics_["inner error of the chosen [mm]"] == 1e3 * min(errors)


def test_every_pose_is_scored_once_by_fits_that_did_not_see_it(samples):
    train, validation = samples(0, 12), samples(12, 3)
    chosen(InnerSearch(Shifted(), {"level": (0.0, 1.0)}, folds=4), train, validation)
    everything = poses(train) | poses(validation)
    *inner, (_, last, last_validation, _) = FITS
    assert last is train and last_validation is validation
    assert len(inner) == 2 * 4
    for four in (inner[:4], inner[4:]):  # a candidate after the other
        unseen = [everything - poses(fit) - poses(chooses) for _, fit, chooses, _ in four]
        assert set.union(*unseen) == everything and sum(map(len, unseen)) == 15
    for _, fit, chooses, _ in inner:
        assert poses(fit) and poses(chooses) and not poses(fit) & poses(chooses)
        assert poses(fit) | poses(chooses) < everything


def test_a_candidate_that_chooses_no_epoch_learns_from_the_validation_rows(samples):
    train, validation = samples(0, 12), samples(12, 3)
    search = InnerSearch(Shifted(level=3.0), {"epochs": (True, False), "level": (3.0,)})
    chosen(search, train, validation)
    sizes = {(params["epochs"], len(fit), len(poses(chooses))) for params, fit, chooses, _ in FITS}
    assert sizes >= {(True, 16, 2), (False, 20, 0)}  # 10 of 15 poses with two rows
    assert search.chooses_epoch()  # one of them does
    search.set_params(grid={"epochs": (False,)})
    chosen(search, train, validation)
    _, last, nothing, _ = FITS[-1]
    assert nothing is None and poses(last) == poses(train) | poses(validation)


def test_the_first_of_equally_good_candidates_is_chosen(samples):
    grid = {"other": ("b", "a"), "level": (7.0, 5.0, 1.0)}  # the last two are as far from 3
    assert chosen(InnerSearch(Shifted(), grid), samples(0, 12)) == {"other": "b", "level": 5.0}


@pytest.mark.parametrize(
    ("wrong", "search", "message"),
    [
        (-1.0, "grid", "level=-1.0 left out: ValueError: level -1 is neg"),
        (np.inf, "grid", "level=inf left out: .*not finite"),
        (-1.0, "optuna", "level=-1.0 left out"),
    ],
)
def test_a_candidate_that_fails_is_left_out_and_that_is_said(wrong, search, message, samples):
    tuned = InnerSearch(Shifted(), {"level": (wrong, 5.0)}, search=search, trials=6, folds=2)
    with pytest.warns(StiffBenchWarning, match=message):
        assert chosen(tuned, samples(0, 12)) == {"level": 5.0}
    assert {tried.params["level"]: tried.failure != "" for tried in tuned.scores_} == {
        wrong: True,
        5.0: False,
    }


def test_when_every_candidate_fails_so_does_the_fit_with_the_firsts_reason(samples):
    search = InnerSearch(Shifted(), {"level": (-1.0, -2.0)})
    with (
        pytest.warns(StiffBenchWarning),
        pytest.raises(ModelError, match=r"every candidate failed; level=-1\.0: ValueError: le"),
    ):
        chosen(search, samples(0, 12))


def test_with_nothing_to_choose_the_model_is_fitted_once_and_marked(samples):
    search = InnerSearch(Shifted(level=7.0), {})
    assert chosen(search, samples(0, 12)) == {} and len(FITS) == 1
    assert search.regime == "not tuned" and InnerSearch(Shifted(), {"level": (1.0,)}).regime == ""
    assert search.diagnostics_ == {"level": 7.0}


def test_a_drawn_search_comes_near_the_best_value_and_repeats_itself(samples):
    train = samples(0, 12)
    grid = {"level": Range(0.0, 10.0), "other": ("a", "b")}
    search = InnerSearch(Shifted(), grid, search="optuna", trials=30, folds=2)
    first = chosen(search, train)
    assert abs(first["level"] - BEST) < 0.5  # a draw at random: 1 of 10 comes as near
    assert chosen(clone(search), train) == first
    assert chosen(clone(search), train, seed=5) != first
    tried = [each.params["level"] for each in search.scores_]
    late = np.abs(np.array(tried[-10:]) - BEST)
    assert late.mean() < np.abs(np.array(tried[:10]) - BEST).mean()  # it learned where to look
    assert all(float(f"{level:.3g}") == level for level in tried)


def test_ranges_draw_whole_numbers_or_powers_within_their_ends_and_fit_each_candidate_once(samples):
    grid = {"level": Range(1, 4), "other": Range(1e-4, 1e-2, log=True)}
    search = InnerSearch(Shifted(), {"level": Range(1, 4)}, search="optuna", trials=12, folds=2)
    assert chosen(search, samples(0, 12)) == {"level": 3}
    levels = [tried.params["level"] for tried in search.scores_]
    assert len(levels) == len(set(levels)) <= 4 and {type(level) for level in levels} == {int}
    assert len(FITS) == 2 * len(levels) + 1
    chosen(search.set_params(grid=grid), samples(0, 12))
    others = np.array([tried.params["other"] for tried in search.scores_])
    assert 1e-4 <= others.min() < 1e-3 < others.max() <= 1e-2


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
            "cannot be compared.*target labels not trained on",
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
        chosen(InnerSearch(Shifted(), {"level": (1.0,)}), samples(0, 2))


def test_without_optuna_a_drawn_search_says_how_to_get_it_and_a_grid_is_tried(samples, monkeypatch):
    monkeypatch.setitem(sys.modules, "optuna", None)
    drawn = InnerSearch(Shifted(), {"level": (1.0,)}, search="optuna")
    for search in (drawn.check_params, lambda: chosen(drawn, samples(0, 12))):
        with pytest.raises(
            ConfigError, match=r"needs the package optuna: pip install 'stiffbench\[tun"
        ):
            search()
    InnerSearch(Shifted(), {}, search="optuna").check_params()  # there is nothing to search
    assert chosen(InnerSearch(Shifted(), {"level": (1.0, 2.0)}), samples(0, 12)) == {"level": 2.0}


def test_it_keeps_the_contract_of_models_but_for_what_it_is_there_for():
    """It takes its model by place, and a model that chooses no epoch learns from all rows."""

    def make():
        return InnerSearch(NearestNeighbours(), {"neighbours": (1, 3)})

    checks = check_model(make, FanucR2000iC().load(), uses_validation=False)
    assert {check.name for check in checks if check.status == "failed"} == {
        "the constructor takes keywords and only stores them",
        "validation rows are not learned from",
    }
    assert sum(check.status == "passed" for check in checks) > 10
