"""The real command: what it prints, what it stores, how it refuses, and how it stops."""

from __future__ import annotations

import csv
import io
import json
import signal
import subprocess
import sys
import time
from importlib.resources import files

import pytest
import torch

from helpers.command_line import assert_refused, bench_here, started
from helpers.made_samples import CSV_HEADER, CSV_ROW
from stiff_bench.store.database import ResultStore, read_manifests, read_results, stored_statuses
from stiff_protocols.contract.errors import ConfigError
from stiff_protocols.scoring.metrics import METRICS

SMALL = ["--set=ft-mlp.width=16", "--set=ft-mlp.pretrain_steps=20", "--set=ft-mlp.epochs=5"]


def shipped(name: str) -> str:
    return str(files("stiff_datasets") / name)


FANUC = ["run", "--model", "vjm", "--data", shipped("data/fanuc_r2000ic.csv")]
FANUC += ["--urdf", shipped("robots/fanuc_r2000ic.urdf")]


def test_a_run_prints_one_table_and_stores_every_cell(tmp_path):
    words = ["--model", "vjm", "--model", "ft-mlp", "--splits", "2", *SMALL]
    done = bench_here("run", *words, cwd=tmp_path)
    assert done.returncode == 0, done.stderr
    for part in (
        "kr10-twin (simulated) | holdout, 2 splits, seed 0 | mm",
        "| vjm ",
        "| ft-mlp@epochs=5@pretrain_steps=20@width=16 ",
        "X MAE",
        "Z ME",
        "| FT-MLP [published] ",
        "made by",
    ):
        assert part in done.stdout
    assert "pre-train 0/20" in done.stderr and "bench: 4 ok; " in done.stderr
    store = ResultStore(tmp_path / "results" / "runs")
    (manifest,) = read_manifests(store.folder)
    assert manifest.status == "finished" and len(manifest.cells) == 4
    assert manifest.command.startswith("bench run --model vjm")
    assert manifest.environment["numpy"] and manifest.peak_memory_bytes > 0
    cells = [store.result(key) for key in manifest.cells]
    assert {cell.cell.model for cell in cells} == {"vjm", "ft-mlp"}
    assert all(cell.prediction is not None and cell.run_id == manifest.run_id for cell in cells)


def test_vjm_under_leave_one_out_gives_the_independent_figures_of_the_fanuc(tmp_path):
    words = ["--dataset", "fanuc-r2000ic", "--protocol", "leave-one-out", "--format", "json"]
    done = bench_here("run", "--model", "vjm", *words, cwd=tmp_path)
    (table,) = json.loads(done.stdout)["tables"]
    mae = [v["value"] for v in table["rows"][0]["values"] if v["metric"] == "mae"]
    assert mae == pytest.approx([0.211, 0.161, 0.130], abs=0.002)
    assert any("drill tip" in note for note in table["notes"])


def test_ones_own_file_and_robot_run_like_a_shipped_data_set(tmp_path):
    tool = ["--tcp", "0.0069,0.2453,0.3193"]
    own = bench_here(*FANUC, *tool, "--format", "csv", cwd=tmp_path)
    words = ["--dataset", "fanuc-r2000ic", "--format", "csv"]
    shipped_run = bench_here("run", "--model", "vjm", *words, cwd=tmp_path)
    assert own.returncode == 0, own.stderr
    values = [
        [row["value"] for row in csv.DictReader(io.StringIO(done.stdout))]
        for done in (own, shipped_run)
    ]
    assert len(values[0]) == 9 and values[0] == values[1]


def test_paper_holdout_warns_and_marks_its_rows(tmp_path):
    words = ["--model", "mlp@epochs=5@training=best", "--protocol", "paper-holdout"]
    done = bench_here("run", *words, cwd=tmp_path)
    assert "warning: paper-holdout" in done.stderr
    assert "| mlp@epochs=5@training=best [epoch picked on test part] |" in done.stdout


PLUGIN_HEAD = "from stiff_protocols.contract.plugin import DatasetInfo, ModelInfo, ProtocolInfo\n"


