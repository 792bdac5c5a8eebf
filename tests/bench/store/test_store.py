"""Results on disk: complete or absent, checked, and at full precision."""

from __future__ import annotations

import hashlib
import lzma
import math
import os
import signal
import sqlite3
import subprocess
import sys
import threading
import time
from contextlib import closing
from dataclasses import asdict, replace
from pathlib import Path

import numpy as np
import orjson
import pytest

from helpers.compared_results import made_data
from helpers.made_results import MadeResults, change
from helpers.stored_fits import FIT, MANIFEST, failure, result
from stiff_bench.store.database import (
    FILE,
    FORMAT,
    PACKED,
    ResultStore,
    data_content,
    mean_seconds,
    read_data,
    read_manifests,
    read_results,
    stored_data,
    stored_statuses,
    writing,
)
from stiff_bench.store.names import Variant, without_options
from stiff_bench.store.samples import what_differs
from stiff_datasets.robots.shipped_robots import shipped_robot, shipped_robots
from stiff_protocols.contract.errors import DataError, StoreError
from stiff_protocols.contract.record import FitResult
from stiff_protocols.contract.types import BenchmarkData, Interval, Prediction


def only(folder: Path) -> FitResult:
    (stored_result,) = read_results(folder)
    return stored_result


NUMBERS = np.array([[1 / 3, 2e-17, -0.1]])
INTERVAL = Interval(NUMBERS - 1 / 7, NUMBERS + 1 / 7, 0.9)
BOUNDS = {"oracle": NUMBERS / 5}
CURVES = {"none": np.empty((0, 3)), "fit": np.array([[1.0, 0.1, math.nan], [2.0, 1 / 3, 0.4]])}


@pytest.mark.parametrize(
    "written",
    [
        result(curves=CURVES, chosen={"a": "1"}, log=("line",), n_train=3, n_splits=2),
        result(
            fit=replace(FIT, coverage=0.9, interval_version=3),
            prediction=Prediction(
                np.array([4]), NUMBERS, NUMBERS, INTERVAL, bound_deflections=BOUNDS
            ),
            calibration_samples=11,
        ),
        result(fit=replace(FIT, coverage=0.9)),  # too few training rows for intervals
        failure(cause="KeyError"),
    ],
    ids=["curves", "intervals", "no intervals", "failure"],
)
def test_a_cell_comes_back_as_it_was_written_to_the_last_bit(tmp_path, written):
    ResultStore(tmp_path).write_fits([written])
    back = only(tmp_path)
    np.testing.assert_equal(asdict(back), asdict(written))
    assert back.fit.key == written.fit.key
    if back.prediction is not None:
        with pytest.raises(ValueError, match="read-only"):
            back.prediction.predicted[0] = 0.0


@pytest.mark.parametrize(
    ("number", "message"), [(FORMAT - 1, "give a new folder"), (FORMAT + 1, "newer stiffbench")]
)
def test_a_file_of_another_format_is_refused_with_what_to_do(tmp_path, number, message):
    ResultStore(tmp_path)
    change(tmp_path, f"PRAGMA user_version = {number}")
    for attempt in (read_results, read_manifests, ResultStore):
        with pytest.raises(StoreError, match=message):
            attempt(tmp_path)


def test_a_folder_keeps_samples_and_robot_of_its_results(tmp_path, fanuc):
    data = BenchmarkData(replace(fanuc.samples, instrument_noise=3e-5), fanuc.robot)
    ResultStore(tmp_path).write_data(data)
    back = read_data(tmp_path, data.sha256)
    torque = np.einsum("nki,nk->ni", data.robot.jacobian(data.samples.q), data.samples.wrench)
    np.testing.assert_allclose(back.torque, torque, atol=1e-9)
    assert tuple(back.robot.tcp_on_flange) == shipped_robots()["fanuc-r2000ic"].tcp
    assert BenchmarkData(back.samples, back.robot).sha256 == data.sha256
    np.testing.assert_array_equal(back.robot.flange, data.robot.flange)


