"""The critical-difference diagram: what it names, and when there is none."""

from __future__ import annotations

import re

import numpy as np
from click.testing import CliRunner

from helpers.made_results import TWINS, MadeResults
from stiff_bench.analysis.critical_difference import RankAnalysis, Specimen
from stiff_bench.cli.compare import leaderboard
from stiff_bench.figures.ranks import ranks_figure, save_diagrams
from stiff_protocols.scoring.ranks import compare_over_datasets

NAMES = tuple(f"model-{number}" for number in range(20))


def analysis_of(scores: np.ndarray, **changes) -> RankAnalysis:
    n_datasets, n_models = scores.shape
    fields = {
        "protocol": "kfold",
        "condition": "n = 5",
        "families": {Specimen("kr10", str(number)): ("twin",) for number in range(n_datasets)},
        "models": NAMES[:n_models],
        "outcome": compare_over_datasets(scores),
        "why_none": "",
    }
    return RankAnalysis(**(fields | changes))


def texts(path) -> str:
    return " ".join(re.findall(r"<text[^>]*>(.*?)</text>", path.read_text(), re.DOTALL))


def test_the_diagram_names_metric_protocol_data_sets_and_every_model(tmp_path, rng):
    path = tmp_path / "cd.svg"
    scores = np.arange(20) + rng.normal(size=(6, 20))
    save_diagrams([analysis_of(scores)], "3-D error [mm] (simulated)", path)
    words = texts(path)
    assert "kfold | n = 5" in words and "3-D error [mm] (simulated)" in words
    assert "6 specimens of twin" in words
    for name in NAMES:
        assert re.search(rf"\b{name}\b", words)
    assert "critical difference 12.1" in words  # 3.544 sqrt(20 * 21 / 36)


def test_a_bar_goes_through_its_models_in_order_so_that_the_file_is_always_the_same(rng):
    (axes,) = ranks_figure([analysis_of(rng.normal(size=(6, 20)))]).axes
    lines = [line.get_xydata().T for line in axes.get_lines()]
    bars = [x for x, y in lines if len(x) > 2 and np.ptp(y) == 0.0]
    assert bars and all((np.diff(bar) >= 0.0).all() for bar in bars)


def test_one_bar_stands_over_all_where_friedman_finds_nothing(tmp_path):
    """The third data set's ranks undo the first's, so nobody is better."""
    scores = np.array([np.roll([1.0, 2.0, 3.0, 4.0, 5.0], shift) for shift in range(5)])
    analysis = analysis_of(scores)
    assert not analysis.differs
    save_diagrams([analysis], "3-D error [mm] (simulated)", tmp_path / "cd.svg")
    assert texts(tmp_path / "cd.svg").count("(3.00)") == 5


def drawn(folder, twins):
    """What `bench leaderboard --figure` does with three models on some twins, and the figure."""
    made = MadeResults(folder / "runs")
    for dataset in twins:
        for model, error in (("a", 1.0), ("b", 2.0), ("c", 3.0)):
            made.add(model, [error], dataset)
    figure = folder / "cd.png"
    words = ["--results", str(made.folder), "--figure", str(figure)]
    return CliRunner().invoke(leaderboard, words, standalone_mode=False), figure


def test_without_an_analysis_the_command_prints_the_tables_and_says_why_there_is_no_figure(
    tmp_path,
):
    done, figure = drawn(tmp_path, TWINS[:2])
    assert done.output.startswith("**Leaderboard")
    (line,) = done.stderr.splitlines()
    assert f"{figure} was not drawn" in line
    assert "needs at least 5 data sets of different robots, here are 2" in line
    assert done.return_value == 1 and [*tmp_path.iterdir()] == [tmp_path / "runs"]


def test_the_command_draws_the_figure_beside_the_tables(tmp_path):
    done, figure = drawn(tmp_path, TWINS)
    assert done.exit_code == 0 and done.output.startswith("**Leaderboard")
    assert figure.read_bytes().startswith(b"\x89PNG")
