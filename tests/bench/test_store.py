"""Results on disk: whole or absent, checked, and at full precision."""

from __future__ import annotations

import hashlib
import json
import math
import os
from dataclasses import replace

import numpy as np
import pytest

from stiff_bench.checked_json import DamagedFile
from stiff_bench.store import ResultStore, read_manifests, read_results
from stiff_bench.stored_data import read_data
from stiff_datasets.fanuc_r2000ic import FanucR2000iC
from stiff_models.kinematics import jacobian
from stiff_protocols.cost import Cost
from stiff_protocols.errors import StoreError
from stiff_protocols.record import (
    Cell,
    CellResult,
    Presentation,
    ResultRecord,
    RunManifest,
)
from stiff_protocols.types import Interval, Prediction

SHOWN = Presentation("m@a=2", "d", "p", "simulated", "stiffness", caveats=("beware",))
CELL = Cell("m", {"a": 1, "b": 2.5}, "d", {}, "00", "p", {}, 0, "11", 0)


def result(**changes) -> CellResult:
    numbers = np.array([[1 / 3, 2e-17, -0.1]])
    return CellResult(
        **(
            {
                "cell": CELL,
                "shown": SHOWN,
                "run_id": "r",
                "status": "ok",
                "records": (ResultRecord("mae", "x", 1 / 3, "m"),),
                "prediction": Prediction(np.array([4]), numbers, numbers * 7, None, numbers / 3),
                "cost": Cost(1.5, 0.1, 1e-5, 1e5, None),
                "diagnostics": {"k1": math.nan, "k2": math.inf, "k3": 0.1},
                "warnings": ("careful",),
            }
            | changes
        )
    )


def only(store: ResultStore) -> CellResult:
    (found,) = read_results(store.folder)
    return found


def test_a_cell_comes_back_as_it_was_written_to_the_last_bit(tmp_path):
    store = ResultStore(tmp_path)
    store.write_cell(result())
    back = only(store)
    assert back.cell == CELL and back.records == result().records
    assert back.shown == SHOWN and back.cost == result().cost
    np.testing.assert_array_equal(back.prediction.predicted, result().prediction.predicted)
    np.testing.assert_array_equal(back.prediction.measured, result().prediction.measured)
    np.testing.assert_array_equal(back.prediction.reference, result().prediction.reference)
    assert math.isnan(back.diagnostics["k1"]) and back.diagnostics["k2"] == math.inf


def test_intervals_come_back_to_the_last_bit(tmp_path):
    numbers = np.array([[1 / 3, 2e-17, -0.1]])
    interval = Interval(numbers - 1 / 7, numbers + 1 / 7, 0.9)
    cell = replace(CELL, coverage=0.9)
    prediction = Prediction(np.array([4]), numbers, numbers, interval)
    store = ResultStore(tmp_path)
    store.write_cell(result(cell=cell, prediction=prediction, calibration_samples=11))
    back = only(store)
    assert back.cell == cell and back.calibration_samples == 11
    assert back.prediction.interval.coverage == 0.9
    np.testing.assert_array_equal(back.prediction.interval.lower, interval.lower)
    np.testing.assert_array_equal(back.prediction.interval.upper, interval.upper)


def test_a_result_without_the_intervals_that_were_asked_for_is_read(tmp_path):
    cell = replace(CELL, coverage=0.9)  # the training side was too small for them
    store = ResultStore(tmp_path)
    store.write_cell(result(cell=cell))
    assert only(store).prediction.interval is None


def test_a_file_of_another_format_is_refused_with_both_numbers(tmp_path):
    store = ResultStore(tmp_path)
    path = store.write_cell(result())
    path.write_text(path.read_text().replace('"schema":3', '"schema":1'))
    with pytest.raises(StoreError, match="stored format 1, this stiffbench reads 3"):
        only(store)


def test_a_run_does_not_add_to_a_folder_of_another_format(tmp_path):
    path = ResultStore(tmp_path).write_cell(result())
    path.write_text(path.read_text().replace('"schema":3', '"schema":2'))
    with pytest.raises(StoreError, match=r"--output .* format 2, this stiffbench writes 3"):
        ResultStore(tmp_path)


def test_a_folder_keeps_the_samples_of_its_results_with_the_joints_torques(tmp_path):
    data = FanucR2000iC().load()
    ResultStore(tmp_path).write_data(data)
    back = read_data(tmp_path / "data", data.sha256)
    np.testing.assert_array_equal(back.samples.wrench, data.samples.wrench)
    assert back.samples.pose_id.tolist() == data.samples.pose_id.tolist()
    torque = np.einsum("nki,nk->ni", jacobian(data.robot, data.samples.q), data.samples.wrench)
    np.testing.assert_allclose(back.torque, torque, atol=1e-9)
    assert back.joint_names == data.robot.joint_names and back.robot == data.robot.name


