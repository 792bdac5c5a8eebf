"""`nested` through the engine: candidates, options, and rows that it never sees."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from helpers.run_requests import computed, planned
from helpers.sealed_samples import with_other_test_deflections
from stiff_bench.plan.fits import fit_tasks
from stiff_models.model_catalog import MODELS
from stiff_protocols.contract.errors import ConfigError
from stiff_protocols.contract.plugin import Range


def tasks(*models, protocol="nested", splits=1, coverage=False, settings=()):
    plan = planned(
        models=models,
        datasets=("fanuc-r2000ic",),
        protocols=(protocol,),
        metrics=("mae", "width") if coverage else ("mae",),
        splits=splits,
        settings=settings,
        coverage=0.8 if coverage else None,
    )
    return list(fit_tasks(plan))


def grids(tasks_of_models):
    return {task.model.info.key: dict(task.model.grid) for task in tasks_of_models}


@pytest.fixture()
def grid_file(tmp_path, monkeypatch):
    """A function that writes a grid file and returns the protocol's name with it."""
    monkeypatch.chdir(tmp_path)

    def write(text, *, search="grid"):
        Path("my.toml").write_text(text, encoding="utf-8")
        return f"nested@grid=my.toml@search={search}"

    return write


@pytest.mark.slow
@pytest.mark.parametrize("key", ["knn", "vjm-gp"])  # split-conformal intervals, and its own
def test_choice_prediction_and_intervals_do_not_change_with_the_test_deflections(key):
    protocol = "nested@inner_folds=2"
    fixed = "@restarts=0@ard=false" if key == "vjm-gp" else ""
    (task,) = tasks(key + fixed, protocol=protocol, coverage=True)
    first, second = computed(task), computed(with_other_test_deflections(task))
    assert (first.prediction.measured != second.prediction.measured).all()
    assert first.chosen == second.chosen and first.chosen
    assert first.diagnostics == pytest.approx(second.diagnostics, rel=0, abs=0, nan_ok=True)
    for prediction in (first.prediction, second.prediction):
        np.testing.assert_array_equal(prediction.predicted, first.prediction.predicted)
        np.testing.assert_array_equal(prediction.interval.upper, first.prediction.interval.upper)
    assert (first.calibration_samples > 0) == (key == "knn")


@pytest.mark.slow
def test_a_fit_sees_only_the_training_side_and_calibration_poses_choose_nothing(monkeypatch):
    seen = []
    (task,) = tasks("knn", coverage=True)
    fit = task.model.cls.fit

    def watched(self, train, **options):
        seen.append(set(train.pose_id.tolist()))
        return fit(self, train, **options)

    monkeypatch.setattr(task.model.cls, "fit", watched)
    result = computed(task)
    samples, split = task.data.samples, task.split
    side = set(samples.pose_id[np.concatenate([split.train, split.validation])].tolist())
    assert not set().union(*seen) & set(samples.pose_id[split.test].tolist())
    n_fits = 8 * 3 + 1  # eight candidates on three inner parts, and the chosen one
    chosen, calibrated = seen[:n_fits], seen[n_fits:]
    assert len(calibrated) == len(chosen) == n_fits and chosen[-1] == side
    assert len(side - set().union(*calibrated)) == result.calibration_samples


def test_an_option_that_the_user_set_is_not_searched():
    searched = grids(tasks("knn@neighbours=2", "gp", settings=("gp.ard=false", "gp.kernel=rbf")))
    assert searched == {"knn": {"weights": ("uniform", "distance")}, "gp": {}}


@pytest.mark.slow
def test_every_named_grid_of_the_catalogue_fits_its_model():
    names = {name for info in MODELS for name in info.grids}
    assert names >= {"default", "freeze-single", "freeze-pairs", "rate", "physics"}
    keys = [info.key for info in MODELS if not info.missing()]
    for name in names:
        searched = grids(tasks(*keys, protocol=f"nested@grid={name}"))
        expected = {info.key: set(info.grids.get(name, {})) for info in MODELS if info.key in keys}
        assert {key: set(grid) for key, grid in searched.items()} == expected


@pytest.mark.slow
def test_a_cells_key_depends_on_the_candidates_and_not_only_on_the_files_name(grid_file):
    keys = {
        tasks("knn", protocol=grid_file(f"[knn]\nneighbours = {values}", search=search))[0].fit.key
        for values, search in [
            ("[1, 2]", "grid"),
            ("[1, 3]", "grid"),
            ("[1, 2]", "optuna"),
            ("{low = 1, high = 2}", "optuna"),
        ]
    }
    assert len(keys) == 4
    assert tasks("knn")[0].fit.model_params["neighbours"] == ["1", "3", "5", "10"]


def test_values_of_a_file_get_their_options_types(grid_file):
    text = """
    [ft-mlp]
    freeze = ["full", "layers:1,2"]
    epochs = ["none", 5]
    learning_rate = {low = 1e-4, high = 1, log = true}
    [knn]
    neighbours = {low = 1, high = 9}
    ["sklearn:ensemble.RandomForestRegressor"]
    max_features = ["sqrt", 0.5]
    bootstrap = [true, false]
    """
    forest = "sklearn:ensemble.RandomForestRegressor"
    searched = grids(tasks("ft-mlp", "knn", forest, protocol=grid_file(text, search="optuna")))
    assert searched == {
        "ft-mlp": {
            "freeze": ("full", "layers:1,2"),
            "epochs": (None, 5),
            "learning_rate": Range(1e-4, 1.0, log=True),
        },
        "knn": {"neighbours": Range(1, 9)},
        forest: {"max_features": ("sqrt", 0.5), "bootstrap": (True, False)},
    }
    assert type(searched["ft-mlp"]["learning_rate"].high) is float
    assert (
        searched["knn"]["neighbours"].is_integer
        and not searched["ft-mlp"]["learning_rate"].is_integer
    )


@pytest.mark.parametrize(
    ("text", "parts"),
    [
        ("[knn]\nneighbors = [1]", ["knn.neighbors: unknown knn option", "mean 'neighbours'"]),
        ("[knn]\nneighbours = 3", ["knn.neighbours is 3 (valid: a list of values"]),
        ("[knn]\nneighbours = {low = 3, high = 3}", ["low 3 must lie below high 3"]),
        ("[knn]\nneighbours = {low = 1, high = 3}", ["is a range, which search=grid cannot try"]),
        ("[ft-mlp]\nepochs = {low = 0, high = 9, log = true}", ["low 0 has no logarithm"]),
        (
            "[ft-mlp]\nfreeze = ['full', 'layers:7']",
            ["freeze=layers:7: ", "does not have the layer '7'"],
        ),
        ("[ft-mpl]\nfreeze = ['full']", ["has tables for ft-mpl, none for", "(ft-mlp, knn)"]),
        ("[knn", ["not TOML: "]),
    ],
)
def test_a_wrong_file_is_refused_before_anything_is_loaded(text, parts, grid_file, monkeypatch):
    monkeypatch.setattr("stiff_bench.plan.fits.loaded", lambda _: pytest.fail("data were loaded"))
    with pytest.raises(ConfigError) as raised:
        tasks("ft-mlp", "knn", protocol=grid_file(text))
    message = str(raised.value)
    assert "grid=my.toml: " in message and "\n" not in message
    for part in parts:
        assert part in message