def test_a_note_names_in_what_data_of_one_name_differ():
    data = made_data()
    robot = shipped_robot("kr10_r1100_2", tcp=(0.06, 0.0, 0.1))
    other_samples = replace(data.samples, deflection=2.0 * data.samples.deflection)
    noisy = replace(data.samples, instrument_noise=3e-5)
    first, noise, tool, tool_and_samples = (
        stored_data(data_content(made))
        for made in (
            *(data, BenchmarkData(noisy, data.robot)),
            *(BenchmarkData(data.samples, robot), BenchmarkData(other_samples, robot)),
        )
    )
    assert what_differs([first, tool]) == "TCP (0.06, 0, 0.08) -> (0.06, 0, 0.1) m"
    assert what_differs([tool, tool_and_samples]) == what_differs([first, noise]) == "samples"
    assert (
        what_differs([first, tool_and_samples])
        == "TCP (0.06, 0, 0.08) -> (0.06, 0, 0.1) m and samples"
    )
    assert what_differs([first, first]) == "robot's geometry"


def test_results_are_read_in_the_order_of_keys_failures_too_or_some_by_their_keys(tmp_path):
    fits = [replace(FIT, split_index=index) for index in range(5)]
    ResultStore(tmp_path).write_fits(result(fit=fit) for fit in fits)
    ResultStore(tmp_path).write_fits([failure(fit=replace(FIT, split_index=9))])
    failures = {entry.fit.key: entry.failure for entry in read_results(tmp_path)}
    assert list(failures) == sorted(failures) and len(failures) == 6
    assert [text for text in failures.values() if text] == ["it broke"]
    selected_results = read_results(tmp_path, [fits[1].key, fits[3].key, "none"])
    assert {entry.fit.key for entry in selected_results} == {fits[1].key, fits[3].key}
    assert read_results(tmp_path, []) == []


@pytest.mark.parametrize("there", [False, True])
def test_a_folder_without_a_file_or_whose_tables_are_still_to_be_made_holds_nothing(
    tmp_path, there
):
    """A run made the file, and has not ended its first transaction or was killed."""
    if there:
        (tmp_path / FILE).touch()
    assert read_results(tmp_path) == read_manifests(tmp_path) == []
    assert stored_statuses(tmp_path) == mean_seconds(tmp_path) == {}
    with pytest.raises(StoreError, match="holds no data set"):
        read_data(tmp_path, "00")
    assert [path.name for path in tmp_path.iterdir()] == [FILE] * there
    ResultStore(tmp_path).write_fits([result()])
    assert only(tmp_path).status == "ok"


@pytest.mark.parametrize(
    "change_to",
    [
        *("cell SET fit_s = fit_s + 1e-9", "cell SET numbers = x'00'", "cell SET key = '01234567'"),
        *("cell SET status = 'failed'", "cell SET arrays = NULL", "cell SET shown = shown || ' '"),
        *("cell SET model_key = CAST(x'ff' AS TEXT)", "data SET content = x'00'"),
        "run SET environment = '['",
    ],
)
def test_what_was_changed_is_named_with_the_command_that_computes_it_again(
    tmp_path, fanuc, change_to
):
    store = ResultStore(tmp_path)
    store.write_fits([result()])
    manifest = replace(MANIFEST, cells=(FIT.key,))
    store.write_manifest(manifest)
    store.write_data(fanuc)
    assert read_manifests(tmp_path) == [manifest]
    change(tmp_path, f"UPDATE {change_to}")
    with pytest.raises(StoreError, match=f"{FILE}: corrupt: .*bench run"):
        read_manifests(tmp_path), read_results(tmp_path), read_data(tmp_path, fanuc.sha256)


@pytest.mark.parametrize(
    "rubbish", [b"no database", b"SQLite format 3\x00" + b"\xff" * 500, "half", "torn"]
)
def test_a_file_that_sqlite_cannot_read_is_named_with_what_to_do(tmp_path, rubbish):
    store = ResultStore(tmp_path)
    store.write_fits(result(fit=replace(FIT, split_index=index)) for index in range(50))
    content = (tmp_path / FILE).read_bytes()
    half = len(content) // 2
    torn = {
        "half": content[:half],
        "torn": content[:half] + b"\xff" * 8192 + content[half + 8192 :],
    }
    (tmp_path / FILE).write_bytes(torn.get(rubbish, rubbish))
    with pytest.raises(StoreError, match=f"{FILE}: corrupt: .*delete the file and repeat"):
        read_results(tmp_path)


def test_a_write_that_fails_leaves_what_was_there_and_no_folder_is_made_in_a_file(tmp_path):
    store = ResultStore(tmp_path)
    store.write_fits([result()])

    def breaks():
        yield result(warnings=())
        raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        store.write_fits(breaks())
    assert only(tmp_path).warnings == ("careful",)
    assert [path.name for path in tmp_path.iterdir()] == [FILE]
    with pytest.raises(StoreError, match="cannot create"):
        ResultStore(tmp_path / FILE / "results")


