"""Models never receive a test deflection, except under protocols marked for it."""

from __future__ import annotations

import sys
from contextlib import suppress
from dataclasses import replace

import numpy as np
import pytest

from helpers.run_requests import computed, with_model
from helpers.sealed_samples import Leak, computed_under_seal, with_other_test_deflections
from stiff_bench.results.columns import metric_tables
from stiff_bench.results.notes import SELECTION_MARK, TRAINING_MARK
from stiff_bench.tables.writers import render
from stiff_models.model_catalog import FAMILIES, MODELS, model_info
from stiff_protocols.contract.errors import ConfigError
from stiff_protocols.protocol_catalog import PROTOCOLS
from stiff_protocols.scoring.metrics import metric
from stiff_protocols.splits.random_splits import Holdout, PaperHoldout

SEEN = []
MAE = [metric("mae")]
KEYS = [*(info.key for info in MODELS), *(family.example for family in FAMILIES)]
FAIR = [info.key for info in PROTOCOLS if info.key != "paper-holdout"]
READ_ON_ALL = "paper-holdout@read_on=all"
SMALL_ENSEMBLE = {"width": 8, "pretrain_steps": 5, "epochs": 10, "members": 2}
QUICKER = {"deep-ensemble": SMALL_ENSEMBLE}
"""Options of a model whose quick options are too slow for several fits."""


class Witness:
    """Records the samples that it receives."""

    def fit(self, train, *, robot, validation=None, seed=0):
        SEEN.append((train, validation))
        return self

    def predict(self, q, wrench):
        return np.zeros((len(q), 3))


@pytest.fixture()
def tasks(tasks_of):
    return lambda model, protocol: tasks_of((model,), "fanuc-r2000ic", protocol)


def given(task):
    """Return the poses in the training, validation and test part of a fit."""
    SEEN.clear()
    computed(with_model(task, Witness))
    ((train, validation),) = SEEN
    test = task.data.samples.take(task.split.test)
    return train, validation, test


def rows(samples):
    return {tuple(row) for row in samples.deflection.tolist()}


@pytest.mark.parametrize(
    ("model", "n_train", "n_validation"),
    [("vjm", 34, 0), ("mlp-pretrained", 34, 0), ("mlp@training=best", 27, 7), ("ft-mlp", 34, 0)],
)
@pytest.mark.parametrize("protocol", ["holdout", "leave-one-out"])
def test_no_fair_protocol_gives_a_model_a_test_deflection(
    model, n_train, n_validation, protocol, tasks
):
    for number, task in enumerate(tasks(model, protocol)[:5]):
        train, validation, test = given(task)
        held_out = set() if validation is None else rows(validation)
        assert not (rows(train) | held_out) & rows(test) and not rows(train) & held_out
        # the model receives all of the training side
        assert len(train) + len(held_out) == 43 - len(test)
        assert bool(held_out) == bool(n_validation)
        if protocol == "holdout" and not number:
            assert (len(train), len(held_out)) == (n_train, n_validation)


def test_under_the_papers_protocol_test_rows_choose_an_epoch_and_nothing_else(tasks):
    train, validation, test = given(tasks("ft-mlp@training=best", "paper-holdout")[0])
    assert rows(validation) == rows(test)
    assert not rows(train) & rows(test)
    train, validation, test = given(tasks("vjm", "paper-holdout")[0])
    assert validation is None and not rows(train) & rows(test)


def as_it_is_and_with_other_test_deflections(task, options, compute_spoiled):
    """Compute a fit twice with these options of its model, and return both predictions."""
    model = replace(task.model, params=options)
    choosing = getattr(model.make(), "chooses_epoch", lambda: task.chooses_epoch)()
    task = replace(task, fit=replace(task.fit, coverage=0.8), model=model, chooses_epoch=choosing)
    second = compute_spoiled(with_other_test_deflections(task)).prediction
    first = computed(task).prediction
    assert (first.measured != second.measured).all()
    return first, second


def assert_the_same(first, second):
    np.testing.assert_array_equal(first.predicted, second.predicted)
    np.testing.assert_array_equal(first.interval.lower, second.interval.lower)
    np.testing.assert_array_equal(first.interval.upper, second.interval.upper)
    np.testing.assert_array_equal(first.reference, second.reference)


@pytest.mark.slow
@pytest.mark.usefixtures("small_source")
@pytest.mark.parametrize("key", KEYS)
def test_no_test_deflection_is_read_before_the_last_prediction_nor_changes_one(
    key, tasks, monkeypatch, tmp_path
):
    """The seal covers identification, scalers, pre-training, intervals and the reference."""
    monkeypatch.setenv("STIFFBENCH_CACHE", str(tmp_path))  # empty: the seal guards what fills it
    info = model_info(key)
    if info.missing():
        pytest.skip(info.missing())
    options = {**info.quick, **QUICKER.get(key, {})}
    task = tasks(key, "holdout")[0]
    assert_the_same(*as_it_is_and_with_other_test_deflections(task, options, computed_under_seal))


