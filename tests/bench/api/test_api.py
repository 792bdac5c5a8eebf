"""`import stiffbench`: data, models and results in scripts and notebooks."""

from __future__ import annotations

import gc
import re
import subprocess
import sys
from dataclasses import replace
from functools import partial
from pathlib import Path

import numpy as np
import pandas as pd
import pytest
from sklearn.base import BaseEstimator
from sklearn.linear_model import Ridge
from sklearn.pipeline import make_pipeline
from sklearn.preprocessing import StandardScaler

import stiffbench as sb
from stiff_bench.figures.figure_catalog import FIGURES
from stiff_bench.paper.paper_figures import FIGURES as PAPERS
from stiff_bench.plan.registry import registry
from stiff_datasets.measured.table_reader import sample_table, write_table
from stiff_protocols.contract.errors import (
    ConfigError,
    DataError,
    NotFittedError,
    StiffBenchError,
    StiffBenchWarning,
    StoreError,
)


@pytest.fixture(scope="module")
def twin():
    return sb.load_dataset("kr10-twin", specimen=3)


class Halved(BaseEstimator):
    """A model defined in a notebook: half of the mean training deflection."""

    def __init__(self, *, factor: float = 0.5) -> None:
        self.factor = factor

    def fit(self, train, *, robot, validation=None, seed=0):
        self.mean_ = self.factor * train.deflection.mean(axis=0)
        return self

    def predict(self, q, wrench):
        return np.tile(self.mean_, (len(q), 1))


def script(tmp_path: Path, text: str) -> list[str]:
    """Run a script and return the lines that it prints."""
    path = tmp_path / "script.py"
    path.write_text(text)
    done = subprocess.run([sys.executable, path], capture_output=True, text=True, timeout=120)
    assert done.returncode == 0, done.stderr
    return done.stdout.splitlines()


def test_importing_the_package_imports_nothing_heavy_and_every_name_is_there(tmp_path):
    heavy = "{'numpy', 'torch', 'pandas', 'pinocchio'}"
    assert script(tmp_path, f"import sys, stiffbench; print({heavy} & {{*sys.modules}})") == [
        "set()"
    ]
    assert all(getattr(sb, name) is not None for name in dir(sb))
    with pytest.raises(AttributeError, match="nothing_such"):
        _ = sb.nothing_such


def test_options_are_checked_and_become_part_of_the_name():
    assert sb.load_dataset("kr10-twin", specimen=3).name == "kr10-twin@specimen=3"
    assert sb.make_model("knn", neighbours=3).name == "knn@neighbours=3"
    assert sb.make_model("knn@neighbours=3").name == sb.make_model("knn", neighbours=3).name
    with pytest.raises(ConfigError, match="neighbours"):
        sb.make_model("knn", neighbors=3)
    assert type(sb.make_model("knn", neighbours=np.int64(3)).choice.params["neighbours"]) is int
    with pytest.raises(ConfigError, match="kr10-twin"):
        sb.load_dataset("kr10-twn")


def test_a_model_fits_predicts_scores_and_is_the_same_after_a_file(twin, tmp_path):
    model = sb.make_model("vjm")
    with pytest.raises(NotFittedError):
        model.predict(twin.samples.q, twin.samples.wrench)
    predicted = model.fit(twin).predict(twin.samples.q, twin.samples.wrench)
    assert predicted.shape == (len(twin), 3)
    assert model.diagnostics["rank"] == 6.0
    errors = model.score(twin).set_index(["metric", "axis"])
    mean_x = 1000.0 * np.abs(predicted - twin.samples.deflection)[:, 0].mean()
    assert errors.loc[("mae", "x"), "value"] == pytest.approx(mean_x, rel=1e-12)
    assert errors.loc[("mae", "x"), "unit"] == "mm"
    model.save(tmp_path / "vjm.stiff")
    again = sb.load_model(tmp_path / "vjm.stiff")
    np.testing.assert_array_equal(again.predict(twin.samples.q, twin.samples.wrench), predicted)
    assert again.name == "vjm"