@pytest.mark.parametrize("status", ["failed", "skipped"])
def test_the_newest_state_of_a_cell_counts_but_no_failure_replaces_a_result(tmp_path, status):
    store = ResultStore(tmp_path)
    for run_id in ("r1", "r2"):
        store.write_fits([failure(status=status, run_id=run_id)])
        assert (only(tmp_path).run_id, store.result(FIT.key)) == (run_id, None)
    for run_id in ("r1", "r2"):
        store.write_fits([result(run_id=run_id)])
        store.write_fits([failure(status=status, run_id="r3")])
        assert only(tmp_path).run_id == store.result(FIT.key).run_id == run_id


@pytest.mark.slow
def test_one_bit_anywhere_in_the_file_is_found_or_changes_nothing(tmp_path):
    """Every 97th byte: an error or the same numbers, never other numbers."""
    made = MadeResults(tmp_path / "whole")
    made.add_run("run-1", made.add("vjm", (0.1, 0.2, 0.3)))

    def content(folder):
        return {
            (r.fit.key, r.run_id, r.prediction.predicted.tobytes()) for r in read_results(folder)
        }

    before, raw = content(made.folder), (made.folder / FILE).read_bytes()
    folder = tmp_path / "torn"
    folder.mkdir()
    for place in range(0, len(raw), 97):
        torn = bytearray(raw)
        torn[place] ^= 1 << (place % 8)
        (folder / FILE).write_bytes(torn)
        try:
            damaged_content = content(folder)
        except StoreError:
            continue
        assert damaged_content <= before, place


WRITER = f"""
import sys
from pathlib import Path
from dataclasses import replace
sys.path[:0] = [{str(Path(__file__).parents[2])!r}]
from helpers.stored_fits import FIT, result
from stiff_bench.store.database import ResultStore
store = ResultStore(Path(sys.argv[1]))
for index in range(100_000):
    store.write_fits([result(fit=replace(FIT, split_index=index))])
    print(index, flush=True)
"""


@pytest.mark.slow
def test_a_writer_that_is_killed_at_any_moment_loses_nothing_that_it_had_stored(tmp_path):
    rng = np.random.default_rng(0)
    for number in range(2):
        folder = tmp_path / str(number)
        words = [sys.executable, "-c", WRITER, str(folder)]
        with subprocess.Popen(words, stdout=subprocess.PIPE, text=True) as writer:
            writer.stdout.readline()
            time.sleep(rng.uniform(0.0, 0.1))
            writer.send_signal(signal.SIGKILL)
            printed = {0, *(int(line) for line in writer.stdout.read().split("\n") if line)}
        assert {entry.fit.split_index for entry in read_results(folder)} >= printed - {max(printed)}
        with closing(sqlite3.connect(folder / FILE)) as db:
            assert db.execute("PRAGMA quick_check").fetchone() == ("ok",)


def test_a_transaction_waits_for_the_disk_and_its_journal_is_taken_back(tmp_path, durable):
    with writing(tmp_path) as db:
        full, rollback = 2, "delete"
        assert db.execute("PRAGMA synchronous").fetchone() == (full,)
        assert db.execute("PRAGMA journal_mode").fetchone() == (rollback,)


def test_another_process_that_holds_the_file_too_long_is_named(tmp_path, monkeypatch):
    ResultStore(tmp_path)
    monkeypatch.setattr("stiff_bench.store.database.BUSY_S", 0.05)
    with (
        writing(tmp_path),
        pytest.raises(StoreError, match=r"locked.*network file systems"),
    ):
        ResultStore(tmp_path).write_fits([result()])


def packed(folder: Path) -> Path:
    """Replace a folder's file by its packed file, and return that."""
    file, target = folder / FILE, folder / PACKED
    target.write_bytes(lzma.compress(file.read_bytes()))
    file.unlink()
    return target


def test_packed_results_are_read_and_written_to_as_others(tmp_path):
    made = MadeResults(tmp_path)
    made.add("vjm", [0.1, 0.2])
    before = read_results(tmp_path)
    packed(tmp_path)
    assert [entry.fit.key for entry in read_results(tmp_path)] == [
        entry.fit.key for entry in before
    ]
    (tmp_path / FILE).unlink()
    MadeResults(tmp_path).add("knn", [0.3])
    assert len(read_results(tmp_path)) == len(before) + 1