def test_samples_that_are_missing_or_damaged_are_said_to_be(tmp_path):
    with pytest.raises(StoreError, match="cannot be read"):
        read_data(tmp_path, "00")
    for rubbish in ("no zip", ""):
        (tmp_path / "00.npz").write_text(rubbish)
        with pytest.raises(StoreError, match="damaged"):
            read_data(tmp_path, "00")


def test_damaged_samples_are_written_anew(tmp_path):
    data = FanucR2000iC().load()
    store = ResultStore(tmp_path)
    store.write_data(data)
    (path,) = (tmp_path / "data").iterdir()
    path.write_bytes(path.read_bytes()[:300])
    store.write_data(data)
    assert len(read_data(tmp_path / "data", data.sha256).samples) == 43


def test_every_result_of_a_folder_is_read_failures_too(tmp_path):
    store = ResultStore(tmp_path)
    store.write_cell(result())
    other = replace(CELL, split_index=1)
    store.write_cell(result(cell=other, status="failed", records=(), prediction=None, cost=None))
    assert {(each.cell.split_index, each.status) for each in read_results(tmp_path)} == {
        (0, "ok"),
        (1, "failed"),
    }


def test_the_key_of_a_cell_without_intervals_is_what_it_was_before_there_were_any():
    assert CELL.key == "8a49b67bbeadb3aae6d65663"
    assert replace(CELL, coverage=0.9).key != CELL.key
    assert replace(CELL, coverage=0.9).key != replace(CELL, coverage=0.8).key


def test_stored_files_are_strict_json(tmp_path):
    path = ResultStore(tmp_path).write_cell(result())

    def refuse(word):
        raise ValueError(word)

    json.loads(path.read_text(), parse_constant=refuse)