def test_a_model_warns_once_beyond_its_training_range_also_after_a_file(twin, tmp_path):
    samples = twin.samples
    fitted = sb.make_model("vjm").fit(twin)
    fitted.save(tmp_path / "vjm.stiff")
    for model in (fitted, sb.load_model(tmp_path / "vjm.stiff")):
        training_range = model.training_range
        np.testing.assert_array_equal(training_range.upper, samples.q.max(axis=0))
        model.predict(samples.q, samples.wrench)  # a warning would be an error
        with pytest.warns(StiffBenchWarning) as caught:
            for _ in range(2):
                model.predict(samples.q[:3], 5.0 * samples.wrench[:3])
        (warning,) = (str(warning_record.message) for warning_record in caught)
        largest = 5.0 * np.linalg.norm(samples.wrench[:3, :3], axis=1).max()
        for part in ("3 of 3", f"force {largest:.4g} N", f"{training_range.force:.4g}"):
            assert part in warning


def test_a_model_that_chooses_its_epoch_gets_poses_to_choose_by_and_says_so(twin, monkeypatch):
    model, seen = sb.make_model("mlp", training="best"), {}

    def fit(self, train, *, robot, validation, seed):
        seen.update(train=train, validation=validation)

    monkeypatch.setattr(model.choice.cls, "fit", fit)
    model.fit(twin, seed=5)
    parts = [set(seen[name].pose_id) for name in ("train", "validation")]
    assert not parts[0] & parts[1]
    assert parts[0] | parts[1] == set(twin.samples.pose_id)
    assert f"{len(parts[1])} poses" in model.note
    assert sb.make_model("vjm").fit(twin).note == ""


def test_frames_files_and_arrays_hold_the_same_samples(twin, tmp_path):
    file = tmp_path / "mine.csv"
    write_table(file, [sample_table(twin.samples, twin.robot)])
    of_file = sb.read_samples(file, robot=twin.robot)
    of_frame = sb.Dataset.from_frame(twin.frame(), twin.robot)
    of_arrays = sb.Dataset.from_samples(of_file.samples, twin.robot, name="arrays")
    assert of_file.data.sha256 == of_frame.data.sha256 == of_arrays.data.sha256
    assert (of_file.name, of_arrays.name) == ("mine.csv", "arrays")
    with pytest.raises(ConfigError, match="robot 'kr11'"):
        sb.read_samples(file, robot="kr11")


@pytest.mark.parametrize(
    ("what", "kind"),
    [
        ("", "unknown"),
        ("MEASURED: 43 samples", "measured"),
        ("SIMULATED: never MEASURED", "simulated"),
    ],
)
def test_a_users_file_is_of_the_kind_that_its_card_says(twin, tmp_path, what, kind):
    file = tmp_path / "mine.csv"
    data = sb.Dataset.from_samples(twin.samples, twin.robot)
    data.frame().to_csv(file, index=False)
    if what:
        file.with_suffix(".md").write_text(f"| Fact | Value |\n|---|---|\n| What | {what} |\n")
    of_file = sb.read_samples(file, robot=twin.robot)
    assert (of_file.choice.info.kind, data.choice.info.kind) == (kind, "unknown")


def test_two_data_sets_of_one_name_are_refused_and_one_given_twice_is_computed_once(twin):
    first = sb.Dataset.from_samples(twin.samples, twin.robot)
    second = sb.Dataset.from_samples(twin.samples, twin.robot)
    with pytest.raises(ConfigError, match=r"'own-data'.*name="):
        sb.evaluate("zero", [first, second])
    once, twice = (sb.evaluate("zero", data).frame() for data in (first, [first, first]))
    assert len(once) == len(twice) > 0


@pytest.mark.slow
def test_results_are_tidy_data_tables_comparisons_and_ranks(twin):
    results = sb.evaluate(["vjm", "knn"], twin, protocol="kfold@folds=3")
    assert len(results.fits) == 2 * 3
    frame = results.frame()
    assert len(frame) == 2 * 3
    split_errors = frame.set_index(["model", "split"]).loc[("vjm", 0)]
    predictions = results.predictions()
    assert len(predictions) == 2 * len(twin)
    split_predictions = predictions[(predictions.model == "vjm") & (predictions.split == 0)]
    mae = (split_predictions.dx_predicted_mm - split_predictions.dx_mm).abs().mean()
    assert mae == pytest.approx(split_errors["mae_x_mm"], rel=1e-12)
    assert "vjm" in repr(results)
    assert "<table" in results._repr_html_()
    assert "vjm" in repr(results.compare("vjm", "knn"))
    board = results.leaderboard().tables[0]
    assert str(board.rows[0][0]) == "vjm"
    assert len(results.leaderboard(metric="mae", axis="x").frame())
    assert "stiffness A1 [Nm/rad]" in set(results.diagnostics()["diagnostic"])


