"""`open_results(folder)`: frames never mix what the tables keep apart."""

from __future__ import annotations

import shutil
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pandas as pd
import pytest

import stiffbench as sb
from helpers.made_results import N_TEST, MadeResults
from stiff_bench.results.results import open_results
from stiff_protocols.contract.errors import StiffBenchWarning

CASE = Path(__file__).parents[4] / "shared" / "cases" / "data" / "01_frame_mixes_old_and_new"
OLD, NEW = {"run_id": "20260101T"}, {"run_id": "20270101T"}


def newest(read: Callable[[], pd.DataFrame], message: str) -> pd.DataFrame:
    """Return a frame, which warns of older results."""
    with pytest.warns(StiffBenchWarning, match=message):
        return read()


@pytest.mark.slow
@pytest.mark.skipif(not CASE.exists(), reason="the cases of the maintainers are not here")
def test_a_file_that_was_corrected_and_run_again_has_only_its_new_fits(tmp_path):
    robot = sb.read_robot(CASE / "arm.urdf", tcp=(0.06, 0.0, 0.08))
    file, folder = tmp_path / "my.csv", tmp_path / "results"
    means = []
    for version in ("wrong_sign.csv", "corrected.csv"):
        shutil.copy(CASE / version, file)
        data = sb.read_samples(file, robot=robot)
        fits = sb.evaluate("vjm", data, splits=3, output=folder).frame()
        means.append(fits["norm_mm"].mean())
    assert means == pytest.approx([1.0311, 0.0361], abs=5e-5)
    fits = newest(open_results(folder).frame, "my.csv is the name of different data here: samples")
    assert len(fits) == 3 and fits["norm_mm"].mean() == pytest.approx(0.036145, abs=5e-7)
    assert {*fits["data_sha256"]} == {data.data.sha256}
    assert (open_results(folder).predictions().groupby("split").size() == 12).all()


def test_fits_on_older_data_of_a_name_are_in_no_frame(made):
    made.add_each({"vjm": [1.0] * 3, "net": [9.0] * 3}, version=1, **OLD)
    made.add("vjm", [2.0] * 3, **NEW)
    results = open_results(made.folder)
    fits = newest(results.frame, "twin is the name of different data here: samples")
    assert fits["norm_mm"].tolist() == pytest.approx([2.0] * 3)
    assert {*fits["run"]} == {NEW["run_id"]} and {*fits["model"]} == {"vjm"}
    assert len(results.predictions()) == 3 * N_TEST
    assert len(results.fits) == 9 and len(results.every) == 9  # tables keep them apart


@pytest.mark.parametrize("newer", [{"model_version": "b"}, {"options": {"size": 2}}])
def test_fits_of_an_older_version_or_of_other_options_are_in_no_frame(made, newer):
    older = {"model_version": "a"} if "model_version" in newer else {"options": {"size": 1}}
    made.add("plugin", [1.0] * 3, **older, **OLD)
    made.add("plugin", [8.0] * 3, **newer, **NEW)
    results = open_results(made.folder)
    fits = newest(results.frame, "older results of plugin .* are left out")
    assert fits["norm_mm"].tolist() == pytest.approx([8.0] * 3)
    assert {*fits["model_version"]} == {newer.get("model_version", "")}
    assert len(results.predictions()) == 3 * N_TEST and len(results.every) == 6


def test_a_model_whose_new_version_fails_has_failed_rows_and_not_the_old_numbers(made):
    made.add("plugin", [1.0] * 3, model_version="a", **OLD)
    made.add("plugin", [1.0] * 3, failed=range(3), model_version="b", **NEW)
    results = open_results(made.folder)
    fits = newest(results.frame, "older results of plugin with another version")
    assert fits["status"].tolist() == ["failed"] * 3
    assert {*fits["failure"]} == {"it broke"} and "norm_mm" not in fits
    assert results.predictions().empty


def test_fits_on_older_splits_or_of_an_earlier_run_of_a_split_are_in_no_frame(made):
    made.add("a", [5.0] * 3, splits_named="old-", **OLD)
    made.add("a", [1.0] * 2, splits_named="new-", run_id="20260601T")
    made.add("a", [2.0] * 2, splits_named="new-", coverage=0.9, **NEW)
    fits = newest(open_results(made.folder).frame, "older results on other splits")
    assert fits["norm_mm"].tolist() == pytest.approx([2.0, 2.0])


def test_a_row_has_the_identity_of_its_fit_and_every_metric_with_its_unit(made):
    made.add("net", [3.0, 4.0], model_version="7", **NEW)
    made.add("net", [5.0], protocol="space", condition="n = 5", seed=3, **NEW)
    fits = open_results(made.folder).frame()
    assert len(fits) == 3
    (of_condition,) = fits[fits["condition"] == "n = 5"].to_dict("records")
    identity = {"model": "net", "dataset": "twin", "kind": "simulated", "protocol": "space"}
    identity |= {"condition": "n = 5", "seed": 3, "split": 0, "run": NEW["run_id"], "status": "ok"}
    assert identity.items() <= of_condition.items() and of_condition["robot"] == "kr10_r1100_2"
    first = fits[fits["condition"] == ""].set_index("split").loc[0]
    values = {"norm_mm": 3.0, "mae_z_mm": 3.0, "mae_x_mm": 0.0, "norm_p95_mm": 3.0, "me_z_mm": 3.0}
    assert first[[*values]].astype(float).to_dict() == pytest.approx(values)
    assert first["removed_percent"] == pytest.approx(
        100.0 * (1.0 - 3.0 / _mean_length(made, "net")), rel=1e-9
    )


def _mean_length(made: MadeResults, model: str) -> float:
    """Return the mean measured length on the first split, mm."""
    predictions = open_results(made.folder).select(protocols=["holdout"]).predictions()
    of_split = predictions[(predictions.model == model) & (predictions.split == 0)]
    return float(np.linalg.norm(of_split[["dx_mm", "dy_mm", "dz_mm"]], axis=1).mean())


def test_a_selection_holds_for_frames_and_an_outdated_name_warns_only_of_itself(made):
    made.add_each({"a": [1.0], "b": [2.0]}, "left", version=1, **OLD)
    made.add_each({"a": [3.0], "b": [4.0]}, "left", **NEW)
    made.add_each({"a": [5.0], "b": [6.0]}, "right", **NEW)
    results = open_results(made.folder)
    assert results.select(models=["a"], datasets=["right"]).frame()["norm_mm"].tolist() == [5.0]
    fits = newest(results.select(models=["b"]).frame, "left is the name of different data")
    assert fits.set_index("dataset")["norm_mm"].to_dict() == pytest.approx(
        {"left": 4.0, "right": 6.0}
    )


@pytest.mark.slow
def test_a_summary_of_several_data_sets_ranks_by_the_truth_where_it_was_asked_for(tmp_path):
    data = ["ur5-twin", "arm-family@world=clean"]
    for metrics, heading in (([], "3-D error"), (["true-norm", "norm"], "true error")):
        results = sb.evaluate("mean", data, splits=1, metrics=metrics, output=tmp_path)
        assert any(table.title.startswith(heading) for table in results.summary().tables)