def test_a_changed_or_cut_file_is_found_damaged(tmp_path):
    store = ResultStore(tmp_path)
    path = store.write_cell(result())
    text = path.read_text()
    for damage in (text.replace("careful", "careless"), text[: len(text) // 2], ""):
        path.write_text(damage)
        with pytest.raises(StoreError, match="damaged"):
            only(store)


def test_a_file_under_another_cells_name_is_found(tmp_path):
    path = ResultStore(tmp_path).write_cell(result())
    path.rename(path.with_name("0123456789abcdef01234567.json"))
    with pytest.raises(StoreError, match=f"holds the cell {CELL.key}, which is another"):
        list(read_results(tmp_path))


def test_a_whole_file_without_a_cell_in_it_is_damaged(tmp_path):
    path = ResultStore(tmp_path).write_cell(result())
    checksum = hashlib.sha256(b"{}").hexdigest()
    path.write_text(f'{{"schema":3,"sha256":"{checksum}","content":{{}}}}\n')
    with pytest.raises(StoreError, match=r"damaged: KeyError: 'cell'"):
        list(read_results(tmp_path))


def test_the_checksum_is_over_the_bytes_of_the_content(tmp_path):
    raw = ResultStore(tmp_path).write_cell(result()).read_bytes()
    head, _, content = raw.partition(b'"content":')
    assert content.endswith(b"}}\n")
    assert hashlib.sha256(content[:-2]).hexdigest() == json.loads(head + b'"":0}')["sha256"]


def test_text_that_no_file_can_hold_is_stored_with_a_question_mark(tmp_path):
    """A file's name on a command line may hold bytes that are no character."""
    store = ResultStore(tmp_path)
    store.write_cell(result(failure="M\xfcller \udcff.csv"))
    assert only(store).failure == "M\xfcller ?.csv"


def test_temporary_files_that_a_killed_run_left_are_no_results(tmp_path):
    path = ResultStore(tmp_path).write_cell(result())
    path.with_name(".abc.tmp.json").write_text("half")
    assert len(list(read_results(tmp_path))) == 1


def test_a_write_that_fails_leaves_the_old_result_and_no_rubbish(tmp_path, monkeypatch):
    store = ResultStore(tmp_path)
    path = store.write_cell(result())
    before = path.read_text()

    def full_disk(*_):
        raise OSError(28, "No space left on device")

    monkeypatch.setattr("os.replace", full_disk)
    with pytest.raises(StoreError, match="No space left"):
        store.write_cell(result(warnings=()))
    assert path.read_text() == before
    assert [item.name for item in path.parent.iterdir()] == [path.name]


def test_a_folder_that_cannot_be_made_is_refused(tmp_path):
    (tmp_path / "file").write_text("")
    with pytest.raises(StoreError, match="cannot be written"):
        ResultStore(tmp_path / "file" / "results")


def test_a_manifest_comes_back_as_it_was_written(tmp_path):
    store = ResultStore(tmp_path)
    manifest = RunManifest("r", "bench run", "2026-01-01", "finished", {"numpy": "2"}, ("k",))
    store.write_manifest(manifest)
    assert list(read_manifests(tmp_path)) == [manifest]


def test_a_cells_key_does_not_depend_on_the_order_of_options():
    assert replace(CELL, model_params={"b": 2.5, "a": 1}).key == CELL.key


@pytest.mark.parametrize(
    "change",
    [
        {"dataset": "x"},
        {"dataset_params": {"seed": 1}},
        {"data_sha256": "x"},
        {"protocol": "x"},
        {"protocol_params": {"f": 1}},
        {"split_index": 1},
        {"split_sha256": "x"},
        {"seed": 1},
    ],
)
def test_a_cells_key_and_seed_change_with_everything_that_can_change_its_result(change):
    other = replace(CELL, **change)
    assert other.key != CELL.key and other.model_seed != CELL.model_seed


@pytest.mark.parametrize(
    "change",
    [
        {"model": "x"},
        {"model_params": {}},
        {"coverage": 0.9},
        {"condition": "noise x5"},
        {"source_sha256": "x"},
        {"split_sha256": "rows and errors", "rows_sha256": CELL.split_sha256},
    ],
    ids=str,
)
def test_what_does_not_change_the_rows_has_a_key_of_its_own_and_shares_the_seed(change):
    other = replace(CELL, **change)
    assert other.key != CELL.key and other.model_seed == CELL.model_seed


@pytest.mark.parametrize("status", ["failed", "skipped"])
def test_a_failure_never_replaces_a_result_and_a_result_clears_the_failure(tmp_path, status):
    store = ResultStore(tmp_path)
    failed = result(status=status, records=(), prediction=None, failure="out of memory")
    kept = store.write_cell(result())
    noted = store.write_cell(failed)
    assert only(store).status == "ok" and kept != noted
    store.write_cell(result())
    assert kept.exists() and not noted.exists()


def test_a_damaged_file_that_is_set_aside_is_kept_and_never_read(tmp_path):
    store = ResultStore(tmp_path)
    path = store.write_cell(result())
    path.write_text("{")
    with pytest.raises(DamagedFile) as caught:
        only(store)
    assert caught.value.path == path
    for _ in range(2):  # as two runs would
        store.set_aside(path)
    assert not list(read_results(tmp_path))
    assert path.with_name(f"{path.name}.damaged").read_text() == "{"


def test_a_damaged_file_that_was_written_anew_is_not_set_aside(tmp_path):
    store = ResultStore(tmp_path)
    path = store.write_cell(result())
    store.set_aside(path)
    assert [one.name for one in path.parent.iterdir()] == [path.name]


def test_a_file_that_cannot_be_set_aside_is_said(tmp_path, monkeypatch):
    path = ResultStore(tmp_path).write_cell(result())
    path.write_text("{")

    def refuse(*_):
        raise OSError(30, "Read-only file system")

    monkeypatch.setattr("os.rename", refuse)
    with pytest.raises(StoreError, match=f"{path}: cannot be renamed: Read-only"):
        ResultStore(tmp_path).set_aside(path)


def test_a_file_is_on_the_disk_before_its_name_is_and_the_name_before_anything_else(
    tmp_path, monkeypatch
):
    """So that a power cut loses nothing that was reported as stored."""
    steps: list[str] = []
    monkeypatch.setattr("stiff_protocols.files.flush_to_disk", lambda path: steps.append(path.name))
    rename = os.replace

    def noted(source, target):
        steps.append("rename")
        rename(source, target)

    monkeypatch.setattr("os.replace", noted)
    monkeypatch.setattr("os.rename", noted)
    ResultStore(tmp_path).write_cell(result())
    file, *rest = steps
    assert file.endswith(".tmp.json") and rest == ["rename", "cells"]


def test_a_failure_in_the_place_of_a_result_is_found(tmp_path):
    path = ResultStore(tmp_path).write_cell(result())
    path.rename(path.with_suffix(".failed.json"))
    with pytest.raises(StoreError, match="damaged: its status is 'ok'"):
        list(read_results(tmp_path))


@pytest.mark.parametrize("content", ["[]", "{}", '{"run_id": 1, "cells": 2}'])
def test_a_whole_file_without_a_manifest_in_it_is_damaged(tmp_path, content):
    store = ResultStore(tmp_path)
    path = store.write_manifest(RunManifest("r", "bench", "now", "finished", {}, ()))
    checksum = hashlib.sha256(content.encode()).hexdigest()
    path.write_text(f'{{"schema":3,"sha256":"{checksum}","content":{content}}}\n')
    with pytest.raises(StoreError, match="damaged"):
        list(read_manifests(tmp_path))