@pytest.mark.parametrize("content", [lzma.compress(bytes(2**22)), lzma.compress(b"cut")[:-9]])
def test_a_packed_file_that_is_cut_or_has_no_end_is_refused_and_leaves_no_file(
    content, tmp_path, monkeypatch
):
    monkeypatch.setattr("stiff_bench.store.database._LEAST_UNPACKED", 2**20)
    (tmp_path / PACKED).write_bytes(content)
    with pytest.raises(StoreError, match=PACKED):
        read_results(tmp_path)
    assert [path.name for path in tmp_path.iterdir()] == [PACKED]


def test_a_pipe_in_the_place_of_the_packed_file_is_refused(tmp_path):
    os.mkfifo(tmp_path / PACKED)
    with pytest.raises(StoreError, match=PACKED):
        read_results(tmp_path)


ADDED = {
    "trigger": "CREATE TRIGGER x AFTER INSERT ON run BEGIN DELETE FROM cell; END",
    "view": "CREATE VIEW x AS SELECT * FROM cell",
    "index": "CREATE INDEX x ON cell (abs(fit_s))",
    "virtual table": "CREATE VIRTUAL TABLE x USING fts5(a)",
    "table": "CREATE TABLE x (a)",
    "generated column": "ALTER TABLE run ADD COLUMN x AS (abs(wall_s))",
    "missing column": "ALTER TABLE cell DROP COLUMN fit_s",
}


@pytest.mark.parametrize("kind", ADDED)
def test_a_file_with_more_or_less_than_our_tables_is_refused_and_nothing_of_it_runs(kind, tmp_path):
    ResultStore(tmp_path).write_fits([result()])
    change(tmp_path, ADDED[kind])
    before = (tmp_path / FILE).read_bytes()
    for attempt in (read_results, read_manifests, stored_statuses, mean_seconds, ResultStore):
        with pytest.raises(StoreError, match=f"{FILE}: corrupt: "):
            attempt(tmp_path)
    assert (tmp_path / FILE).read_bytes() == before


def forge(folder: Path, **columns: object) -> None:
    """Replace columns of every fit, with the checksum of the new row."""
    with closing(sqlite3.connect(folder / FILE)) as db, db:
        db.row_factory = sqlite3.Row
        for row in db.execute("SELECT * FROM cell").fetchall():
            *values, numbers, _ = (dict(row) | columns).values()
            sha256 = hashlib.sha256(orjson.dumps(values) + b"\0" + numbers).hexdigest()
            db.execute("DELETE FROM cell WHERE rowid = (SELECT min(rowid) FROM cell)")
            row = [*values, numbers, sha256]
            db.execute(f"INSERT INTO cell VALUES ({', '.join('?' * len(row))})", row)


SHAPES = '{"rows":[1],"predicted":[1,3],"measured":[1,3]}'


def numbers(rows: object = 4.0, predicted: object = 0.0) -> bytes:
    """Return the bytes of a row number, a prediction and a measurement."""
    return np.array([rows, predicted, *[0.0] * 5], "<f8").tobytes()


FORGED = {
    **{f"about {text}": {"about": text} for text in ("[]", "null", '{"x":1}', '{"log":5}', "1")},
    "about of any depth": {"about": "[" * 200_000 + "]" * 200_000},
    "deep option": {"model_params": '{"a":' + "[" * 900 + "]" * 900 + "}"},
    **{f"shown {text}": {"shown": text} for text in ("{}", "[]", '{"kind":1}')},
    "params": {"model_params": '"x"'},
    **{f"arrays {text}": {"arrays": text} for text in ('{"rows":[-1]}', '{"rows":[10]}', "{}")},
    "shape": {"arrays": SHAPES.replace("[1]", "[1,1]"), "numbers": numbers()},
    "huge": {"arrays": '{"rows":[99999999999]}'},
    "unknown array": {"arrays": SHAPES.replace("measured", "stolen"), "numbers": numbers()},
    "bytes left": {"arrays": SHAPES, "numbers": numbers() + bytes(8)},
    **{
        f"row {row}": {"arrays": SHAPES, "numbers": numbers(row)}
        for row in (-1.0, 0.5, 1e18, math.nan, math.inf)
    },
    "NaN": {"arrays": SHAPES, "numbers": numbers(4, math.nan)},
    **{
        f"{name} {value}": {name: value}
        for name, value in (
            *(("model", None), ("status", "yes"), ("status", "failed"), ("n_splits", -5)),
            *(("n_train", "many"), ("fit_s", "abc"), ("fit_s", -1e308), ("fit_s", math.inf)),
            *(("predict_s", None), ("coverage", 7.0), ("split_index", 8), ("key", "other")),
        )
    },
}


