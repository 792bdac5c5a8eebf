"""Results on disk: whole or absent, checked, and at full precision."""

from __future__ import annotations

import hashlib
import io
import math
import signal
import sqlite3
import subprocess
import sys
import time
from contextlib import closing
from dataclasses import asdict, replace
from pathlib import Path

import numpy as np
import pandas as pd
import pytest

from helpers.compared_results import made_data
from helpers.made_results import MadeResults, change, tear
from helpers.stored_cells import CELL, MANIFEST, VALUES, failure, result
from stiff_bench.store.damage import fault_of, repair
from stiff_bench.store.database import (
    FILE,
    DamagedFile,
    ResultStore,
    mean_seconds,
    read_data,
    read_manifests,
    read_results,
    stored_results,
    stored_statuses,
    writing,
)
from stiff_bench.store.samples import data_content, stored_data, what_differs
from stiff_bench.store.versions import LIBRARIES, differing_libraries
from stiff_datasets.robots.shipped_robots import shipped_robot, shipped_robots
from stiff_protocols.contract.errors import StoreError
from stiff_protocols.contract.record import CellResult
from stiff_protocols.contract.types import BenchmarkData, Interval, Prediction


def only(folder: Path) -> CellResult:
    (found,) = read_results(folder)
    return found


def many(folder: Path, n: int = 150) -> list[str]:
    """A folder of so many cells that its file has some pages; their keys."""
    store = ResultStore(folder)
    cells = [replace(CELL, split_index=index) for index in range(n)]
    store.write_cells(result(cell=cell, records=VALUES) for cell in cells)
    store.write_manifest(MANIFEST)
    return [cell.key for cell in cells]


NUMBERS = np.array([[1 / 3, 2e-17, -0.1]])
INTERVAL = Interval(NUMBERS - 1 / 7, NUMBERS + 1 / 7, 0.9)
CURVES = {"none": np.empty((0, 3)), "fit": np.array([[1.0, 0.1, math.nan], [2.0, 1 / 3, 0.4]])}


@pytest.mark.parametrize(
    "written",
    [
        result(curves=CURVES, chosen={"a": "1"}, log=("said",), n_train=3, n_splits=2),
        result(
            cell=replace(CELL, coverage=0.9),
            prediction=Prediction(np.array([4]), NUMBERS, NUMBERS, INTERVAL),
            calibration_samples=11,
        ),
        result(cell=replace(CELL, coverage=0.9)),  # too few training rows for intervals
        failure(cause="KeyError"),
    ],
    ids=["curves", "intervals", "no intervals", "failure"],
)
def test_a_cell_comes_back_as_it_was_written_to_the_last_bit(tmp_path, written):
    ResultStore(tmp_path).write_cells([written])
    back = only(tmp_path)
    plain = [asdict(replace(one, records=tuple(one.records))) for one in (back, written)]
    np.testing.assert_equal(*plain)
    if back.prediction is not None:
        with pytest.raises(ValueError, match="read-only"):
            back.prediction.predicted[0] = 0.0


def test_metrics_are_plain_rows_that_pandas_reads(tmp_path):
    ResultStore(tmp_path).write_cells([result()])
    with closing(sqlite3.connect(tmp_path / FILE)) as db:
        table = pd.read_sql("SELECT model, metric, axis, value, unit FROM metric", db)
    assert table.to_dict("records") == [
        {"model": "m@a=2", "metric": "mae", "axis": "x", "value": 1 / 3, "unit": "m"},
        {"model": "m@a=2", "metric": "latency", "axis": "", "value": 1e-5, "unit": "s"},
    ]


def test_a_file_of_another_format_is_refused_with_what_to_do(tmp_path):
    ResultStore(tmp_path)
    change(tmp_path, "PRAGMA user_version = 9")
    message = "stored format 9, this stiffbench reads 4; give a new folder"
    for attempt in (read_results, read_manifests, ResultStore):
        with pytest.raises(StoreError, match=message):
            attempt(tmp_path)