@pytest.mark.slow
def test_kept_results_are_read_again_and_not_computed_again(twin, tmp_path):
    first, again = (sb.evaluate("zero", twin, splits=1, output=tmp_path) for _ in range(2))
    assert {fit.run_id for fit in first.fits} == {fit.run_id for fit in again.fits}
    frame, stored = (
        results.frame().sort_values("model", ignore_index=True)
        for results in (again, sb.open_results(tmp_path))
    )
    pd.testing.assert_frame_equal(frame, stored)


@pytest.mark.parametrize(
    ("rows", "expected", "name"),
    [
        (slice(2, 5), [2, 3, 4], "[2:5]"),
        (slice(None, None, 50), [0, 50, 100, 150], "[::50]"),
        ([4, 1], [4, 1], "[2 rows]"),
        (np.arange(151) < 2, [0, 1], "[2 rows]"),
        (-1, [150], "[1 row]"),
    ],
)
def test_rows_of_a_data_set_are_a_data_set_of_its_kind(twin, rows, expected, name):
    part = twin[rows]
    assert part.name == twin.name + name
    np.testing.assert_array_equal(part.samples.q, twin.samples.q[expected])
    np.testing.assert_array_equal(part.samples.pose_id, twin.samples.pose_id[expected])
    assert part.choice.info.kind == "simulated" and part.choice.info.caveats
    assert {len(predictions) for predictions in part.data.bound_deflections.values()} == {
        len(expected)
    }


def test_an_object_of_another_type_is_refused_with_how_to_make_a_data_set(twin):
    model = sb.make_model("zero").fit(twin)
    for use in (partial(sb.evaluate, "zero"), model.fit, model.score):
        with pytest.raises(ConfigError, match=r"dict is not .*Dataset\.from_frame\(frame"):
            use({"q": twin.samples.q})


def test_lists_are_tables_and_show_is_a_text():
    for listed, key in (
        (sb.list_models(), "vjm"),
        (sb.list_datasets(), "kr10-twin"),
        (sb.list_protocols(), "holdout"),
        (sb.list_metrics(), "mae"),
    ):
        assert key in set(listed.frame()["key"])
        assert f"\n{key} " in repr(listed) and f">{key} " in listed._repr_html_()
    assert "neighbours" in repr(sb.show("knn"))
    assert sb.check("zero").passed


def test_results_are_merged_and_drawn(twin, tmp_path):
    sb.evaluate("zero", twin, splits=1, output=tmp_path / "zero")
    assert sb.merge([tmp_path / "zero"], tmp_path / "both").n_fits == 2  # with the reference model
    drawn = sb.figure("errors", sb.open_results(tmp_path / "both").select(models=["zero"]))
    assert "kr10-twin@specimen=3" in drawn.caption
    with pytest.raises(StiffBenchError, match="no result"):
        sb.paper_table(9, sb.open_results(tmp_path / "both"))


@pytest.mark.parametrize(
    ("call", "argument_text"),
    [
        (lambda: sb.make_model("knn@neighbours=many"), "model 'knn@neighbours=many'"),
        (lambda: sb.evaluate("vjm", splits=0), "splits=0"),
        (lambda: sb.evaluate("vjm", coverage=0.9), "coverage 0.9"),
        (lambda: sb.evaluate("vjm", protocol="leave-one-out", splits=3), "splits 3"),
        (lambda: sb.use_plugin("none.py"), "plugin none.py"),
        (lambda: sb.open_results("none").leaderboard(), "results none"),
        (lambda: sb.figure("9", sb.open_results("none").select(models=["gp"])), "model gp"),
        (lambda: sb.plan_poses("x.csv", robot="fanuc-r2000ic"), "payload is unknown for fanuc"),
    ],
)
def test_errors_name_the_argument_and_no_option_of_the_command_line(call, argument_text):
    with pytest.raises(StiffBenchError) as refused:
        call()
    # without the command that makes the missing results
    message = str(refused.value).partition("; `bench run")[0]
    assert argument_text in message and "--" not in message


def test_every_fitted_model_has_intervals(twin):
    samples = twin.samples
    fitted = sb.make_model("vjm").fit(twin)
    interval = fitted.predict_interval(samples.q, samples.wrench)
    errors = fitted.left_out_errors  # at a quarter of 151 poses
    assert errors.shape == (38, 3)
    predicted = fitted.predict(samples.q, samples.wrench)
    stretch = fitted.training_range.stretch(samples.q, samples.wrench)[:, None]
    half = np.sort(errors, axis=0)[35] * stretch  # ceil(0.9 * 39) = 36
    np.testing.assert_allclose(interval.upper - predicted, half)
    np.testing.assert_allclose(predicted - interval.lower, half)


