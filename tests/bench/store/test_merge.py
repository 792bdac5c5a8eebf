"""Folders of several machines become one, and what they contradict each other in is refused."""

from __future__ import annotations

import subprocess
import sys
from dataclasses import replace
from itertools import count

import pytest
from click.testing import CliRunner

from helpers.made_results import TWINS, MadeResults, change, damage, forget, made_data, tear
from stiff_bench.analysis.collected import StoredResults
from stiff_bench.cli.results import merge as merge_command
from stiff_bench.store import merging
from stiff_bench.store.database import FILE, ResultStore, read_data, read_manifests, read_results
from stiff_bench.store.merging import merge
from stiff_protocols.contract.errors import ConfigError, StoreError

EARLY, LATE = "20261121T120000Z-aaaaaa", "20261122T120000Z-bbbbbb"
NOTHING: frozenset = frozenset()


def folder_of(path, model, errors_mm=(0.1, 0.2), *, run_id=EARLY, code="", **how):
    """A folder with a finished run of one model; returns its path."""
    made = MadeResults(path)
    keys = made.add(model, errors_mm, run_id=run_id, **how)
    if code:
        store = ResultStore(path)
        for key in keys:
            result = store.result(key)
            forget(path, key)
            store.write_cells([replace(result, cell=replace(result.cell, model_version=code))])
    made.add_run(run_id, keys)
    return path


def contents(folder):
    """Every result of a folder by key, as comparable as its parts are."""
    return {
        (one.cell.key, one.status): (
            one.cell,
            one.shown,
            one.run_id,
            one.records,
            one.prediction and one.prediction.predicted.tobytes(),
        )
        for one in read_results(folder)
    }


def files_of(folder):
    return {path: path.read_bytes() for path in sorted(folder.rglob("*")) if path.is_file()}


@pytest.fixture()
def two(tmp_path):
    return folder_of(tmp_path / "a", "vjm"), folder_of(tmp_path / "b", "knn", run_id=LATE)


def test_cells_runs_and_data_of_all_folders_are_in_the_new_one_and_the_folders_stay(two, tmp_path):
    before = [files_of(folder) for folder in two]
    merged = merge(two, tmp_path / "c", NOTHING)
    assert [files_of(folder) for folder in two] == before
    assert contents(tmp_path / "c") == contents(two[0]) | contents(two[1])
    assert {run.run_id for run in read_manifests(tmp_path / "c")} == {EARLY, LATE}
    assert (merged.n_cells, merged.n_there, merged.damaged) == (4, 0, ())
    assert merged.taken == {two[0]: (2, 2), two[1]: (2, 2)}
    (case,) = StoredResults.read(tmp_path / "c").cases
    assert set(case.competitors) == {"knn", "vjm"}
    assert len(read_data(tmp_path / "c", case.name.data_sha256).samples) == 12


def merged_both_ways(folders, tmp_path):
    """Merge two folders in both orders; yield each folder and what was merged."""
    for name, order in (("there", folders), ("back", folders[::-1])):
        yield tmp_path / name, merge(order, tmp_path / name, NOTHING)


def test_a_cell_that_several_folders_have_counts_once_and_of_other_numbers_the_newest(tmp_path):
    old = folder_of(tmp_path / "old", "vjm", (0.1, 0.2, 0.3))
    new = folder_of(tmp_path / "new", "vjm", (0.1, 0.25), run_id=LATE)
    for folder, merged in merged_both_ways((old, new), tmp_path):
        assert (merged.n_cells, merged.n_other_numbers) == (3, 1)
        runs = [result.run_id for result in read_results(folder)]
        assert sorted(runs) == [EARLY, LATE, LATE]


def test_a_result_stands_before_a_newer_failure(tmp_path):
    done = folder_of(tmp_path / "done", "vjm", (0.1,))
    failed = folder_of(tmp_path / "failed", "vjm", (), failed=(0,), run_id=LATE)
    for folder, _ in merged_both_ways((done, failed), tmp_path):
        (result,) = read_results(folder)
        assert (result.status, result.run_id) == ("ok", EARLY)


def test_what_the_output_holds_stays_and_gives_way_to_newer_results(tmp_path):
    there = folder_of(tmp_path / "c", "vjm", (0.1, 0.2, 0.3))
    new = folder_of(tmp_path / "new", "vjm", (0.15, 0.2), run_id=LATE)
    merged = merge([new], there, NOTHING)
    assert (merged.n_there, merged.n_cells) == (3, 3)
    results = {one.cell.split_index: one for one in read_results(there)}
    assert [results[split].run_id for split in range(3)] == [LATE, LATE, EARLY]
    assert merge([new, there], there, NOTHING).taken == {new: (2, 0)}


