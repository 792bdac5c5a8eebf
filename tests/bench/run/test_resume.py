"""A stopped run continues: nothing is lost, nothing is computed twice."""

from __future__ import annotations

import random
import re
import resource
import signal
from pathlib import Path

import psutil
import pytest

from helpers import hostile_models
from helpers.command_line import bench, bench_here, n_stored, started, wait_until
from helpers.made_results import damage
from helpers.run_requests import planned
from stiff_bench.api.evaluation import Run
from stiff_bench.results.load import StoredResults
from stiff_bench.run.execution import Execution
from stiff_bench.store.database import (
    FILE,
    read_manifests,
    read_results,
    reading,
    stored_statuses,
)
from stiff_protocols.contract.errors import StoreError
from stiffbench.commands import execute
from stiffbench.main import INTERRUPTION

PLUGIN = Path(hostile_models.__file__)
N_SPLITS = 5
N_CELLS = 2 * N_SPLITS  # with the reference model
SLOW_RUN = ["run", "--plugin", str(PLUGIN), "--model", "DetachesAChild@seconds=0.3"]
SLOW_RUN += ["--splits", str(N_SPLITS), "--output", "out"]
RERUN = {name: Execution(rerun=name) for name in ("missing", "failed", "all")}


@pytest.fixture()
def run(tmp_path, capsys):
    """A function that runs zero and knn on three FANUC splits and returns the output."""

    def execute_it(rerun="missing", **changes):
        words = {"models": ("zero", "knn"), "datasets": ("fanuc-r2000ic",), "splits": 3}
        plan = planned(output=tmp_path, **words | changes)
        status = execute(Run([plan], RERUN[rerun]), "csv")
        out, err = capsys.readouterr()
        return status, out, err

    return execute_it


def summary_of(message: str) -> str:
    """Return the counts of the summary line."""
    return re.findall(r"bench: (\d+ (?:ok|failed|cached).*?);", message)[-1]


def bytes_of_results(folder: Path) -> dict[str, bytes]:
    """Return each fit's prediction by key; every key must be unique."""
    results = list(read_results(folder))
    predictions = {result.fit.key: result.prediction.predicted.tobytes() for result in results}
    assert len(predictions) == len(results)
    return predictions


@pytest.mark.slow
def test_the_same_command_again_computes_nothing_and_prints_the_same_table(run, tmp_path):
    _, first, message = run()
    assert summary_of(message) == "6 ok"
    before = rows_of_fits(tmp_path)
    status, again, message = run()
    assert (status, summary_of(message)) == (0, "6 cached")
    assert again == first
    assert rows_of_fits(tmp_path) == before


def rows_of_fits(folder: Path) -> list[tuple[object, ...]]:
    with reading(folder) as db:
        return db.execute("SELECT * FROM cell ORDER BY key").fetchall()


@pytest.mark.slow
def test_more_splits_compute_those_that_are_missing(run, tmp_path):
    run(splits=2)
    _, table, message = run(splits=5)
    assert summary_of(message) == "6 ok, 4 cached"
    (task,) = StoredResults.read(tmp_path).tasks
    assert {stored.n_requested for stored in task.models.values()} == {5}
    assert table == run(splits=5)[1]


@pytest.mark.slow
def test_a_corrupt_row_is_an_error_and_all_is_computed_again_on_request(run, tmp_path):
    run()
    results_before = bytes_of_results(tmp_path)
    key = sorted(results_before)[2]
    damage(tmp_path, key)
    with pytest.raises(StoreError, match=f"corrupt: fit {key}: .*--rerun all: bench run"):
        run()
    assert summary_of(run("all")[2]) == "6 ok"
    assert bytes_of_results(tmp_path) == results_before


@pytest.mark.slow
def test_failures_stay_until_they_are_requested_again(tmp_path):
    flag = tmp_path / "fixed"
    plugin = tmp_path / "mine.py"
    plugin.write_text(
        PLUGIN.read_text().replace(
            "time.sleep(self.seconds)",
            f"if not os.path.exists({str(flag)!r}): raise OSError('no licence today')",
        )
    )
    words = ["run", "--plugin", str(plugin), "--model", "Good", "--model", "knn", "--splits", "2"]
    words += ["--no-isolate", "--output", "out"]
    first = bench_here(*words, cwd=tmp_path)
    assert first.returncode == 1 and summary_of(first.stderr) == "4 ok, 2 failed (OSError)"
    flag.touch()
    second = bench_here(*words, cwd=tmp_path)
    assert second.returncode == 1
    assert summary_of(second.stderr) == "2 failed (OSError), 4 cached"
    assert "2 of the failures are of earlier runs; --rerun failed repeats them" in second.stderr
    assert "FAILED: Good (2 fits): OSError: no licence today" in second.stdout
    third = bench_here(*words, "--rerun", "failed", cwd=tmp_path)
    assert third.returncode == 0 and summary_of(third.stderr) == "2 ok, 4 cached"
    assert set(stored_statuses(tmp_path / "out").values()) == {"ok"}