def test_a_coverage_that_needs_more_poses_is_refused_by_the_arguments_name(twin, tmp_path):
    few = sb.Dataset.from_samples(twin.samples.take(np.arange(16)), twin.robot)
    model = sb.make_model("vjm").fit(few)
    few.frame().to_csv(tmp_path / "loads.csv")
    with pytest.raises(ConfigError, match=r"^coverage 0\.9: vjm left out 8 poses.*at most 0\.8889"):
        model.predict_file(tmp_path / "loads.csv", tmp_path / "out.csv", coverage=0.9)
    model.predict_interval(few.samples.q, few.samples.wrench, 0.88)


@pytest.mark.parametrize("coverage", [1.0, float("nan")])
def test_a_coverage_outside_0_to_1_is_refused_before_anything_is_predicted(
    coverage, twin, tmp_path
):
    model = sb.make_model("gp", ard=False, restarts=0, search_rows=20).fit(twin)
    for call in (model.predict_file, partial(sb.compensate_path, model)):
        with pytest.raises(ConfigError, match=rf"^coverage {coverage:g}: must lie between 0 and 1"):
            call(tmp_path / "none.csv", tmp_path / "out.csv", coverage=coverage)


@pytest.mark.slow
def test_temporary_results_leave_no_folder(twin):
    results = sb.evaluate("zero", twin, splits=1)
    folder = results.folder
    assert folder.exists()
    del results
    gc.collect()
    assert not folder.exists()


def test_classes_of_a_script_run_but_are_never_kept(twin, tmp_path):
    of_script = type("Mine", (Halved,), {"__module__": "__main__"})
    assert len(sb.evaluate([of_script, "vjm"], twin, splits=1).leaderboard().frame()) > 0
    for option in ({"output": tmp_path / "kept"}, {"jobs": 2}):
        with pytest.raises(ConfigError, match="Mine"):
            sb.evaluate(of_script, twin, splits=1, **option)
    assert not (tmp_path / "kept").exists()


@pytest.mark.slow
def test_a_plugins_file_is_named_after_use_plugin(plugin_file, twin):
    registry.cache_clear()
    sb.use_plugin(plugin_file("still"))
    assert sb.make_model("still").fit(twin).predict(np.zeros((2, 6)), np.zeros((2, 6))).any()
    assert "still" in set(sb.list_models().frame()["key"])
    registry.cache_clear()


def test_every_figure_is_listed_with_what_it_shows():
    rows = {row[0]: row[1] for row in sb.list_figures().tables[0].rows}
    assert rows.keys() == {*FIGURES, *PAPERS} and all(rows.values())


class ManyOptions(Halved):
    def __init__(self, **options) -> None:
        super().__init__(**options)


class LikeAnEstimator(Halved):
    def fit(self, X, y):
        return self


class vjm(Halved):
    """A class with the key of a shipped model."""


@pytest.mark.slow
def test_objects_of_classes_and_of_scikit_learn_run_with_their_options_in_the_names(twin):
    models = [Halved(), Halved(factor=2), sb.make_model(Halved, factor=3.0), Ridge(alpha=0.1)]
    frame = sb.evaluate(models, twin, splits=1).frame().set_index("model")
    names = ["Halved", "Halved@factor=2", "Halved@factor=3.0"]
    assert [*frame.index] == ["vjm", *names, "sklearn:linear_model.Ridge@alpha=0.1"]
    assert (frame["status"] == "ok").all() and frame["norm_mm"].nunique() == 5
    assert sb.make_model(Ridge).name == "sklearn:linear_model.Ridge"
    assert sb.make_model(Halved(factor=2), factor=4.0).name == "Halved@factor=4.0"


@pytest.mark.parametrize(
    ("model", "cause"),
    [
        (5, "int is not a model"),
        (None, "NoneType is not a model"),
        (ManyOptions(), r"make_model\(ManyOptions"),
        (Halved(factor=np.ones(2)), r"make_model\(Halved"),
        (LikeAnEstimator(), r"'LikeAnEstimator' has fit\(X, y\).*fit\(self, train"),
        (make_pipeline(StandardScaler(), Ridge()), "requires .steps."),
        (vjm(), "'vjm' is the key of stiffbench"),
    ],
)
def test_what_is_no_model_or_hides_its_options_is_refused_with_what_to_give(model, cause):
    with pytest.raises(ConfigError, match=cause):
        sb.make_model(model)