@pytest.mark.slow
@pytest.mark.usefixtures("small_source")
@pytest.mark.parametrize("key", ["mlp-pretrained", "ft-mlp", "dt-cnn"])
def test_no_test_pose_or_load_shapes_the_pre_training_that_splits_share(
    key, tasks, trainings, monkeypatch, tmp_path
):
    monkeypatch.setenv("STIFFBENCH_CACHE", str(tmp_path))
    task = tasks(key, "holdout")[0]
    task = replace(task, model=replace(task.model, params=model_info(key).quick))
    samples, test = task.data.samples, task.split.test
    q, wrench = samples.q.copy(), samples.wrench.copy()
    q[test] *= 3.0
    wrench[test] *= 3.0
    elsewhere = replace(task.data, samples=replace(samples, q=q, wrench=wrench))
    diagnostics = []
    for data in (task.data, elsewhere):
        diagnostics.append(computed(replace(task, data=data)).diagnostics)
        assert trainings == ["pre-train"]  # the first one serves both
    assert "source test MAE [mm]" in diagnostics[0] and diagnostics[0] == diagnostics[1]


@pytest.mark.slow
def test_an_ensemble_that_chooses_no_epoch_takes_nothing_from_the_papers_test_rows(tasks):
    task = tasks("deep-ensemble", "paper-holdout")[0]
    assert_the_same(
        *as_it_is_and_with_other_test_deflections(task, SMALL_ENSEMBLE, computed_under_seal)
    )


@pytest.mark.slow
def test_an_ensembles_noise_is_not_that_of_the_papers_test_rows_that_choose_its_epoch(tasks):
    task = tasks("deep-ensemble", "paper-holdout")[0]
    options = SMALL_ENSEMBLE | {"training": "best"}
    first, second = as_it_is_and_with_other_test_deflections(task, options, computed)
    widths = [
        np.max(prediction.interval.upper - prediction.interval.lower)
        for prediction in (first, second)
    ]
    assert max(widths) < 0.1  # m; the deflections are moved by 7 m


@pytest.mark.slow
@pytest.mark.parametrize("protocol", FAIR)
def test_no_fair_protocol_lets_a_test_deflection_be_read_early(protocol, tasks_of):
    tasks = tasks_of(("knn", "mlp@width=4@epochs=1"), protocol=protocol)
    for task in {(task.fit.model, task.fit.condition): task for task in tasks}.values():
        result = computed_under_seal(task)
        truth = task.data.samples.deflection[task.split.test]
        np.testing.assert_array_equal(result.prediction.measured, truth)


@pytest.mark.parametrize("protocol", ["paper-holdout", READ_ON_ALL])
def test_the_papers_protocol_breaks_the_seal_only_for_models_that_choose_an_epoch(protocol, tasks):
    computed_under_seal(tasks("vjm", protocol)[0])
    with pytest.raises(Leak, match=r"read before .*\.fit"):
        computed_under_seal(tasks("mlp@training=best", protocol)[0])


class Thief(Witness):
    """A plugin that searches the stack for the engine's data and hides errors."""

    at = "fit"

    def fit(self, train, *, robot, validation=None, seed=0):
        self.reach("fit")
        return self

    def predict(self, q, wrench):
        self.reach("predict")
        return np.full((len(q), 3), 1e-4)

    def reach(self, stage):
        frame = sys._getframe()
        while self.at == stage and frame is not None:
            task = frame.f_locals.get("task")
            if task is not None:
                with suppress(Exception):
                    self.stolen = task.data.samples.deflection[task.split.test]
            frame = frame.f_back


class ThiefInPredict(Thief):
    at = "predict"


@pytest.mark.parametrize("thief", [Thief, ThiefInPredict])
def test_a_plugin_that_reaches_for_the_engines_data_is_caught(thief, tasks):
    task = with_model(tasks("vjm", "holdout")[0], thief)
    computed(task)  # without the seal it succeeds
    with pytest.raises(Leak, match="read during fit or prediction"):
        computed_under_seal(task)


SIDE = "stiff_protocols.contract.evaluation.training_side"


def all_of(samples):
    return samples.take(np.arange(len(samples)))


def peek(key):
    all_of(sys._getframe(1).f_locals["task"].data.samples)
    return model_info(key)