@pytest.mark.slow
def test_a_disk_that_is_full_stops_the_run_and_what_was_stored_stays(tmp_path):
    words = ["run", "--model", "knn", "--output", "out", "--splits"]
    assert bench_here(*words, "1", cwd=tmp_path).returncode == 0
    size = (tmp_path / "out" / FILE).stat().st_size

    def small_files() -> None:
        resource.setrlimit(resource.RLIMIT_FSIZE, (size, size))
        signal.signal(signal.SIGXFSZ, signal.SIG_IGN)

    done = bench(*words, "12", cwd=tmp_path, preexec_fn=small_files)
    assert done.returncode == 2
    last = done.stderr.strip().splitlines()[-1]
    assert last.startswith(f"bench: error: out/{FILE}: cannot be written: ")
    assert "Traceback" not in done.stderr and (n_there := n_stored(tmp_path / "out")) >= 1
    after = bench_here(*words, "12", cwd=tmp_path)
    assert after.returncode == 0
    assert summary_of(after.stderr) == f"{24 - n_there} ok, {n_there} cached"


@pytest.fixture(scope="module")
def reference(tmp_path_factory):
    """Return the results of the slow run without interruption."""
    folder = tmp_path_factory.mktemp("reference")
    assert bench_here(*SLOW_RUN, "--jobs", "2", cwd=folder).returncode == 0
    return bytes_of_results(folder / "out")


@pytest.mark.slow
@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM, signal.SIGKILL, signal.SIGQUIT])
def test_a_run_that_is_stopped_at_any_moment_goes_on_with_what_is_missing(
    tmp_path, reference, number
):
    words = [*SLOW_RUN, "--jobs", "2"]
    n_before = random.Random(number).randrange(1, N_SPLITS)
    with started(*words, cwd=tmp_path) as command:
        wait_until(lambda: n_stored(tmp_path / "out") >= n_before)
        family = psutil.Process(command.pid).children(recursive=True)
        command.send_signal(number)
        printed, message = command.communicate(timeout=60)
    assert family and not psutil.wait_procs(family, timeout=20)[1]
    stored = n_stored(tmp_path / "out")
    assert 0 < stored < N_CELLS
    assert {*stored_statuses(tmp_path / "out").values()} == {"ok"}  # no fit failed
    (manifest,) = read_manifests(tmp_path / "out")
    caught = number in (signal.SIGINT, signal.SIGTERM)
    assert command.returncode == (128 + number if caught else -number) and printed == ""
    assert manifest.status == ("interrupted" if caught else "running")
    assert not caught or message.strip().splitlines()[-1] == f"bench: {INTERRUPTION}"
    assert "Traceback" not in message
    done = bench_here(*words, cwd=tmp_path)
    assert done.returncode == 0
    assert summary_of(done.stderr) == f"{N_CELLS - stored} ok, {stored} cached"
    assert bytes_of_results(tmp_path / "out") == reference
    assert [path.name for path in (tmp_path / "out").iterdir()] == [FILE]


@pytest.mark.slow
def test_two_runs_in_one_folder_share_the_work_and_neither_harms_the_other(tmp_path, reference):
    jobs = ("--jobs", "2")
    with (
        started(*SLOW_RUN, cwd=tmp_path) as first_run,
        started(*SLOW_RUN, *jobs, cwd=tmp_path) as second_run,
    ):
        messages = [command.communicate(timeout=120)[1] for command in (first_run, second_run)]
    assert first_run.returncode == second_run.returncode == 0
    assert bytes_of_results(tmp_path / "out") == reference
    computed = [int(summary_of(text).split()[0]) for text in messages]
    assert sum(computed) < 2 * N_CELLS  # fits that the other run had finished were not repeated
    assert len(list(read_manifests(tmp_path / "out"))) == 2