def test_a_folder_keeps_samples_and_robot_of_its_results_with_the_joints_torques(tmp_path, fanuc):
    data = fanuc
    ResultStore(tmp_path).write_data(data)
    back = read_data(tmp_path, data.sha256)
    torque = np.einsum("nki,nk->ni", data.robot.jacobian(data.samples.q), data.samples.wrench)
    np.testing.assert_allclose(back.torque, torque, atol=1e-9)
    assert back.joint_names == data.robot.joint_names and back.robot == data.robot.name
    assert tuple(back.tcp_on_flange) == shipped_robots()["fanuc-r2000ic"].tcp
    assert BenchmarkData(back.samples, back.geometry).sha256 == data.sha256
    np.testing.assert_array_equal(back.geometry.flange, data.robot.flange)


def test_the_noise_that_a_data_card_states_is_stored_and_a_difference_said(tmp_path, fanuc):
    noisy = BenchmarkData(replace(fanuc.samples, instrument_noise=3e-5), fanuc.robot)
    ResultStore(tmp_path).write_data(noisy)
    found = read_data(tmp_path, noisy.sha256)
    assert BenchmarkData(found.samples, found.geometry).sha256 == noisy.sha256
    assert what_differs([found, stored_data(data_content(fanuc))]) == "samples"


def test_a_file_from_before_the_robot_was_stored_is_read_and_completed_by_the_next_run(
    tmp_path, fanuc
):
    store = ResultStore(tmp_path)
    store.write_data(fanuc)
    with np.load(io.BytesIO(data_content(fanuc))) as arrays:
        older = io.BytesIO()
        since = ("tcp_on_flange", "robot ")
        np.savez(older, **{name: arrays[name] for name in arrays if not name.startswith(since)})
    content = older.getvalue()
    with writing(tmp_path) as db:
        row = (content, hashlib.sha256(content).hexdigest())
        db.execute("UPDATE data SET content = ?, content_sha256 = ?", row)
    found = read_data(tmp_path, fanuc.sha256)
    assert found.tcp_on_flange is found.geometry is None
    store.write_data(fanuc)
    found = read_data(tmp_path, fanuc.sha256)
    assert found.tcp_on_flange is not None and found.geometry is not None


def test_it_is_told_in_what_data_of_one_name_differ():
    data = made_data()
    robot = shipped_robot("kr10_r1100_2", tcp=(0.06, 0.0, 0.1))
    other = replace(data.samples, deflection=2.0 * data.samples.deflection)
    first, tool, both = (
        stored_data(data_content(one))
        for one in (data, BenchmarkData(data.samples, robot), BenchmarkData(other, robot))
    )
    assert what_differs([first, tool]) == "TCP (0.06, 0, 0.08) -> (0.06, 0, 0.1) m"
    assert what_differs([tool, both]) == "samples"
    assert what_differs([first, both]) == "TCP (0.06, 0, 0.08) -> (0.06, 0, 0.1) m and samples"
    assert what_differs([first, first]) == "robot's geometry"
    assert what_differs([replace(first, tcp_on_flange=None), tool]) == "data or TCP"


def test_samples_that_are_damaged_are_said_to_be_and_written_anew(tmp_path, fanuc):
    store = ResultStore(tmp_path)
    store.write_data(fanuc)
    for damage_to in ("content = x'00'", "content = 'no zip'", "content_sha256 = ''"):
        change(tmp_path, f"UPDATE data SET {damage_to}")
        with pytest.raises(DamagedFile, match=fanuc.sha256):
            read_data(tmp_path, fanuc.sha256)
        store.write_data(fanuc)
        assert len(read_data(tmp_path, fanuc.sha256).samples) == 43


