"""Merging folders of several machines; conflicting numbers of a fit are refused."""

from __future__ import annotations

from dataclasses import replace
from itertools import count

import pytest

from helpers.command_line import bench_here
from helpers.made_results import MadeResults, damage
from stiff_bench.results.load import StoredResults
from stiff_bench.store import merging
from stiff_bench.store.database import ResultStore, read_data, read_manifests, read_results
from stiff_bench.store.merging import merge
from stiff_protocols.contract.errors import ConfigError

EARLY, LATE = "20261121T120000Z-aaaaaa", "20261122T120000Z-bbbbbb"


def folder_of(path, model, errors_mm=(0.1, 0.2), *, run_id=EARLY, **how):
    """Write a folder with a finished run of one model; return its path."""
    made = MadeResults(path)
    made.add_run(run_id, made.add(model, errors_mm, run_id=run_id, **how))
    return path


def contents(folder):
    """Return every result of a folder by key, in comparable parts."""
    return {
        (result.fit.key, result.status): (
            *(result.fit, result.presentation, result.run_id),
            result.prediction and result.prediction.predicted.tobytes(),
        )
        for result in read_results(folder)
    }


def files_of(folder):
    return {path: path.read_bytes() for path in sorted(folder.rglob("*")) if path.is_file()}


@pytest.fixture()
def two(tmp_path):
    return folder_of(tmp_path / "a", "vjm"), folder_of(tmp_path / "b", "knn", run_id=LATE)


def test_cells_runs_and_data_of_all_folders_are_in_the_new_one_and_the_folders_stay(two, tmp_path):
    before = [files_of(folder) for folder in two]
    merged = merge(two, tmp_path / "c")
    assert [files_of(folder) for folder in two] == before
    assert contents(tmp_path / "c") == contents(two[0]) | contents(two[1])
    assert {run.run_id for run in read_manifests(tmp_path / "c")} == {EARLY, LATE}
    assert (merged.n_fits, merged.n_there) == (4, 0)
    assert merged.taken == {two[0]: (2, 2), two[1]: (2, 2)}
    (task,) = StoredResults.read(tmp_path / "c").tasks
    assert set(task.models) == {"knn", "vjm"}
    assert len(read_data(tmp_path / "c", task.name.data_sha256).samples) == 12
    merged_contents = contents(tmp_path / "c")
    again = merge([*two, tmp_path / "c"], tmp_path / "c")
    assert (
        again.taken == {two[0]: (2, 0), two[1]: (2, 0)}
        and contents(tmp_path / "c") == merged_contents
    )


def merged_both_ways(folders, tmp_path):
    """Merge two folders in both orders; yield each output."""
    for name, order in (("there", folders), ("back", folders[::-1])):
        merge(order, tmp_path / name)
        yield tmp_path / name


def test_a_result_of_a_cell_counts_before_newer_failures_and_then_the_newest_failure(tmp_path):
    done = folder_of(tmp_path / "done", "vjm", (0.1,))
    failed = folder_of(tmp_path / "failed", "vjm", (), failed=(0,), run_id=LATE)
    older = folder_of(tmp_path / "older", "vjm", (), failed=(0,))
    for folders, expected in (((done, failed), ("ok", EARLY)), ((older, failed), ("failed", LATE))):
        for folder in merged_both_ways(folders, tmp_path / folders[0].name / "merged"):
            (result,) = read_results(folder)
            assert (result.status, result.run_id) == expected


@pytest.mark.parametrize("changed", [1e-8, 0.05])
def test_different_numbers_of_one_cell_are_refused_and_rounding_is_none(tmp_path, changed):
    """Errors are in mm: a difference of 1e-11 m is rounding, one of 5e-5 m is not."""
    first = folder_of(tmp_path / "first", "vjm", (0.1, 0.2))
    second = folder_of(tmp_path / "second", "vjm", (0.1 + changed, 0.2), run_id=LATE)
    before = contents(first)
    if changed > 1e-6:
        with pytest.raises(
            ConfigError, match=r"different numbers of one fit: vjm on twin.*split 0"
        ):
            merge([second], first)
    else:
        assert merge([second], first).taken == {second: (2, 0)}
    assert contents(first) == before


@pytest.mark.parametrize("how", [{"version": 1}, {"splits_named": "other-"}])
def test_other_data_or_splits_under_one_name_are_other_cells_and_stay_apart(tmp_path, how):
    first = folder_of(tmp_path / "a", "vjm")
    second = folder_of(tmp_path / "b", "vjm", run_id=LATE, **how)
    assert merge([first, second], tmp_path / "c").n_fits == 4
    of_tasks = [task.results("vjm") for task in StoredResults.read(tmp_path / "c").tasks]
    assert len(of_tasks) == (2 if "version" in how else 1) and len(of_tasks[-1]) == 2


def test_the_last_state_of_a_run_that_was_copied_while_it_ran_counts(tmp_path):
    folders = [folder_of(tmp_path / name, "vjm") for name in "ab"]
    (run,) = read_manifests(folders[0])
    ResultStore(folders[0]).write_manifest(replace(run, status="running"))
    for folder in merged_both_ways(folders, tmp_path):
        (manifest,) = read_manifests(folder)
        assert manifest.status == "finished"


def test_a_merge_that_is_stopped_changes_nothing(two, tmp_path, monkeypatch):
    there = folder_of(tmp_path / "c", "gp")
    before, calls = contents(there), count()

    def killed(db, result):
        if next(calls) == 3:
            raise KeyboardInterrupt

    monkeypatch.setattr(merging, "write_row", killed)
    with pytest.raises(KeyboardInterrupt):
        merge(two, there)
    assert contents(there) == before


def test_the_command_counts_what_it_took_and_refuses_a_corrupt_folder(two, tmp_path):
    done = bench_here("merge", "a", "b", "--output", "c", cwd=tmp_path)
    assert done.returncode == 0 and "a: 2 of 2 results taken" in done.stdout
    assert "4 results in c, 0 from before" in done.stdout
    damage(two[0], read_results(two[0])[0].fit.key)
    done = bench_here("merge", "a", "b", "--output", "d", cwd=tmp_path)
    assert done.returncode == 2 and "a/results.sqlite: corrupt: fit " in done.stderr
    assert not (tmp_path / "d").exists()