def test_the_same_merge_again_changes_nothing(two, tmp_path):
    merge(two, tmp_path / "c", NOTHING)
    before = files_of(tmp_path / "c")
    merged = merge(two, tmp_path / "c", NOTHING)
    assert [taken for _, taken in merged.taken.values()] == [0, 0]
    assert files_of(tmp_path / "c") == before


def disagreeing(kind, tmp_path):
    """Two folders that differ in one kind of thing."""
    changed = {
        "data": {"version": 1},
        "split": {"splits_named": "other-"},
        "code": {"code": "c0de"},
    }[kind]
    plain = {"code": "01d"} if kind == "code" else {}
    first = folder_of(tmp_path / "first", "vjm", **plain)
    return first, folder_of(tmp_path / "second", "vjm", run_id=LATE, **changed)


@pytest.mark.parametrize("kind", ["data", "split", "code"])
def test_other_data_splits_or_code_are_refused_unless_told_otherwise(kind, tmp_path):
    folders = disagreeing(kind, tmp_path)
    for others in (NOTHING, {"data", "split", "code"} - {kind}):
        with pytest.raises(ConfigError, match=rf"{kind} of .* \(allow {kind} to merge"):
            merge(folders, tmp_path / "c", others)
        assert not (tmp_path / "c").exists()
    before = contents(folders[0])
    with pytest.raises(ConfigError, match=f"allow {kind}"):
        merge(folders[1:], folders[0], NOTHING)  # the output's own results count too
    assert contents(folders[0]) == before
    merged = merge(folders, tmp_path / "c", {kind})
    (line,) = merged.disagreements
    assert line.startswith(f"{kind} of ") and all(f"{one}: " in line for one in folders)
    assert contents(tmp_path / "c") == contents(folders[0]) | contents(folders[1])
    assert merge(folders, tmp_path / "c", {kind}).n_cells == 4


def test_what_an_older_run_of_a_folder_had_is_its_past(tmp_path):
    first = folder_of(tmp_path / "a", "vjm", code="01d")
    folder_of(tmp_path / "a", "vjm", run_id=LATE, code="c0de")
    second = folder_of(tmp_path / "b", "vjm", (0.1, 0.2, 0.3), run_id=LATE, code="c0de")
    assert merge([first, second], tmp_path / "c", NOTHING).n_cells == 5
    stale = folder_of(tmp_path / "stale", "vjm", code="01d")
    with pytest.raises(ConfigError, match="code of vjm"):
        merge([first, stale], tmp_path / "d", NOTHING)


def test_sources_of_another_hash_are_other_data(tmp_path):
    first = folder_of(tmp_path / "a", "ft-mlp", protocol="cross-robot", source="5")
    second = folder_of(tmp_path / "b", "ft-mlp", protocol="cross-robot", source="6", run_id=LATE)
    with pytest.raises(ConfigError, match="data of source of cross-robot for twin"):
        merge([first, second], tmp_path / "c", NOTHING)


def test_damaged_rows_are_named_left_out_and_taken_from_who_has_them_whole(tmp_path):
    first = folder_of(tmp_path / "a", "vjm", (0.1, 0.2, 0.3))
    second = folder_of(tmp_path / "b", "vjm", (0.1,), run_id=LATE)
    cells = [one.cell for one in read_results(first)]
    damage(first, *(cell.key for cell in cells))
    change(first, "UPDATE data SET content = x'00'")
    merged = merge([first, second], tmp_path / "c", NOTHING)
    named = [*(cell.key for cell in cells), cells[0].data_sha256]
    assert [name in " ".join(merged.damaged) for name in named] == [True] * 4
    (result,) = read_results(tmp_path / "c")
    assert result.run_id == LATE
    read_data(tmp_path / "c", cells[0].data_sha256)


@pytest.mark.slow
def test_of_a_torn_file_the_readable_cells_are_taken(two, tmp_path):
    expected = contents(two[0]) | contents(two[1])
    tear(two[0], "run")
    before = files_of(two[0])
    merged = merge(two, tmp_path / "c", NOTHING)
    assert contents(tmp_path / "c") == expected and files_of(two[0]) == before
    assert str(two[0] / FILE) in merged.damaged[0] and merged.taken[two[0]] == (2, 2)