def test_results_are_read_in_the_order_of_keys_failures_too_or_some_by_their_keys(tmp_path):
    keys = many(tmp_path, 5)
    ResultStore(tmp_path).write_cells([failure(cell=replace(CELL, split_index=9))])
    found = {one.cell.key: one.failure for one in read_results(tmp_path)}
    assert list(found) == sorted(found) and len(found) == 6
    assert [text for text in found.values() if text] == ["it broke"]
    some = stored_results(tmp_path, {keys[1], keys[3], "none"})
    assert {one.cell.key for one in some} == {keys[1], keys[3]}
    assert list(stored_results(tmp_path, set())) == []


@pytest.mark.parametrize("there", [False, True])
def test_a_folder_without_a_file_or_whose_tables_are_still_to_be_made_holds_nothing(
    tmp_path, there
):
    """A run has made the file and not ended its first transaction, or was killed there."""
    if there:
        (tmp_path / FILE).touch()
    assert read_results(tmp_path) == read_manifests(tmp_path) == []
    assert stored_statuses(tmp_path) == mean_seconds(tmp_path) == {}
    with pytest.raises(StoreError, match="holds no data set"):
        read_data(tmp_path, "00")
    assert [path.name for path in tmp_path.iterdir()] == [FILE] * there
    ResultStore(tmp_path).write_cells([result()])
    assert only(tmp_path).status == "ok"


@pytest.mark.parametrize(
    "statement",
    [
        "UPDATE value SET value = value + 1e-12",
        "UPDATE value SET value = 'many'",
        "UPDATE value SET value = NULL",
        "DELETE FROM value WHERE measure = 1",
        "UPDATE measure SET axis = 'y' WHERE id = 1",
        "DELETE FROM measure WHERE id = 1",
        "UPDATE value SET measure = '1,2' WHERE measure = 1",
        "UPDATE cell SET fit_s = fit_s + 1e-9",
        "UPDATE cell SET prediction = x'00'",
        "UPDATE cell SET key = '0123456789abcdef01234567'",
        "UPDATE cell SET status = 'failed'",
        "UPDATE cell SET about = 7",
        "UPDATE cell SET model_key = x'ff'",
        "UPDATE cell SET model_key = CAST(x'ff' AS TEXT)",
        "UPDATE cell SET shown = CAST(x'7bff7d' AS TEXT)",
        *(
            f"UPDATE cell SET {name} = {name} || ' '"
            for name in ("run_id", "shown", "about", "failure", "prediction_arrays")
        ),
    ],
)
def test_no_number_or_text_of_a_cell_can_change_unnoticed(tmp_path, statement):
    ResultStore(tmp_path).write_cells([result()])
    change(tmp_path, statement)
    with pytest.raises(DamagedFile, match="damaged: cell"):
        read_results(tmp_path)
    told: list[DamagedFile] = []
    assert list(stored_results(tmp_path, report=told.append)) == []
    assert len(told) == 1


@pytest.mark.parametrize(
    "statement",
    ["cells = '[]'", "environment = '['", "command = 'other'", "started = CAST(x'ff' AS TEXT)"],
)
def test_a_changed_manifest_is_found_and_taken_out_by_the_next_run(tmp_path, statement):
    store = ResultStore(tmp_path)
    for status in ("running", "finished"):
        store.write_manifest(replace(MANIFEST, status=status))
    assert read_manifests(tmp_path) == [MANIFEST]
    change(tmp_path, f"UPDATE run SET {statement}")
    with pytest.raises(DamagedFile, match="run r"):
        read_manifests(tmp_path)
    told: list[DamagedFile] = []
    repair(tmp_path, told.append)
    assert len(told) == 1 and read_manifests(tmp_path) == []


def test_text_that_no_file_can_hold_is_stored_with_a_question_mark(tmp_path):
    """A file's name on a command line may hold bytes that are no character."""
    store = ResultStore(tmp_path)
    store.write_cells([failure(failure="M\xfcller \udcff.csv", log=("\udcfe",))])
    store.write_manifest(replace(MANIFEST, command="\udcff", environment={"LC_x": "\udcfd"}))
    assert (only(tmp_path).failure, only(tmp_path).log) == ("M\xfcller ?.csv", ("?",))
    assert [(run.command, run.environment) for run in read_manifests(tmp_path)] == [
        ("?", {"LC_x": "?"})
    ]


