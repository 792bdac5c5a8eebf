"""Packs: the same results in fewer files; nothing is lost or counted twice, whatever happens."""

from __future__ import annotations

import errno
import fcntl
import os
import resource
import shutil
import signal
import sys
from collections import Counter
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import replace
from functools import partial
from pathlib import Path
from unittest.mock import patch

import numpy as np
import pyarrow.parquet as pq
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from command_line import bench
from made_results import MadeResults
from stiff_bench import folder_lock, packing, packs
from stiff_bench.cell_content import cell_content
from stiff_bench.checked_json import DamagedFile, json_text
from stiff_bench.collected import collect
from stiff_bench.loose_cells import loose_files
from stiff_bench.packing import pack, pack_if_many
from stiff_bench.packs import pack_files, write_pack
from stiff_bench.store import ResultStore, read_results, stored_keys, stored_results
from stiff_protocols.cost import Cost
from stiff_protocols.errors import StoreError
from stiff_protocols.record import SCHEMA, Cell, CellResult, Presentation, ResultRecord
from stiff_protocols.types import Interval, Prediction

CELL = Cell("m", {"a": 1}, "d", {}, "00", "p", {}, 0, "11", 0)
SHOWN = Presentation("m@a=1", "d", "p", "simulated", "stiffness")


def made(index: int, run_id: str = "r", **changes) -> CellResult:
    """The result of a cell of its own for each number."""
    numbers = np.full((2, 3), index / 3)
    about = {
        "status": "ok",
        "records": (ResultRecord("mae", "x", index / 7, "m"),),
        "prediction": Prediction(np.array([4, 5]), numbers, numbers * 7),
    }
    return CellResult(replace(CELL, split_index=index), SHOWN, run_id, **(about | changes))


def failure(index: int, run_id: str = "r") -> CellResult:
    return CellResult(replace(CELL, split_index=index), SHOWN, run_id, "failed", failure="broke")


def contents(folder: Path) -> list[str]:
    """Everything that is stored of each cell, to the last bit, in the order of reading."""
    return [json_text(cell_content(result)) for result in read_results(folder)]


def found(folder: Path) -> Counter[tuple[int, str, str]]:
    """Which results and failures count, each with its run, and how often."""
    return Counter((r.cell.split_index, r.run_id, r.status) for r in read_results(folder))


names = st.text(st.characters(exclude_categories=["Cs"]), max_size=5)
numbers = st.floats(allow_nan=False, allow_infinity=False)
options = st.dictionaries(
    names, st.one_of(names, numbers, st.integers(-(2**63), 2**63 - 1), st.booleans())
)


@st.composite
def results(draw) -> CellResult:
    n = draw(st.integers(1, 3))
    arrays = st.lists(numbers, min_size=3 * n, max_size=3 * n).map(
        lambda values: np.array(values, dtype=float).reshape(n, 3)
    )
    coverage = draw(st.none() | st.floats(0.1, 0.9))
    cell = Cell(
        *(draw(names), draw(options), draw(names), draw(options), "00", draw(names)),
        *(draw(options), draw(st.integers(0, 10**6)), "11", draw(st.integers(0, 2**32))),
        coverage=coverage,
        condition=draw(names),
        code_sha256=draw(names),
    )
    about = {
        "diagnostics": draw(st.dictionaries(names, st.floats())),
        "warnings": tuple(draw(st.lists(names, max_size=2))),
        "log": tuple(draw(st.lists(names, max_size=2))),
        "n_splits": draw(st.integers(0, 10**4)),
    }
    if not draw(st.booleans()):
        status = draw(st.sampled_from(["failed", "skipped"]))
        return CellResult(cell, SHOWN, "r", status, failure=draw(names), cause="x", **about)
    interval = None
    if coverage is not None and draw(st.booleans()):
        bounds = draw(arrays), draw(arrays)
        interval = Interval(np.minimum(*bounds), np.maximum(*bounds), coverage)
    rows = np.array(draw(st.lists(st.integers(0, 2**60), min_size=n, max_size=n)), dtype=np.int64)
    reference = draw(st.none() | arrays)
    records = st.builds(ResultRecord, names, names, numbers, names)
    memory = draw(st.none() | st.integers(0, 2**40))
    return CellResult(
        *(cell, replace(SHOWN, caveats=(draw(names),)), "r", "ok"),
        records=tuple(draw(st.lists(records, max_size=3))),
        prediction=Prediction(rows, draw(arrays), draw(arrays), interval, reference),
        cost=draw(st.none() | st.builds(Cost, numbers, numbers, numbers, numbers, st.just(memory))),
        calibration_samples=draw(st.integers(0, 100)),
        n_train=draw(st.integers(0, 100)),
        chosen=draw(st.dictionaries(names, names)),
        **about,
    )


