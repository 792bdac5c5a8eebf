"""Fits in separate processes, here and on Dask: a faulty model loses only its row."""

from __future__ import annotations

import os
from contextlib import suppress
from pathlib import Path
from tempfile import TemporaryDirectory

import psutil
import pytest

from helpers import hostile_models
from helpers.command_line import bench, bench_here, started, wait_until
from helpers.quick_models import KEYS
from helpers.run_requests import planned
from stiff_bench.plan.fits import fit_tasks
from stiff_bench.plan.registry import build_registry
from stiff_bench.run.execution import compute_fit
from stiff_bench.run.fit_process import Limits
from stiff_bench.run.isolate import SERVER_ENDED, LocalProcesses
from stiff_bench.store.database import FILE, read_manifests, read_results
from stiff_models.model_catalog import model_info

pytestmark = pytest.mark.xdist_group("isolated")  # one server of processes
PLUGIN = Path(hostile_models.__file__)


class RecordingDisplay:
    """A display that records its calls."""

    def __init__(self):
        self.started, self.steps = [], []

    def start(self, task):
        self.started.append(task)

    def step(self, progress):
        self.steps.append(progress)


@pytest.fixture()
def computed():
    """A function that computes a plan's fits in separate processes."""

    def compute(*models, jobs=1, display=None, **plan):
        registry = build_registry()
        registry.add(hostile_models.MODELS, "a third party's")
        tasks = list(fit_tasks(planned(registry, models=models, **plan)))
        how = LocalProcesses(at_once=jobs, limits=Limits())
        return tasks, how.results(iter(tasks), "r", display or RecordingDisplay())

    return compute


@pytest.mark.slow
def test_a_model_finds_no_test_label_in_its_process_and_none_of_its_scores(computed):
    good_result, *thief_results = computed("Good", "StealsTest", "PatchesTheEngine", splits=1)[1]
    assert good_result.status == "ok" and good_result.prediction is not None
    for thief_result in thief_results:
        thief_predicted = thief_result.prediction.predicted
        assert thief_predicted.tobytes() == good_result.prediction.predicted.tobytes()


@pytest.mark.slow
def test_every_model_of_the_catalogue_runs_in_a_process_as_it_does_in_this_one(
    computed,
):
    keys = [key for key in KEYS if not model_info(key).missing()]
    quick = {key: model_info(key).quick.items() for key in keys}
    settings = tuple(f"{key}.{name}={value}" for key in keys for name, value in quick[key])
    options = {"settings": settings, "datasets": ("fanuc-r2000ic",), "splits": 1, "jobs": 2}
    tasks, results = computed(*keys, **options)
    results_by_model = {result.fit.model: result for result in results}
    outcomes = {key: (result.status, result.failure) for key, result in results_by_model.items()}
    assert outcomes == dict.fromkeys(keys, ("ok", ""))
    for task in tasks:
        if task.fit.model in ("vjm", "knn", "mlp", "sklearn:ensemble.RandomForestRegressor"):
            here, there = compute_fit(task, "r"), results_by_model[task.fit.model]
            assert there.prediction.predicted.tobytes() == here.prediction.predicted.tobytes()


@pytest.mark.slow
def test_what_a_cell_reports_is_shown_and_what_it_prints_is_not(computed, capfd):
    seen = RecordingDisplay()
    (result,) = computed("Reports", splits=1, display=seen)[1]
    assert result.status == "ok" and len(seen.started) == 1
    assert [(step.phase, step.step, step.total) for step in seen.steps] == [("thinking", 3, 7)]
    assert "past Python" not in "".join(capfd.readouterr())


@pytest.mark.slow
def test_a_crash_costs_only_its_own_row(tmp_path):
    models = [word for key in ("Segfaults", "Raises", "knn") for word in ("--model", key)]
    done = bench_here("run", "--plugin", str(PLUGIN), *models, "--output", "out", cwd=tmp_path)
    assert done.returncode == 1
    assert "bench: 2 ok, 2 failed (1 SIGSEGV, 1 RuntimeError); " in done.stderr
    assert (
        "| knn " in done.stdout
        and "FAILED: Segfaults (1 fit): its process was ended" in done.stdout
    )


@pytest.mark.slow
def test_a_fit_that_ends_the_server_of_all_fits_loses_only_its_row(computed):
    seen, models = RecordingDisplay(), ("Good", "KillsTheServer", "KillsTheGroup")
    settings = ("Good.seconds=1",)
    results = [*computed(*models, settings=settings, splits=1, jobs=3, display=seen)[1]]
    statuses = {result.fit.model: (result.status, result.cause) for result in results}
    assert statuses == {
        "Good": ("ok", ""),
        **dict.fromkeys(models[1:], ("failed", SERVER_ENDED)),
    }
    assert len(results) == len(seen.started) == 3


