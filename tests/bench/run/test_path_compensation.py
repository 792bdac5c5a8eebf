"""`path-compensation` in the engine: model inputs, scores, and comparisons."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from helpers.run_requests import computed, planned, with_model
from stiff_bench.plan.fits import fit_tasks, made_model
from stiff_bench.results.columns import metric_tables
from stiff_bench.results.load import StoredResults, newest_tasks
from stiff_bench.results.notes import same_name_other_data
from stiff_bench.run.execution import Execution, fit_input
from stiff_bench.run.fit import fit_and_predict
from stiff_bench.run.runner import run_fits
from stiff_bench.store.database import ResultStore, read_data
from stiff_protocols.contract.record import PATH_ERROR
from stiff_protocols.splits.path_compensation import PathCompensation

PATHS = "path-compensation"
SEEN = []


class Witness:
    """Records its inputs, and predicts the mean training deflection."""

    def fit(self, train, *, robot, validation=None, seed=0):
        SEEN.extend([train, robot, validation])
        self.mean_ = train.deflection.mean(axis=0)
        return self

    def predict(self, q, wrench):
        SEEN.extend([q, wrench])
        return np.tile(self.mean_, (len(q), 1))

    def use_source(self, source):
        SEEN.append(source)


def listed(models=("vjm",), protocols=(PATHS,), splits=2):
    return list(fit_tasks(planned(models=models, protocols=protocols, metrics=(), splits=splits)))


@pytest.fixture(scope="module")
def tasks():
    return listed(("vjm", "zero"))


@pytest.fixture(scope="module")
def stored(tasks, tmp_path_factory):
    folder = tmp_path_factory.mktemp("paths")
    every = [*tasks, *listed(("vjm", "zero"), ("holdout",))]
    done = run_fits(every, "bench run", ResultStore(folder), Execution())
    return folder, done.results


@pytest.fixture(scope="module")
def results(stored):
    return [result for result in stored[1] if result.presentation.protocol == PATHS]


@pytest.fixture(scope="module")
def stored_tasks(stored):
    return stored[0], {task.name.protocol: task for task in StoredResults.read(stored[0]).tasks}


def witnessed(task):
    """Return the inputs of a model in a fit."""
    SEEN.clear()
    computed(with_model(task, Witness))
    return SEEN


@pytest.mark.slow
def test_no_model_is_given_the_robot_that_answers(tasks):
    assert tasks[0].data.under_load is not None
    assert not any(hasattr(item, "under_load") or callable(item) for item in witnessed(tasks[0]))
    SEEN.clear()
    made_model(with_model(tasks[0], Witness).model, tasks[0].data)
    assert SEEN[0].samples is tasks[0].data.samples and SEEN[0].under_load is None


@pytest.mark.slow
def test_a_model_of_another_point_corrects_paths_for_the_tcp_with_intervals_there():
    (task,) = listed(("vjm@tcp=fit",), splits=1)
    given = fit_input(replace(task, fit=replace(task.fit, coverage=0.9)))
    fitted = fit_and_predict(task.model, given).fitted
    model = task.model.make().fit(given.train, robot=given.robot)
    at_tcp = PathCompensation().commanded(model.predict_at_tcp, given.robot, given.q, given.wrench)
    np.testing.assert_array_equal(fitted.commands, at_tcp)
    predicted = model.predict_at_tcp(at_tcp, given.wrench)
    np.testing.assert_array_equal(fitted.predicted, predicted)
    middle = 0.5 * (fitted.interval.lower + fitted.interval.upper)
    away = np.linalg.norm(middle - model.predict(at_tcp, given.wrench), axis=1).mean()
    assert np.linalg.norm(middle - predicted, axis=1).mean() < 0.5 * away  # of a second fit


@pytest.mark.slow
def test_other_answers_of_the_robot_change_no_fit_and_no_command(tasks, results):
    def constant_answer(q, wrench):
        return np.full((len(q), 3), 7.0)

    task = tasks[0]
    spoiled = computed(replace(task, data=replace(task.data, under_load=constant_answer)))
    assert spoiled.diagnostics == results[0].diagnostics
    remaining_error = spoiled.prediction.measured - spoiled.prediction.predicted
    command = remaining_error - 7.0  # p_cmd - p: what the model corrected
    rows = task.split.test
    train = task.data.samples.take(task.training_rows)
    model = task.model.make().fit(train, robot=task.data.robot)
    predicted = model.predict(task.data.samples.q[rows], task.data.samples.wrench[rows])
    assert np.abs(command + predicted).max() < 0.02 * np.abs(predicted).max()


@pytest.mark.slow
def test_the_table_shows_path_errors_and_the_rows_that_no_model_may_know(results):
    (table,) = metric_tables(results, ())
    assert [column.about["metric"] for column in table.columns if column.about] == [
        *("norm", "norm-p95", "norm-max", "removed")
    ]
    names = [row[0].text for row in table.rows]
    assert names == ["vjm", "zero", "oracle", "no correction"]
    assert any("path errors" in note for note in table.notes)


@pytest.mark.slow
def test_results_with_and_without_paths_are_of_the_same_data_set(stored_tasks):
    folder, of_protocol = stored_tasks
    every = [*of_protocol.values()]
    assert len({task.name.data_sha256 for task in every}) == 2
    assert list(same_name_other_data(every, lambda sha256: read_data(folder, sha256))) == []
    assert {task.name.protocol for task in newest_tasks(every)} == {PATHS, "holdout"}


@pytest.mark.slow
def test_holdout_with_paths_has_the_fits_and_errors_of_holdout():
    with_paths, without = (
        [computed(task) for task in listed(("vjm-full",), (protocol,))]
        for protocol in ("holdout-paths", "holdout")
    )
    for result, plain in zip(with_paths, without, strict=True):
        np.testing.assert_array_equal(result.prediction.predicted, plain.prediction.predicted)
        assert not result.presentation.measured_sha256
        assert result.fit.data_sha256 == plain.fit.data_sha256


@pytest.mark.slow
def test_the_remaining_error_on_paths_with_holdout_equals_path_compensation():
    both_result, path_result = (
        computed(listed(("vjm-full",), (protocol,), splits=1)[0])
        for protocol in ("holdout-paths", PATHS)
    )
    remaining_error = np.linalg.norm(
        path_result.prediction.measured - path_result.prediction.predicted, axis=1
    )
    assert both_result.diagnostics[PATH_ERROR] == pytest.approx(1e3 * remaining_error.mean())


def test_a_measured_robot_has_no_paths_with_holdout():
    plan = planned(
        models=("vjm",), datasets=("fanuc-r2000ic",), protocols=("holdout-paths",), splits=1
    )
    (task,) = fit_tasks(plan)
    result = computed(task)
    assert result.status == "ok" and PATH_ERROR not in result.diagnostics