def test_a_record_under_another_cells_name_is_left_out(tmp_path):
    folder = folder_of(tmp_path / "a", "vjm", (0.1,))
    (result,) = read_results(folder)
    forget(folder, result.cell.key)
    vars(result.cell)["key"] = "../../evil"
    ResultStore(folder).write_cells([result])
    merged = merge([folder], tmp_path / "c", NOTHING)
    assert len(merged.damaged) == 1 and not read_results(tmp_path / "c")


def test_of_a_run_that_was_copied_while_it_ran_the_last_state_counts(tmp_path):
    folders = [folder_of(tmp_path / name, "vjm") for name in "ab"]
    (run,) = read_manifests(folders[0])
    ResultStore(folders[0]).write_manifest(replace(run, status="running"))
    for folder, _ in merged_both_ways(folders, tmp_path):
        (found,) = read_manifests(folder)
        assert found.status == "finished"


@pytest.mark.parametrize("n", [0, 1])
def test_a_merge_that_was_stopped_is_completed_by_the_same_one(two, tmp_path, monkeypatch, n):
    """A folder is taken whole or not at all."""
    three = (*two, folder_of(tmp_path / "t", "vjm", dataset=TWINS[1]))
    each = [contents(folder) for folder in three]
    calls = count()
    whole = merging.write_run

    def killed(db, run):
        if next(calls) == n:
            raise KeyboardInterrupt
        whole(db, run)

    with monkeypatch.context() as patched:
        patched.setattr(merging, "write_run", killed)
        with pytest.raises(KeyboardInterrupt):
            merge(three, tmp_path / "c", NOTHING)
    assert contents(tmp_path / "c") == dict(item for one in each[:n] for item in one.items())
    merge(three, tmp_path / "c", NOTHING)
    assert contents(tmp_path / "c") == dict(item for one in each for item in one.items())
    assert {run.run_id for run in read_manifests(tmp_path / "c")} == {EARLY, LATE}


MERGE = "import sys; from pathlib import Path; from stiff_bench.store.merging import merge; \
merge([Path(sys.argv[1])], Path(sys.argv[2]), frozenset())"


def test_two_merges_into_one_folder_at_once_do_no_harm(two, tmp_path):
    words = [[sys.executable, "-c", MERGE, one, tmp_path / "c"] for one in two]
    running = [subprocess.Popen(one) for one in words]
    assert [one.wait(60) for one in running] == [0, 0]
    assert contents(tmp_path / "c") == contents(two[0]) | contents(two[1])


def test_a_folder_that_changes_meanwhile_is_said(two, tmp_path, monkeypatch):
    lost = read_results(two[0])[0].cell.key

    def vanishes(*_):
        forget(two[0], lost)
        return ()

    monkeypatch.setattr(merging, "_data_to_copy", vanishes)
    with pytest.raises(StoreError, match="1 of its results cannot be read any more"):
        merge(two, tmp_path / "c", NOTHING)


@pytest.mark.parametrize("where", ["nowhere", "c"])
def test_there_must_be_something_to_take(tmp_path, where):
    MadeResults(tmp_path / "c")
    with pytest.raises((ConfigError, StoreError), match=where):
        merge([tmp_path / where], tmp_path / "c", NOTHING)


def run(*words):
    return CliRunner().invoke(merge_command, [str(word) for word in words], standalone_mode=False)


def test_the_command_says_what_it_took_and_its_status_is_1_where_a_file_was_left_out(two, tmp_path):
    done = run(*two, "--output", tmp_path / "c")
    assert done.return_value == 0
    assert f"{two[0]}: 2 of 2 results taken" in done.output
    assert f"4 results in {tmp_path / 'c'}, 0 of them from before" in done.output
    change(two[0], "UPDATE run SET command = 'other'")
    done = run(*two, "--output", tmp_path / "d")
    assert (
        done.return_value == 1 and f"left out: {two[0] / FILE}: damaged: run {EARLY}" in done.output
    )


def test_the_command_shows_what_differs(tmp_path):
    first, second = disagreeing("data", tmp_path)
    refused = run(first, second, "--output", tmp_path / "c")
    hashes = [made_data(sum(b"twin") + version).sha256[:8] for version in (0, 1)]
    line = f"data of twin ({first}: {hashes[0]}; {second}: {hashes[1]})"
    assert isinstance(refused.exception, ConfigError) and line in str(refused.exception)
    allowed = run(first, second, "--output", tmp_path / "c", "--allow", "data")
    assert allowed.return_value == 0 and line in allowed.output
