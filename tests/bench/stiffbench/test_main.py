"""The real command: its output, its stored results, and how it stops."""

from __future__ import annotations

import os
import subprocess
import sys

import pytest

from helpers.command_line import BENCH, bench_here
from helpers.made_results import MadeResults
from helpers.robot_programs import DOCS
from stiff_bench.store.database import ResultStore, read_manifests, read_results
from stiff_protocols.contract.errors import ConfigError
from stiffbench.options import command_line


def test_a_run_prints_one_table_and_stores_every_cell(tmp_path):
    words = ["--model", "vjm", "--model", "knn", "--splits", "2", "--metric", "me"]
    done = bench_here("run", *words, cwd=tmp_path)
    assert done.returncode == 0, done.stderr
    for part in ("kr10-twin (simulated)", "2 splits, seed 0", "| vjm ", "| knn ", "Z ME"):
        assert part in done.stdout
    assert "X MAE" not in done.stdout and "bench: 4 ok; " in done.stderr
    store = ResultStore(tmp_path / "results" / "runs")
    (manifest,) = read_manifests(store.folder)
    assert manifest.status == "finished" and len(manifest.cells) == 4
    assert manifest.command.startswith("bench run --model vjm")
    assert manifest.environment["numpy"] and manifest.peak_memory_bytes > 0
    fits = [store.result(key) for key in manifest.cells]
    assert {fit.fit.model for fit in fits} == {"vjm", "knn"}
    assert all(fit.prediction is not None and fit.run_id == manifest.run_id for fit in fits)


def test_the_reference_model_is_stored_once_with_the_requested_models(tmp_path):
    words = ["run", "--model", "zero", "--model", "vjm@tcp=fit", "--dataset", "fanuc-r2000ic"]
    done = bench_here(*words, "--splits", "1", "--output", "out", cwd=tmp_path)
    stored = sorted(result.presentation.model for result in read_results(tmp_path / "out"))
    assert stored == ["vjm", "vjm@tcp=fit", "zero"]
    assert done.stdout.count("| vjm ") == 2  # 3-D error, then MAE, STDE and ME


IMPORTS = (
    "import sys, stiffbench.main as cli\n"
    "try: cli.main(sys.argv[2:])\n"
    "except SystemExit: pass\n"
    "print([name for name in sys.argv[1].split() if name in sys.modules])"
)
"""Program that runs a command, and prints which of some modules it has loaded."""
STORED_RUN = ["run", "--model", "vjm", "--splits", "1"]


@pytest.mark.slow
@pytest.mark.parametrize(
    ("words", "heavy"),
    [
        (["--help"], "torch numpy pinocchio pandas sklearn"),
        (
            STORED_RUN,
            "torch sklearn scipy.stats matplotlib seaborn stiff_bench.paper stiff_bench.figures",
        ),
    ],
)
def test_a_command_loads_nothing_heavy_that_it_does_not_need(words, heavy, tmp_path):
    bench_here(*words, cwd=tmp_path)
    command = [sys.executable, "-c", IMPORTS, heavy, *words]
    done = subprocess.run(command, cwd=tmp_path, capture_output=True, text=True, check=True)
    assert done.stdout.strip().endswith("[]")


@pytest.mark.slow
def test_a_command_with_a_spring_models_file_loads_no_library_of_learners(vjm_file, tmp_path):
    joints = ",".join(f"q{i}_deg" for i in range(1, 7))
    text = f"{joints},fx_N,fy_N,fz_N,tx_Nm,ty_Nm,tz_Nm\n10,-60,70,0,40,0,50,10,-80,1,2,0\n"
    (tmp_path / "poses.csv").write_text(text)
    words = ["predict", "--model", str(vjm_file), "--input", "poses.csv", "--output", "out.csv"]
    heavy = "torch sklearn skops scipy.stats matplotlib seaborn"
    command = [sys.executable, "-c", IMPORTS, heavy, *words, "--coverage", "0.9"]
    done = subprocess.run(command, cwd=tmp_path, capture_output=True, text=True, check=True)
    assert (tmp_path / "out.csv").exists(), done.stderr
    assert done.stdout.strip().endswith("[]")


@pytest.mark.slow
def test_a_robot_program_is_corrected_without_a_library_of_tables(vjm_file, tmp_path):
    words = ["path", "compensate", "--model", str(vjm_file), "--load", "0,0,-50"]
    words += ["--program", str(DOCS / "pocket.src"), "--output", "out.src", "--allow-steps"]
    command = [sys.executable, "-c", IMPORTS, "torch sklearn pandas scipy.optimize", *words]
    done = subprocess.run(command, cwd=tmp_path, capture_output=True, text=True, check=True)
    assert (tmp_path / "out.src").exists(), done.stderr
    assert "left as they were" in done.stderr + done.stdout
    assert done.stdout.strip().endswith("[]")


@pytest.mark.slow
def test_a_board_is_printed_on_a_console_without_its_characters(tmp_path):
    made = MadeResults(tmp_path / "results")
    made.add_each({"vjm": [0.1, 0.2], "knn": [0.3, 0.4]}, "twin ≈")
    command = [BENCH, "leaderboard", "--results", "results", "--format", "github"]
    env = os.environ | {"PYTHONIOENCODING": "cp1252"}
    done = subprocess.run(command, cwd=tmp_path, capture_output=True, env=env, check=False)
    assert (done.returncode, done.stderr) == (0, b"")
    assert "twin ?" in done.stdout.decode("cp1252")


def test_debug_shows_the_traceback(tmp_path):
    with pytest.raises(ConfigError, match="nothing"):
        bench_here("run", "--model", "nothing", "--debug", cwd=tmp_path)


@pytest.mark.slow
def test_a_closed_pipe_is_not_a_failure(tmp_path):
    read, write = os.pipe()
    os.close(read)
    command = [BENCH, "list", "models"]
    done = subprocess.run(command, stdout=write, stderr=subprocess.PIPE, timeout=120, check=False)
    os.close(write)
    assert (done.returncode, done.stderr) == (0, b"")


def test_the_command_for_the_record_has_an_empty_word_but_no_folder_of_web_pages(monkeypatch):
    for words in (["--site", "a b"], ["--site=a b"]):
        monkeypatch.setattr("sys.argv", ["bench", "reproduce", "--plugin", "", *words, "paper"])
        assert command_line(without="--site") == "bench reproduce --plugin '' paper"
        assert "a b" in command_line()