def test_a_write_that_fails_leaves_what_was_there_and_no_folder_is_made_in_a_file(tmp_path):
    store = ResultStore(tmp_path)
    store.write_cells([result()])

    def breaks():
        yield result(warnings=())
        raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        store.write_cells(breaks())
    assert only(tmp_path).warnings == ("careful",)
    assert [path.name for path in tmp_path.iterdir()] == [FILE]
    with pytest.raises(StoreError, match="cannot be made"):
        ResultStore(tmp_path / FILE / "results")


def test_a_key_is_the_same_in_every_version():
    assert CELL.key == "8a49b67bbeadb3aae6d65663"
    more = replace(CELL, model_version="2", scoring_version=2, coverage=0.9, source_sha256="x")
    assert replace(more, condition="n = 5", rows_sha256="y").key == "c5cb27b173770c661093b12e"


@pytest.mark.parametrize("status", ["failed", "skipped"])
def test_the_newest_record_of_a_cell_counts_but_no_failure_replaces_a_result(tmp_path, status):
    store = ResultStore(tmp_path)
    for run_id in ("r1", "r2"):
        store.write_cells([failure(status=status, run_id=run_id)])
        assert (only(tmp_path).run_id, store.result(CELL.key)) == (run_id, None)
    for run_id in ("r1", "r2"):
        store.write_cells([result(run_id=run_id)])
        store.write_cells([failure(status=status, run_id="r3")])
        assert only(tmp_path).run_id == store.result(CELL.key).run_id == run_id
    assert only(tmp_path).records == result().records


@pytest.mark.slow
@pytest.mark.parametrize("table", ["cell", "value", "run", "data"])
def test_of_a_torn_file_the_readable_rows_are_kept_and_the_others_named(tmp_path, table, fanuc):
    keys = many(tmp_path)
    store = ResultStore(tmp_path)
    store.write_data(fanuc)
    whole = (tmp_path / FILE).read_bytes()
    tear(tmp_path, table)
    torn = (tmp_path / FILE).read_bytes()
    assert torn != whole and fault_of(tmp_path) is not None
    told: list[DamagedFile] = []
    repair(tmp_path, told.append)
    kept = {one.cell.key: one for one in read_results(tmp_path)}
    lost = {error.key for error in told} - {""}
    assert len(kept) > len(keys) // 3 if table in ("cell", "value") else len(kept) == len(keys)
    assert lost | kept.keys() == {*keys} and not lost & kept.keys()
    assert all(one.records == VALUES for one in kept.values())
    assert fault_of(tmp_path) is None
    assert (tmp_path / f"{FILE}.damaged").read_bytes() == torn
    store.write_cells(result(cell=replace(CELL, split_index=i)) for i in range(len(keys)))
    assert [one.cell.key for one in read_results(tmp_path)] == sorted(keys)


@pytest.mark.parametrize("rubbish", [b"no database", b"SQLite format 3\x00" + b"\xff" * 500])
def test_a_file_that_is_no_database_is_said_and_set_aside_by_the_next_run(tmp_path, rubbish):
    (tmp_path / FILE).write_bytes(rubbish)
    with pytest.raises(DamagedFile, match=FILE):
        read_results(tmp_path)
    store = ResultStore(tmp_path)
    told: list[DamagedFile] = []
    repair(tmp_path, told.append)
    store.write_cells([result()])
    assert told and only(tmp_path).status == "ok"
    (tmp_path / FILE).write_bytes(b"rubbish")
    repair(tmp_path, told.append)
    aside = [tmp_path / f"{FILE}.damaged{more}" for more in ("", "-2")]
    assert {*tmp_path.iterdir()} == {tmp_path / FILE, *aside}
    assert [path.read_bytes() for path in aside] == [rubbish, b"rubbish"]