@pytest.mark.parametrize("kind", FORGED)
def test_a_crafted_cell_with_a_right_checksum_is_named_with_its_file(kind, tmp_path):
    ResultStore(tmp_path).write_fits([result()])
    forge(tmp_path)
    assert only(tmp_path).status == "ok"
    forge(tmp_path, **FORGED[kind])
    with pytest.raises(StoreError, match=f"{FILE}: corrupt: fit ({FIT.key}|other): ") as caught:
        read_results(tmp_path)
    assert len(str(caught.value)) < 500


@pytest.mark.parametrize(
    "crafted", ["environment = '[]'", "cells = '5'", "machines = '0'", "command = NULL"]
)
def test_a_crafted_run_is_named_with_its_file(crafted, tmp_path):
    ResultStore(tmp_path).write_manifest(MANIFEST)
    change(tmp_path, f"UPDATE run SET {crafted}")
    with pytest.raises(StoreError, match=f"{FILE}: corrupt: run {MANIFEST.run_id}: "):
        read_manifests(tmp_path)


def test_rows_larger_than_their_file_are_refused(tmp_path, monkeypatch):
    store = ResultStore(tmp_path)
    store.write_fits(result(fit=replace(FIT, split_index=index)) for index in range(9))
    size = (tmp_path / FILE).stat().st_size
    for spare in (2000 - size, 10 - size):  # all rows; one row
        monkeypatch.setattr("stiff_bench.store.database._SPARE", spare)
        with pytest.raises(StoreError, match=FILE):
            read_results(tmp_path)


def test_a_row_that_its_data_set_does_not_have_is_refused_with_the_data(tmp_path):
    made = MadeResults(tmp_path)
    (key,) = made.add("vjm", [0.1])
    sha256 = only(tmp_path).fit.data_sha256
    assert len(read_data(tmp_path, sha256).samples) == 12
    forge(tmp_path, arrays=SHAPES, numbers=numbers(12))
    with pytest.raises(StoreError, match=f"{FILE}: corrupt: .*{key} has row 12 of 12"):
        read_data(tmp_path, sha256)


def test_a_data_set_that_unpacks_without_end_is_refused(fanuc, monkeypatch):
    content = data_content(fanuc)
    monkeypatch.setattr("stiff_bench.store.database._LEAST_UNPACKED", 10)
    monkeypatch.setattr("stiff_bench.store.database._MOST_PACKED", 1)
    with pytest.raises(DataError, match="unpack to"):
        stored_data(content)


def test_a_journal_that_names_a_file_to_delete_is_refused(tmp_path):
    ResultStore(tmp_path)
    journal = tmp_path / f"{FILE}-journal"
    journal.write_bytes(bytes(512) + bytes.fromhex("d9d505f920a163d7"))
    for attempt in (read_results, ResultStore):
        with pytest.raises(StoreError, match="journal: corrupt"):
            attempt(tmp_path)


def test_a_mark_in_an_options_value_stays_doubled():
    variant = Variant("p", {"source": "a@b=1", "seed": 1, "specimen": 2})
    assert variant.name == "p@seed=1@source=a@@b=1@specimen=2"
    assert without_options(variant.name, "seed") == "p@source=a@@b=1@specimen=2"
    every = {"source": "a@b=1", "seed": 1, "specimen": 2, "b": 1, "other": 0}
    assert Variant.of_stored_name("p", variant.name, every) == variant


def test_a_folder_is_read_while_another_thread_stores_fits(tmp_path):
    store = ResultStore(tmp_path)
    store.write_fits([result()])

    def write() -> None:
        for index in range(150):
            store.write_fits([result(fit=replace(FIT, split_index=index))])

    writer = threading.Thread(target=write)
    writer.start()
    while writer.is_alive():  # the journal of a transaction comes and goes
        assert stored_statuses(tmp_path)
    assert len(stored_statuses(tmp_path)) == 150