@pytest.mark.slow
def test_what_a_model_does_becomes_its_own_row_and_no_process_stays(tmp_path):
    models = [word for key in hostile_models.ROWS for word in ("--model", key)]
    limits = ["--timeout", "8", "--memory", "500MiB"]
    words = ["run", "--plugin", str(PLUGIN), *models, *limits, "--jobs", "4", "--output", "out"]
    done = bench(*words, cwd=tmp_path)
    folders = [process.info["cwd"] for process in psutil.process_iter(["cwd"])]
    assert str(tmp_path) not in folders
    results = {result.fit.model: result for result in read_results(tmp_path / "out")}
    hostile_models.assert_rows(results, hostile_models.ROWS)
    last = done.stderr.strip().splitlines()[-1]
    assert done.returncode == 1 and last.startswith("bench: 4 ok, 11 failed (3 timed out, 2 out of")
    assert "1 SIGSEGV" in last and "    | about to raise" in done.stderr
    assert [path.name for path in (tmp_path / "out").iterdir()] == [FILE]


@pytest.mark.slow
def test_third_party_models_are_isolated_and_ours_on_request_as_the_manifest_records(tmp_path):
    facts = {}
    for name, words in {
        "ours": ["--model", "vjm"],
        "requested": ["--model", "zero", "--threads", "2", "--isolate"],
        "third-party": ["--plugin", str(PLUGIN), "--model", "Good"],
        "refused": ["--plugin", str(PLUGIN), "--model", "Good", "--no-isolate"],
    }.items():
        assert bench_here("run", *words, "--output", name, cwd=tmp_path).returncode == 0
        (manifest,) = read_manifests(tmp_path / name)
        facts[name] = manifest.environment
    isolated = [name for name, environment in facts.items() if environment["isolated"] == "true"]
    assert isolated == ["requested", "third-party"]
    assert (facts["requested"]["jobs"], facts["requested"]["OMP_NUM_THREADS"]) == ("1", "2")


@pytest.mark.slow
def test_a_plugin_that_changes_during_a_run_gives_no_result_under_the_old_key(tmp_path):
    plugin = tmp_path / "mine.py"
    good = PLUGIN.read_text()
    plugin.write_text(
        good.replace("time.sleep(self.seconds)", f"open({str(plugin)!r}, 'a').write('# changed')")
    )
    words = ["run", "--plugin", str(plugin), "--model", "Good", "--splits", "2", "--output", "out"]
    done = bench(*words, cwd=tmp_path)
    of_good = [result for result in read_results(tmp_path / "out") if result.fit.model == "Good"]
    first, second = sorted(of_good, key=lambda result: result.fit.split_index)
    assert done.returncode == 1
    assert (first.status, second.status, second.cause) == ("ok", "failed", "other code")


@pytest.mark.slow
def test_processes_that_answer_to_nothing_end_with_the_run_that_is_killed(tmp_path):
    words = ["run", "--plugin", str(PLUGIN), "--model", "HoldsTheInterpreter", "--output", "out"]
    with TemporaryDirectory() as temporary:  # short: names of sockets end at 107 characters
        env = {**os.environ, "TMPDIR": temporary}
        with started(*words, cwd=tmp_path, env=env) as command:
            wait_until(lambda: computing(command.pid))
            family = psutil.Process(command.pid).children(recursive=True)
            command.kill()
            command.wait()
            gone, alive = psutil.wait_procs(family, timeout=20)
        assert len(gone) >= 3 and not alive
        assert not list(Path(temporary).glob("bench-*"))


def computing(pid: int) -> bool:
    """Check whether a command's fit and the process that it started run."""
    family = psutil.Process(pid).children(recursive=True)
    with suppress(psutil.NoSuchProcess):  # a process may end meanwhile
        return any("sleep" in process.name() for process in family)
    return False


@pytest.mark.slow
def test_a_module_next_to_a_plugin_is_part_of_the_key(tmp_path):
    helper, plugin = tmp_path / "helper.py", tmp_path / "mine.py"
    begin = "import os, sys\nsys.path.insert(0, os.path.dirname(__file__))\nimport helper\n"
    plugin.write_text(PLUGIN.read_text().replace("import ctypes\n", f"{begin}import ctypes\n"))
    helper.write_text("factor = 1\n")
    words = ["run", "--plugin", str(plugin), "--model", "Good", "--output", "out"]
    assert "bench: 2 ok; " in bench(*words, cwd=tmp_path).stderr
    helper.write_text("factor = 22\n")
    assert "bench: 1 ok, 1 cached; " in bench(*words, cwd=tmp_path).stderr