@pytest.mark.parametrize(
    ("body", "words", "parts"),
    [
        (
            "class A:\n    def __init__(self, *, needed): ...\n"
            "MODELS = ModelInfo(key='a', target=A, summary='s')\n",
            ["--model", "a"],
            ["'a' needs", "a@needed=..."],
        ),
        (
            "class A: ...\nMODELS = [ModelInfo(key='a', target=A, summary='s')]\n",
            ["--model", "a"],
            ["'a' has no fit and no predict method"],
        ),
        (
            "class D:\n    def load(self): return None\n"
            "DATASETS = [DatasetInfo(key='d', target=D, summary='s', kind='measured')]\n",
            ["--model", "vjm", "--dataset", "d"],
            ["'d': load returned NoneType, expected BenchmarkData"],
        ),
        (
            "class P: ...\nPROTOCOLS = [ProtocolInfo(key='p', target=P, summary='s')]\n",
            ["--model", "vjm", "--protocol", "p"],
            ["'p' has no splits method"],
        ),
    ],
)
def test_a_plugin_that_keeps_no_contract_is_refused_in_one_line(tmp_path, body, words, parts):
    path = tmp_path / "plug.py"
    path.write_text(PLUGIN_HEAD + body)
    assert_refused(bench_here("run", "--plugin", str(path), *words, cwd=tmp_path), *parts)


def test_another_metric_is_another_table_of_the_same_stored_cell(tmp_path):
    done = bench_here("run", "--model", "vjm", "--metric", "me", "--output", "out", cwd=tmp_path)
    assert "X ME" in done.stdout and "X MAE" not in done.stdout
    (stored,) = read_results(tmp_path / "out")
    of_cell = {metric.key for metric in METRICS.values() if metric.of_result(stored)}
    assert of_cell == {metric.key for metric in METRICS.values() if not metric.needs_interval}


def test_list_and_show_answer(tmp_path):
    for kind, part in (("models", "ft-mlp"), ("datasets", "simulated"), ("protocols", "leave-one")):
        assert part in bench_here("list", kind, cwd=tmp_path).stdout
    shown = bench_here("show", "ft-mlp", cwd=tmp_path).stdout
    assert "ft-mlp.freeze" in shown and "layers:1,2" in shown and "\nversion: " in shown
    assert "caveat" in bench_here("show", "fanuc-r2000ic", cwd=tmp_path).stdout


@pytest.mark.parametrize("kind", ["models", "datasets", "protocols", "metrics"])
def test_a_list_comes_in_every_format_with_the_same_rows(kind, tmp_path):
    def listed(*words):
        return bench_here("list", kind, *words, cwd=tmp_path).stdout

    keys = [row["key"] for row in csv.DictReader(listed("--format", "csv").splitlines())]
    (table,) = json.loads(listed("--format", "json"))["tables"]
    assert len(keys) == len(table["rows"]) == listed("--format", "html").count("<tr>") - 1
    plain = listed()
    assert listed("--format", "github") == plain
    assert [line.split()[0] for line in plain.splitlines() if line.split()[0] in keys] == keys


def test_help_loads_nothing_heavy(tmp_path):
    code = (
        "import sys, stiff_bench.cli.main as cli\n"
        "try: cli.main(['--help'])\n"
        "except SystemExit: pass\n"
        "heavy = ('torch', 'numpy', 'pinocchio', 'pandas', 'sklearn')\n"
        "print([name for name in heavy if name in sys.modules])"
    )
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert done.stdout.strip().endswith("[]")
    assert "run" in done.stdout and "list" in done.stdout


@pytest.mark.parametrize(
    ("words", "parts"),
    [
        (["run"], ["--model", "zero, mean"]),
        (
            ["run", "--model", "ft-mlp", "--set", "ft-mlp.freeze=layers:9"],
            ["layers:9", "'9' is no layer", "1..4"],
        ),
        (
            ["run", "--model", "vjm", "--protocol", "leave-one-out", "--splits", "3"],
            ["splits 3", "one split a pose"],
        ),
        (
            ["run", "--model", "vjm", "--set", "holdout.test_fraction=0.999"],
            ["151 poses", "test_fraction"],
        ),
        (["run", "--model", "vjm", "--data", "x.csv"], ["x.csv", "--urdf"]),
        (["run", "--model", "vjm", "--tcp", "0,0,0"], ["--data"]),
        (["run", "--model", "vjm", "--no-torque"], ["--no-torque", "give --data"]),
        ([*FANUC, "--tcp", "1,2"], ["--tcp", "'1,2'", "in m"]),
        ([*FANUC, "--tcp", "80,0,60"], ["tcp", "in m"]),
    ],
)
def test_bad_words_are_refused_in_one_line(tmp_path, words, parts):
    assert_refused(bench_here(*words, cwd=tmp_path), *parts)
    assert list(tmp_path.iterdir()) == []


