import json

import pytest

from command_line import bench
from stiff_bench.perf_cli import HISTORY, PAGE, perf
from stiff_bench.perf_history import COLUMNS, History, read_history, worse_by, write_history
from stiff_bench.perf_report import Finding, read_report
from stiff_bench.perf_run import run_benchmarks
from stiff_bench.perf_tables import perf_page
from stiff_protocols.errors import ConfigError, StoreError

MACHINE = {"processor": "P", "commit": "c", "dirty": "false"}
BENCHMARKS = """
import pytest

@pytest.mark.benchmark(group="adding")
def test_ours(benchmark):
    benchmark.extra_info |= {
        "who": "stiffbench", "ours": True, "work": 10.0, "unit": "sum", "at_least": {"loop": 2.0},
        "figures": [
            {"what": "error", "value": 0.5, "unit": "mm", "at_most": 0.4, "at_least": None}
        ],
        "curve": {"picture": "growth", "x": [1, 2], "y": [1, 2], "x_label": "n", "y_label": "s",
                  "note": ""},
    }
    benchmark.pedantic(sum, ([1, 2],), rounds=2)

@pytest.mark.benchmark(group="adding")
def test_loop(benchmark):
    benchmark.extra_info |= {"who": "loop", "ours": False, "work": 1.0, "unit": "sum"}
    benchmark.pedantic(sum, ([1, 2],), rounds=2)

def test_other(benchmark):
    pytest.skip("peer Other: not installed")

def test_broken(benchmark):
    raise ValueError("nothing to add")
"""


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    folder = tmp_path_factory.mktemp("checkout") / "tests" / "perf"
    folder.mkdir(parents=True)
    (folder / "perf_adding.py").write_text(BENCHMARKS)
    return folder


@pytest.fixture(scope="module")
def run(folder):
    kept = folder.parent / "kept.json"
    return run_benchmarks("", long=False, json_file=kept, folder=folder), json.loads(
        kept.read_text()
    )


def test_a_ratio_compares_rates_of_work_and_not_times_of_calls(run):
    report, kept = run
    fastest = {b["extra_info"].get("who"): b["stats"]["min"] for b in kept["benchmarks"]}
    ratio = next(finding for finding in report.findings if finding.unit == "x")
    assert ratio.what == "stiffbench / loop"
    assert ratio.value == pytest.approx(10.0 * fastest["loop"] / fastest["stiffbench"])
    assert ratio.at_least == 2.0


def test_a_missing_peer_is_named_and_a_broken_benchmark_is_a_failure(run):
    report, _ = run
    assert report.skipped == {"test_other": "peer Other: not installed"}
    assert list(report.failed) == ["test_broken"]
    assert "nothing to add" in report.failed["test_broken"]


def test_the_page_says_which_targets_are_met_and_what_was_not_measured(run):
    report, _ = run
    page = perf_page(report, History(()), environment=MACHINE, pictures=[], command="bench perf")
    figure = next(line for line in page.splitlines() if "stiffbench: error" in line)
    assert [cell.strip() for cell in figure.split("|")[3:7]] == [
        "0.500 mm",
        "≤ 0.400 mm",
        "no",
        "-",
    ]
    assert "- `test_other`: peer Other: not installed" in page
    assert "- `test_broken`: ValueError: nothing to add" in page


def test_a_run_without_an_outcome_is_an_empty_report(tmp_path):
    report = read_report(tmp_path / "none.json", tmp_path / "none.xml")
    assert not report.timings and not report.findings


def test_history_expects_the_median_of_the_last_runs_on_the_same_processor(tmp_path):
    path = tmp_path / "history.csv"
    for day, value in enumerate((100.0, 1.0, 2.0, 3.0, 4.0, 5.0)):
        finding = Finding("path", "a / b", value, "x")
        write_history(path, read_history(path), [finding], date=f"day {day}", environment=MACHINE)
    history = read_history(path)
    assert history.expected(finding, "P") == 3.0
    assert history.expected(finding, "another") is None