@settings(max_examples=25, deadline=None, suppress_health_check=[HealthCheck.too_slow])
@given(st.lists(results(), min_size=1, max_size=4))
def test_what_is_packed_comes_back_to_the_last_bit(tmp_path_factory, several):
    folder = tmp_path_factory.mktemp("results")
    store = ResultStore(folder)
    with patch("stiff_protocols.files.flush_to_disk"):
        for one in several:
            store.write_cell(one)
    before = contents(folder)
    assert pack(folder) == len(before)
    assert contents(folder) == before and not any((folder / "cells").iterdir())
    assert all(one.cell.key == replace(one.cell).key for one in read_results(folder))


def test_a_packed_folder_gives_the_same_contests_in_the_same_order(tmp_path):
    board = MadeResults(tmp_path)
    for run_id, model in zip("123", "abc", strict=True):
        board.add(model, [1.0, 2.0, 3.0], run_id=run_id, failed=[1], coverage=0.9)
    (before,) = collect(tmp_path)
    pack(tmp_path)
    (after,) = collect(tmp_path)
    assert (after.name, after.slots, after.newest_run) == (
        before.name,
        before.slots,
        before.newest_run,
    )
    assert after.cell == before.cell and list(after.competitors) == list("abc")
    for name, competitor in before.competitors.items():
        assert after.competitors[name].reasons == competitor.reasons
        assert after.competitors[name].done.keys() == competitor.done.keys()


def test_a_result_in_a_file_of_its_own_stands_before_a_packed_one(tmp_path):
    store = ResultStore(tmp_path)
    for run_id in ("1", "2", "3"):
        store.write_cell(made(0, run_id))
        if run_id != "3":
            pack(tmp_path)
    assert found(tmp_path) == {(0, "3", "ok"): 1}


def test_of_two_packs_the_newer_counts(tmp_path):
    for run_id in ("2", "1"):
        ResultStore(tmp_path).write_cell(made(0, run_id))
        pack(tmp_path)
    assert found(tmp_path) == {(0, "1", "ok"): 1}


@pytest.mark.parametrize("packings", range(8))
def test_a_result_counts_over_any_failure_before_it_or_after(tmp_path, packings):
    """Wherever packing comes between."""
    store = ResultStore(tmp_path)
    history = [failure(0, "1"), made(0, "2"), failure(0, "3")]
    for step, (one, counting) in enumerate(
        zip(history, [history[0], *[history[1]] * 2], strict=True)
    ):
        store.write_cell(one)
        if packings >> step & 1:
            pack(tmp_path)
        assert found(tmp_path) == {(0, counting.run_id, counting.status): 1}
    store.write_cell(made(0, "4"))
    assert found(tmp_path) == {(0, "4", "ok"): 1}


@pytest.mark.parametrize("packings", range(4))
def test_of_several_failures_the_newest_counts(tmp_path, packings):
    for step, run_id in enumerate("21"):  # the order of writing, whatever the runs' names
        ResultStore(tmp_path).write_cell(failure(0, run_id))
        if packings >> step & 1:
            pack(tmp_path)
    assert found(tmp_path) == {(0, "1", "failed"): 1}


def test_where_a_result_is_damaged_the_failure_after_it_is_what_is_left(tmp_path):
    store = ResultStore(tmp_path)
    path = store.write_cell(made(0))
    store.write_cell(failure(0))
    path.write_text("{")
    said: list[StoreError] = []
    assert [one.status for one in stored_results(tmp_path, report=said.append)] == ["failed"]
    assert len(said) == 1