@pytest.mark.parametrize(
    ("name", "leaky", "words"),
    [
        (SIDE, lambda samples, *_, **__: (all_of(samples), None), r"read before .*\.fit"),
        (SIDE, lambda samples, *_, **__: (samples, None), "read during fit"),
        ("stiff_bench.run.execution.model_info", peek, r"read before .*\.fit"),
    ],
    ids=["all rows are taken", "all data are handed over", "a look before the reference's fit"],
)
def test_an_engine_that_leaks_is_caught(name, leaky, words, tasks, monkeypatch):
    task = tasks("vjm", "holdout")[0]
    monkeypatch.setattr(name, leaky)
    with pytest.raises(Leak, match=words):
        computed_under_seal(task)


@pytest.mark.parametrize("protocol", [*(info.key for info in PROTOCOLS), READ_ON_ALL])
def test_which_rows_train_choose_and_are_reported_is_what_the_protocol_says(protocol, tasks_of):
    for task in tasks_of(protocol=protocol):
        split, presentation = task.split, task.presentation
        assert not len(np.intersect1d(split.train, split.test))
        chosen_on_test = len(np.intersect1d(split.validation, split.test)) > 0
        assert chosen_on_test == presentation.selects_on_test == (protocol not in FAIR)
        more = len(np.setdiff1d(split.reported, split.test)) > 0
        assert more == presentation.reports_training == (protocol == READ_ON_ALL)


def test_a_protocol_that_reports_training_rows_and_does_not_say_so_is_refused(tasks, monkeypatch):
    def honest_words_only(self, samples, *, n_splits, seed):
        (split,) = PaperHoldout(read_on="all").splits(samples, n_splits=n_splits, seed=seed)
        return [split]

    monkeypatch.setattr(Holdout, "splits", honest_words_only)
    monkeypatch.setattr(Holdout, "selects_on_test", True)
    with pytest.raises(ConfigError, match="reports 34 rows that are not test rows, and the prot"):
        tasks("vjm", "holdout")


def test_both_readings_of_the_papers_protocol_are_of_the_same_fit(tasks):
    """Small networks, whose weights and best epochs depend on the seed."""
    for model in ("vjm", "mlp@width=4@epochs=3"):
        tested, read = (
            computed(task) for word in ("paper-holdout", READ_ON_ALL) for task in tasks(model, word)
        )
        assert tested.fit.model_seed == read.fit.model_seed
        assert tested.fit.key != read.fit.key
        assert tested.n_train == read.n_train == 34
        np.testing.assert_array_equal(read.prediction.rows, np.arange(43))
        rows = tested.prediction.rows
        for name in ("predicted", "measured", "reference"):
            of_tested, of_read = (getattr(result.prediction, name) for result in (tested, read))
            # the number of rows in a matrix product changes the rounding of its sums
            np.testing.assert_allclose(of_read[rows], of_tested, rtol=1e-4, atol=1e-9)


def test_a_protocol_that_selects_on_test_and_does_not_say_so_is_refused(tasks, monkeypatch):
    monkeypatch.setattr(PaperHoldout, "selects_on_test", False)
    with pytest.raises(ConfigError, match="9 test rows that choose an epoch, and the protocol doe"):
        tasks("vjm", "paper-holdout")


@pytest.fixture()
def printed(tasks_of):
    """A function that prints results of the witness as two models in every format."""

    def of(models, protocol):
        tasks = tasks_of(models, "fanuc-r2000ic", protocol)
        tables = metric_tables([computed(with_model(task, Witness)) for task in tasks], MAE)
        formats = ("github", "latex", "html", "csv", "json")
        return {fmt: render(tables, fmt, "bench run") for fmt in formats}

    return of


@pytest.mark.parametrize("protocol", ["holdout", "paper-holdout"])
def test_rows_that_were_selected_on_test_carry_the_mark_in_every_format(protocol, printed):
    for fmt, text in printed(("vjm", "mlp@training=best"), protocol).items():
        *before_marks, _ = text.split(SELECTION_MARK)
        assert bool(before_marks) == (protocol == "paper-holdout"), fmt
        assert all(before.rindex("mlp") > before.rfind("vjm") for before in before_marks), fmt
        warned = bool(before_marks) and fmt != "csv"  # which has only the mark
        assert ("picks the best epoch on the very samples it reports" in text) == warned, fmt


def test_every_row_that_is_read_on_all_samples_carries_the_mark_in_every_format(printed):
    for fmt, text in printed(("vjm", "mlp"), READ_ON_ALL).items():
        assert text.count(TRAINING_MARK) >= 2, fmt
        for note in ("its errors are no test errors", "trains on 34 samples and reports 43"):
            assert fmt == "csv" or note in text, fmt