@pytest.mark.parametrize(
    ("finding", "worse"),
    [
        (Finding("p", "a / b", 1.0, "x"), 1.0),
        (Finding("p", "a / b", 4.0, "x"), -0.5),
        (Finding("p", "error", 4.0, "mm", at_most=1.0), 1.0),
        (Finding("p", "processes", 1.0, "", at_least=1.9), 1.0),
    ],
)
def test_worse_means_a_smaller_ratio_or_a_larger_error(finding, worse):
    assert worse_by(finding, 2.0) == pytest.approx(worse)


def test_a_slowdown_is_called_out_on_the_page(run):
    report, _ = run
    ratio = next(finding for finding in report.findings if finding.unit == "x")
    row = dict.fromkeys(COLUMNS, "") | {
        "processor": "P",
        "path": ratio.path,
        "what": ratio.what,
        "value": str(2.0 * ratio.value),
    }
    page = perf_page(report, History((row,)), environment=MACHINE, pictures=[], command="")
    assert "(lower now)" in next(line for line in page.splitlines() if ratio.what in line)


@pytest.mark.parametrize(
    ("text", "named"),
    [
        ("a,b\n1,2\n", "columns a, b"),
        ("\n", "has the columns"),
        (f"{','.join(COLUMNS)}\n,,,,,,fast,\n", "line 2.*'fast'"),
    ],
)
def test_a_file_that_is_no_history_is_refused_and_kept(tmp_path, text, named):
    path = tmp_path / "history.csv"
    path.write_text(text)
    with pytest.raises(StoreError, match=named):
        read_history(path)


def test_benchmarks_need_a_checkout(tmp_path):
    with pytest.raises(ConfigError, match="checkout"):
        run_benchmarks("", long=False, json_file=None, folder=tmp_path / "tests" / "perf")


@pytest.mark.parametrize(
    ("only", "said"), [("nothing_like_it", "name matches"), ("ours and and", "cannot read")]
)
def test_an_expression_that_names_no_benchmark_is_an_error(only, said, folder):
    with pytest.raises(ConfigError, match=f"--only '{only}': .*{said}"):
        run_benchmarks(only, long=False, json_file=None, folder=folder)


def test_where_every_benchmark_is_skipped_the_report_says_why(folder):
    report = run_benchmarks("other", long=False, json_file=None, folder=folder)
    assert report.skipped == {"test_other": "peer Other: not installed"}
    assert not report.failed


def test_a_json_file_that_is_a_folder_is_refused_before_anything_is_measured(folder, tmp_path):
    with pytest.raises(StoreError, match=r"--json .*: is a folder"):
        run_benchmarks("", long=False, json_file=tmp_path, folder=folder)


@pytest.mark.slow
def test_a_part_of_the_benchmarks_joins_the_history_and_leaves_the_page(tmp_path):
    (tmp_path / "out").mkdir()
    (tmp_path / "out" / PAGE).write_text("of all")
    for _ in range(2):
        done = bench("perf", "--only", "matrix_product", "--output", "out", cwd=tmp_path)
        assert done.returncode == 0, done.stderr
    assert "machine: matrix product" in done.stdout
    assert (tmp_path / "out" / PAGE).read_text() == "of all"
    assert len({row["date"] for row in read_history(tmp_path / "out" / HISTORY).rows}) == 2


def test_the_whole_page_is_written_with_its_pictures(monkeypatch, run, tmp_path):
    report, _ = run
    monkeypatch.setattr("stiff_bench.perf_run.run_benchmarks", lambda *_, **__: report)
    assert perf.main(["--output", str(tmp_path)], standalone_mode=False) == 1  # one is broken
    assert "(performance_growth.png)" in (tmp_path / PAGE).read_text()
    assert (tmp_path / "performance_growth.png").exists()