FIT = ["fit", "--model", "vjm", "--output", "new", "--data", "good.csv", "--urdf"]


@pytest.mark.parametrize(
    ("words", "parts"),
    [
        ([*FIT, "folder"], ["folder: cannot read the URDF: Is a directory"]),
        ([*FIT, "bytes"], ["bytes: cannot read the URDF: no text in UTF-8"]),
        (
            ["predict", "--model", "bytes", "--input", "x", "--output", "y"],
            ["bytes: no model file"],
        ),
        (["leaderboard", "--results", "absent"], ["--results absent: there is no such folder"]),
        (["leaderboard", "--results", "bytes"], ["--results bytes: is a file, no folder of res"]),
        (["compare", "a", "b", "--results", "folder"], ["--results folder: holds no results"]),
        (["merge", "absent", "--output", "new"], ["absent: there is no such folder"]),
        (["run", "--model", "vjm", "--output", "bytes"], ["--output bytes", "it is a file"]),
        (
            ["run", "--model", "ft-mlp", "--output", "bytes/out"],
            ["--output bytes/out", "cannot be made"],
        ),
        (["run", "--model", "vjm", "--data", "vjm", "--robot", "ur5"], ["--data vjm", "rename"]),
        (["data", "info", "bytes"], ["bytes: no file of samples (valid: an ending .csv"]),
        (["data", "info", "bytes.xlsx", "--robot", "ur5"], ["bytes.xlsx: not an Excel table"]),
        (["show", "vjm@congruence=true"], ["'vjm@congruence=true'", "give 'vjm' alone"]),
        (
            ["run", "--model", "vjm", *(2 * ["--data", "good.csv"]), "--robot", "ur5"],
            ["--data good.csv: something else in this run is called 'good.csv'"],
        ),
        (["run", "--model", "vjm", *("--data", "no.csv"), "--robot", "ur5"], ["no.csv: cannot be"]),
    ],
)
def test_a_wrong_file_or_folder_is_refused_in_one_line_and_nothing_is_written(
    tmp_path, words, parts
):
    (tmp_path / "folder").mkdir()
    (tmp_path / "good.csv").write_text(f"{CSV_HEADER}\n{CSV_ROW}\n")
    for name in ("bytes", "bytes.xlsx"):
        (tmp_path / name).write_bytes(b"\xff\x00\x80")
    there = sorted(tmp_path.rglob("*"))
    assert_refused(bench_here(*words, cwd=tmp_path), *parts)
    assert sorted(tmp_path.rglob("*")) == there


@pytest.mark.skipif(torch.cuda.is_available(), reason="this machine has a GPU")
def test_a_gpu_that_is_not_there_is_refused(tmp_path):
    done = bench_here("run", "--model", "mlp", "--device", "cuda", cwd=tmp_path)
    assert_refused(done, "'cuda'", "no CUDA device", "cpu")


def test_debug_shows_the_traceback(tmp_path):
    with pytest.raises(ConfigError, match="nothing"):
        bench_here("run", "--model", "nothing", "--debug", cwd=tmp_path)


@pytest.mark.slow
@pytest.mark.parametrize(("number", "status"), [(signal.SIGINT, 130), (signal.SIGTERM, 143)])
def test_a_run_that_is_stopped_keeps_what_was_finished_and_blames_no_cell(tmp_path, number, status):
    words = ["run", "--model", "vjm", "--model", "mlp", "--set", "mlp.epochs=1000000"]
    with started(*words, "--output", "out", cwd=tmp_path) as process:
        deadline = time.monotonic() + 120
        while not stored_statuses(tmp_path / "out") and time.monotonic() < deadline:
            time.sleep(0.1)
        time.sleep(1.0)  # into the training of the second cell
        process.send_signal(number)
        stdout, stderr = process.communicate(timeout=60)
    assert process.returncode == status
    assert stdout == ""
    assert stderr.strip().splitlines()[-1].startswith("bench: interrupted; ")
    assert "Traceback" not in stderr
    store = ResultStore(tmp_path / "out")
    (manifest,) = read_manifests(store.folder)
    assert manifest.status == "interrupted"
    assert [*stored_statuses(tmp_path / "out")] == [manifest.cells[0]]
    assert store.result(manifest.cells[0]).status == "ok"