def test_a_failure_that_gives_way_to_a_result_while_a_folder_is_read_is_that_result(tmp_path):
    store = ResultStore(tmp_path)
    store.write_cell(failure(0))
    store.write_cell(failure(1))
    reading = stored_results(tmp_path)
    with patch("stiff_bench.store.loose_files", return_value=loose_files(tmp_path)):
        store.write_cell(made(1))
        assert {(one.cell.split_index, one.status) for one in reading} == {
            (0, "failed"),
            (1, "ok"),
        }


def test_keys_say_which_cells_have_a_result(tmp_path):
    store = ResultStore(tmp_path)
    for one in (made(0), failure(1), made(2), failure(2)):
        store.write_cell(one)
    pack(tmp_path)
    for one in (failure(3), made(4), made(1)):
        store.write_cell(one)
    expected = {0: True, 1: True, 2: True, 3: False, 4: True}
    assert stored_keys(tmp_path) == {made(i).cell.key: ok for i, ok in expected.items()}


def test_only_what_is_asked_for_is_found(tmp_path):
    store = ResultStore(tmp_path)
    for index in range(4):
        store.write_cell(made(index))
        if index == 1:
            pack(tmp_path)
    wanted = {made(index).cell.key for index in (1, 3, 9)}
    assert {one.cell.split_index for one in store.find(wanted, pytest.fail)} == {1, 3}


@pytest.fixture()
def damaged(tmp_path) -> tuple[Path, bytes]:
    """A pack of two cells and its content; a third cell is loose."""
    store = ResultStore(tmp_path)
    for index in range(2):
        store.write_cell(made(index))
    pack(tmp_path)
    store.write_cell(made(2))
    (path,) = pack_files(tmp_path)
    return path, path.read_bytes()


def test_a_changed_or_cut_pack_is_found_damaged_wherever_it_is_changed(damaged, tmp_path):
    path, content = damaged
    for place in range(0, len(content), 97):
        path.write_bytes(content[:place] + bytes([content[place] ^ 1]) + content[place + 1 :])
        with pytest.raises(StoreError, match=f"{path}: damaged: the checksum"):
            list(read_results(tmp_path))
        path.write_bytes(content[:place])
        with pytest.raises(StoreError, match="damaged"):
            stored_keys(tmp_path)


def test_a_damaged_file_or_pack_is_reported_and_its_cells_are_missing(damaged, tmp_path):
    path, content = damaged
    path.write_bytes(content[:-1])
    (loose,) = (tmp_path / "cells").iterdir()
    said: list[StoreError] = []
    store = ResultStore(tmp_path)
    keys = {made(index).cell.key for index in range(3)}
    assert [one.cell.split_index for one in store.find(keys, said.append)] == [2]
    loose.write_text("{")
    assert not list(store.find(keys, said.append))
    assert [str(error).partition(":")[0] for error in said] == [str(path), str(loose), str(path)]
    assert list(stored_keys(tmp_path, said.append)) == [made(2).cell.key]
    for error in said:
        assert isinstance(error, DamagedFile)
        store.set_aside(error.path)
    store.write_cell(made(2))
    assert found(tmp_path) == {(2, "r", "ok"): 1}
    assert path.with_name(f"{path.name}.damaged").read_bytes() == content[:-1]
    assert stored_keys(tmp_path) == {made(2).cell.key: True}


def test_other_files_beside_packs_are_none(damaged, tmp_path):
    path, content = damaged
    names = (
        "1x.parquet",
        "000002.parquet",
        "mine.parquet",
        f"12-{'0' * 32}.parquet",
        path.name[:-8],
    )
    for name in (*names, f"{path.name}.damaged", f"000002-{'g' * 32}.parquet"):
        path.with_name(name).write_bytes(content)
    assert pack_files(tmp_path) == [path] and len(found(tmp_path)) == 3
    assert pack(tmp_path) == 1
    assert [one.name[:7] for one in pack_files(tmp_path)] == ["000002-", "000001-"]


def test_packs_are_in_the_order_of_their_numbers_however_many_there_are(tmp_path):
    ResultStore(tmp_path).write_cell(made(0, "1"))
    pack(tmp_path)
    (path,) = pack_files(tmp_path)
    path.rename(path.with_name(path.name.replace("000001", "999999")))
    for run_id in "23":
        ResultStore(tmp_path).write_cell(made(0, run_id))
        pack(tmp_path)
    numbers = [one.name.partition("-")[0] for one in pack_files(tmp_path)]
    assert numbers == ["1000001", "1000000", "999999"]
    assert found(tmp_path) == {(0, "3", "ok"): 1}