def test_a_class_of_a_script_from_standard_input_is_fitted(twin, monkeypatch):
    monkeypatch.setattr(sys.modules["__main__"], "__file__", "<stdin>", raising=False)
    local = type("FromInput", (Halved,), {"__module__": "__main__"})
    frame = sb.evaluate([local, local(factor=2.0)], twin, splits=1).frame()
    assert [*frame["model"]] == ["vjm", "FromInput", "FromInput@factor=2.0"]
    assert (frame["status"] == "ok").all()


@pytest.mark.parametrize(
    ("call", "right"),
    [
        (lambda data: sb.evaluate("vjm", dataset=data), "did you mean 'datasets'"),
        (lambda data: sb.evaluate(model="vjm"), "did you mean 'models'"),
        (lambda data: sb.read_samples("my.csv", robots="ur5"), "did you mean 'robot'"),
        (lambda data: sb.validate(data.samples), "Samples is not a file"),
        (lambda data: sb.validate(data, robot="ur5"), "robot is part of the data set"),
        (lambda data: sb.Dataset("my.csv"), r"str is not a data set.*read_samples"),
        (lambda data: sb.read_samples("my.csv", robot="ur5", tcp=(0, 0, 0)), "load_robot.*tcp="),
        (lambda data: sb.read_samples("my.csv", robot="my.urdf"), "read_robot or --urdf"),
        (lambda data: sb.make_model("vjm").fit(data.frame()), "robot=... in fit$"),
        (lambda data: sb.read_samples(data.frame(), robot="ur5"), "DataFrame is not a file"),
        (lambda data: sb.load_model(sb.make_model("vjm")), "Model is not a file"),
        (lambda data: sb.load_dataset(data), "Dataset is not the name"),
        (lambda data: sb.Dataset.from_frame("my.csv", data.robot), "str is not a DataFrame"),
        (lambda data: data["fz_N"], r"frame\(\)\['fz_N'\]"),
        (lambda data: data[["fz_N", "q1_deg"]], r"frame\(\)\['fz_N', 'q1_deg'\]|frame"),
    ],
)
def test_a_wrong_argument_or_type_is_named_with_the_right_one(twin, call, right):
    with pytest.raises(ConfigError, match=right):
        call(twin)


def test_a_dataset_names_its_frame_for_what_only_tables_have(twin):
    with pytest.raises(AttributeError, match=r"frame\(\)\.head"):
        twin.head()
    with pytest.raises(AttributeError, match=r"use \.samples\.wrench"):
        twin.wrench  # noqa: B018
    with pytest.raises(AttributeError, match=r"no 'nothing_such'$"):
        twin.nothing_such()


def test_a_model_predicts_a_data_set_of_its_own_robot_only(twin):
    model = sb.make_model("vjm").fit(twin)
    q, wrench = twin.samples.q, twin.samples.wrench
    assert np.array_equal(model.predict(twin), model.predict(q, wrench))
    same, interval = model.predict_interval(q, wrench), model.predict_interval(twin)
    assert np.array_equal(interval.lower, same.lower)
    tool = sb.load_robot("kr10-r1100-2", tcp=(0.0, 0.0, 0.1))
    for data in (sb.Dataset.from_samples(twin.samples, tool), sb.load_dataset("ur5-twin")):
        with pytest.raises(ConfigError, match="was fitted to"):
            model.predict(data)
    with pytest.raises(ConfigError, match="wrench"):
        model.predict(twin, wrench)


def test_joint_angles_in_degrees_are_refused_with_their_row(twin):
    degrees = np.degrees(twin.samples.q)
    row = int(np.argmax((np.abs(degrees) > 6.0 * np.pi).any(axis=1)))
    with pytest.raises(DataError, match=rf"row {row}, joint .*numpy\.radians"):
        sb.Dataset.from_samples(replace(twin.samples, q=degrees), twin.robot)
    with pytest.raises(DataError, match=rf"row {row}, joint .*numpy\.radians"):
        sb.make_model("vjm").fit(twin).predict(degrees, twin.samples.wrench)


def test_results_that_cannot_be_read_say_so_in_their_text_and_name_the_folder_of_a_study(tmp_path):
    (tmp_path / "runs").mkdir()
    for folder, cause in [(tmp_path, str(tmp_path / "runs")), (tmp_path / "new", "no such folder")]:
        results = sb.open_results(folder)
        assert cause in repr(results) and cause in results._repr_html_()
        with pytest.raises(StoreError, match=re.escape(cause)):
            results.frame()