@pytest.mark.parametrize(
    ("runs", "parts"),
    [
        ({"a": ["r1"], "b": ["r1"]}, None),
        ({"a": ["r1", "r2"], "b": ["r2", "r1"]}, None),
        ({"a": ["r1"], "b": ["r1", "r2"]}, ("numpy", "a: 2.3.0", "b: 2.3.0, 2.4.0")),
        ({"a": ["r1"], "b": ["lost"]}, ("numpy", "a: 2.3.0", "b: unknown")),
    ],
)
def test_a_library_is_named_whose_versions_differ_between_two_models(runs, parts):
    manifests = [
        replace(MANIFEST, run_id=name, environment={library: version for library in LIBRARIES})
        for name, version in (("r1", "2.3.0"), ("r2", "2.4.0"))
    ]
    lines = list(differing_libraries(manifests, runs))
    assert len(lines) == (len(LIBRARIES) if parts else 0)
    assert not lines or all(part in lines[0] for part in parts)


@pytest.mark.slow
def test_one_bit_anywhere_in_the_file_is_found_or_changes_nothing(tmp_path):
    """Every 97th byte: read as before, or damage that is said; never other numbers."""
    made = MadeResults(tmp_path / "whole")
    made.add_run("run-1", made.add("vjm", (0.1, 0.2, 0.3)))
    before = {one.cell.key: (one.records, one.run_id) for one in read_results(made.folder)}
    raw = (made.folder / FILE).read_bytes()
    folder = tmp_path / "torn"
    folder.mkdir()
    for place in range(0, len(raw), 97):
        torn = bytearray(raw)
        torn[place] ^= 1 << (place % 8)
        (folder / FILE).write_bytes(torn)
        found = []
        try:
            found = list(stored_results(folder, report=lambda _: None))
        except StoreError:
            continue
        assert all(before[one.cell.key] == (one.records, one.run_id) for one in found), place


WRITER = f"""
import sys
from pathlib import Path
from dataclasses import replace
sys.path[:0] = [{str(Path(__file__).parents[2])!r}]
from helpers.stored_cells import CELL, result
from stiff_bench.store.database import ResultStore
store = ResultStore(Path(sys.argv[1]))
for index in range(100_000):
    store.write_cells([result(cell=replace(CELL, split_index=index))])
    print(index, flush=True)
"""


def test_a_writer_that_is_killed_at_any_moment_loses_nothing_that_it_had_stored(tmp_path):
    rng = np.random.default_rng(0)
    for number in range(4):
        folder = tmp_path / str(number)
        words = [sys.executable, "-c", WRITER, str(folder)]
        with subprocess.Popen(words, stdout=subprocess.PIPE, text=True) as writer:
            writer.stdout.readline()
            time.sleep(rng.uniform(0.0, 0.1))
            writer.send_signal(signal.SIGKILL)
            said = {0, *(int(line) for line in writer.stdout.read().split("\n") if line)}
        assert {found.cell.split_index for found in read_results(folder)} >= said - {max(said)}
        assert fault_of(folder) is None


def test_a_transaction_waits_for_the_disk_and_its_journal_is_taken_back(tmp_path, durable):
    with writing(tmp_path) as db:
        full, rollback = 2, "delete"
        assert db.execute("PRAGMA synchronous").fetchone() == (full,)
        assert db.execute("PRAGMA journal_mode").fetchone() == (rollback,)


def test_readers_do_not_keep_a_writer_waiting(tmp_path):
    many(tmp_path, 10)
    for found in stored_results(tmp_path):
        ResultStore(tmp_path).write_cells([replace(found, warnings=())])
    assert {one.warnings for one in read_results(tmp_path)} == {()}


def test_another_process_that_holds_the_file_too_long_is_said(tmp_path, monkeypatch):
    ResultStore(tmp_path)
    monkeypatch.setattr("stiff_bench.store.database.BUSY_S", 0.05)
    with (
        writing(tmp_path),
        pytest.raises(StoreError, match=r"locked.*network file systems"),
    ):
        ResultStore(tmp_path).write_cells([result()])