def test_a_damaged_file_does_not_hide_the_packed_result(tmp_path):
    store = ResultStore(tmp_path)
    store.write_cell(made(0, "1"))
    pack(tmp_path)
    store.write_cell(made(0, "2")).write_text("{")
    said: list[StoreError] = []
    assert [one.run_id for one in stored_results(tmp_path, report=said.append)] == ["1"]
    assert len(said) == 1


def test_packing_leaves_a_damaged_file_where_it_is(tmp_path):
    store = ResultStore(tmp_path)
    path = store.write_cell(made(0))
    path.write_text("{")
    store.write_cell(made(1))
    assert pack(tmp_path) == 1
    assert path.exists() and stored_keys(tmp_path) == {made(i).cell.key: True for i in (0, 1)}


def test_a_pack_that_is_no_parquet_or_of_another_format_is_refused(tmp_path):
    (tmp_path / "packs").mkdir()
    path = write_pack(tmp_path, [made(0)])
    table = pq.read_table(path).replace_schema_metadata({"schema": str(SCHEMA + 1)})
    with patch("stiff_bench.packs._hash", return_value=path.stem.partition("-")[2]):
        pq.write_table(table, path)
        with pytest.raises(StoreError, match=f"format {SCHEMA + 1}, this stiffbench reads"):
            list(read_results(tmp_path))
        path.write_bytes(b"no parquet")
        with pytest.raises(StoreError, match="damaged"):
            list(read_results(tmp_path))


@pytest.mark.parametrize(
    ("limit", "value", "n_packs"), [("CELLS_A_PACK", 3, 4), ("BYTES_A_PACK", 1, 10)]
)
def test_many_or_large_cells_go_into_several_packs(tmp_path, monkeypatch, limit, value, n_packs):
    monkeypatch.setattr(packs, limit, value)
    store = ResultStore(tmp_path)
    for index in range(5):
        store.write_cell(made(index))
        store.write_cell(failure(index + 5))
    before = contents(tmp_path)
    assert pack(tmp_path) == 10 and len(pack_files(tmp_path)) == n_packs
    assert contents(tmp_path) == before and len(before) == 10


def test_few_cells_are_not_packed_by_themselves(tmp_path, monkeypatch):
    ResultStore(tmp_path).write_cell(made(0))
    assert pack_if_many(tmp_path) == 0
    monkeypatch.setattr(packing, "ENOUGH_TO_PACK", 1)
    assert pack_if_many(tmp_path) == 1


def in_child(work: Callable[[], None]) -> int:
    """Do something in a forked process; its process id."""
    child = os.fork()
    if child == 0:
        status = 1
        signal.alarm(60)  # a test that hangs fails
        try:
            work()
            status = 0
        finally:
            os._exit(status)
    return child


def exit_status(child: int) -> int:
    return os.waitstatus_to_exitcode(os.waitpid(child, 0)[1])


STEPS = ("open", "os.rename", "os.remove", "os.chmod", "os.mkdir", "os.listdir", "os.scandir")
KILLED = 9


def killed_at(step: int, work: Callable[[], object]) -> bool:
    """Do something in a process that ends, without any cleaning, before its n-th look at a file."""

    def until_killed() -> None:
        left = step

        def hook(event: str, _: object) -> None:
            nonlocal left
            left -= event in STEPS
            if left < 0:
                os._exit(KILLED)

        sys.addaudithook(hook)
        work()

    status = exit_status(in_child(until_killed))
    assert status in (0, KILLED)
    return status == KILLED


def test_killed_between_any_two_steps_packing_loses_nothing_and_counts_nothing_twice(tmp_path):
    template = tmp_path / "results"
    store = ResultStore(template)
    for one in (made(0, "1"), failure(1, "1")):
        store.write_cell(one)
    pack(template)
    for one in (made(0, "2"), failure(0, "3"), made(1, "2"), made(2), failure(3)):
        store.write_cell(one)
    before = contents(template)
    step, killed = 0, True
    while killed:
        folder = tmp_path / str(step)
        shutil.copytree(template, folder)
        killed = killed_at(step, partial(pack, folder))
        assert contents(folder) == before
        pack(folder)
        assert contents(folder) == before and len(before) == 4
        left = {item.name for part in ("cells", "packs") for item in (folder / part).iterdir()}
        assert left == {path.name for path in pack_files(folder)}
        step += 1
    assert step > 20  # it was killed that often


def test_two_processes_that_pack_and_write_at_once_lose_nothing(tmp_path):
    indices = range(120)

    def write(run_id: str, mine: Sequence[int]) -> None:
        store = ResultStore(tmp_path)
        with patch("stiff_protocols.files.flush_to_disk"):
            for index in mine:
                store.write_cell(made(index, run_id))

    def pack_often() -> None:
        for _ in range(6):
            pack(tmp_path)

    write("old", indices)
    children = [
        in_child(lambda: write("new", indices[::2])),
        in_child(lambda: write("new", indices[1::2])),
        in_child(pack_often),
        in_child(pack_often),
    ]
    for _ in range(5):  # whoever reads meanwhile finds each cell once
        assert len(found(tmp_path)) == len(indices)
    assert [exit_status(child) for child in children] == [0] * 4
    pack(tmp_path)
    assert found(tmp_path) == {(index, "new", "ok"): 1 for index in indices}


def test_where_the_file_system_has_no_locks_only_packing_is_refused(tmp_path, monkeypatch):
    def without_locks(*_: object) -> None:
        raise OSError(errno.ENOLCK, "No locks available")

    monkeypatch.setattr(fcntl, "flock", without_locks)
    ResultStore(tmp_path).write_cell(made(0))
    with pytest.raises(StoreError, match=r"its file system has no locks .*; everything else works"):
        pack(tmp_path)
    monkeypatch.setattr(packing, "ENOUGH_TO_PACK", 1)
    assert pack_if_many(tmp_path) == 0
    assert len(found(tmp_path)) == 1


def test_a_folder_that_is_being_read_is_not_packed(tmp_path, monkeypatch):
    monkeypatch.setattr(folder_lock, "PATIENCE_S", 0.0)
    ResultStore(tmp_path).write_cell(made(0))
    reading = stored_results(tmp_path)
    next(reading)
    with pytest.raises(StoreError, match="another process reads or writes it"):
        pack(tmp_path)
    reading.close()
    assert pack(tmp_path) == 1


def test_a_folder_from_before_packs_is_read_and_packed(tmp_path):
    ResultStore(tmp_path).write_cell(made(0))
    (tmp_path / ".lock").unlink()
    assert len(found(tmp_path)) == 1 and not (tmp_path / ".lock").exists()
    assert pack(tmp_path) == 1 and len(found(tmp_path)) == 1


@contextmanager
def files_no_larger_than(n_bytes: int) -> Iterator[None]:
    before = resource.getrlimit(resource.RLIMIT_FSIZE)
    resource.setrlimit(resource.RLIMIT_FSIZE, (n_bytes, before[1]))
    try:
        yield
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, before)


def test_a_pack_that_finds_no_room_leaves_everything_as_it_was(tmp_path):
    ResultStore(tmp_path).write_cell(made(0))
    with (
        files_no_larger_than(1000),
        pytest.raises(StoreError, match=r"packs/.*: cannot be written"),
    ):
        pack(tmp_path)
    assert found(tmp_path) == {(0, "r", "ok"): 1} and not any((tmp_path / "packs").iterdir())


def test_a_cell_that_finds_no_room_leaves_the_old_one(tmp_path):
    store = ResultStore(tmp_path)
    path = store.write_cell(made(0, "1"))
    with files_no_larger_than(100), pytest.raises(StoreError, match="cannot be written: File too"):
        store.write_cell(made(0, "2"))
    assert found(tmp_path) == {(0, "1", "ok"): 1}
    assert list(path.parent.iterdir()) == [path]


def test_bench_pack_says_how_many_cells_it_packed(tmp_path):
    ResultStore(tmp_path).write_cell(made(0))
    assert bench("pack", str(tmp_path), cwd=tmp_path).stdout == f"packed: 1 cell of {tmp_path}\n"


def test_a_folder_without_results_is_not_packed(tmp_path):
    with pytest.raises(StoreError, match="holds no results"):
        pack(tmp_path)
