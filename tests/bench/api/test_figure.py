"""`bench figure`: one file at the requested path, a caption, and refusals."""

from __future__ import annotations

from pathlib import Path

import pytest

from helpers.command_line import assert_refused, bench_here
from helpers.figure_results import compared
from helpers.made_results import MadeResults
from stiff_bench.paper.paper_figures import FIGURES
from stiff_bench.paper.paper_results import PaperResults
from stiff_protocols.contract.errors import StoreError

PAPER_RUNS = Path(__file__).parents[3] / "results" / "paper" / "runs"
PAPER = {"dataset": "kr10-twin", "protocol": "paper-holdout", "selects_on_test": True}


@pytest.fixture(scope="module")
def paper() -> PaperResults:
    return PaperResults.of(PAPER_RUNS)


@pytest.mark.slow
def test_a_figure_is_written_to_the_requested_path_and_its_caption_printed(tmp_path):
    compared(tmp_path / "runs")
    words = ["regression", "--results", "runs", "--output", "a.svg"]
    done = bench_here("figure", *words, cwd=tmp_path)
    assert done.returncode == 0, done.stderr
    assert "deflection dx [mm]" in (tmp_path / "a.svg").read_text()
    assert done.stdout.startswith("a.svg: Error over true deflection.")
    assert "seed 0" in done.stdout


def test_missing_models_of_the_paper_are_named(tmp_path):
    MadeResults(tmp_path).add("vjm", [0.1], **PAPER)
    for name, missing in (("5", "mlp-pretrained"), ("6", "ft-mlp"), ("8", "dt-cnn")):
        with pytest.raises(StoreError, match=f"{missing}.*bench reproduce"):
            FIGURES[name](PaperResults.of(tmp_path))


@pytest.mark.slow
def test_figure_5_has_the_papers_values_as_stars(paper):
    axes = FIGURES["5"](paper).draw().axes[0]
    lines = [line for line in axes.get_lines() if len(line.get_xdata())]
    stars = {tuple(p) for line in lines if line.get_marker() == "*" for p in line.get_xydata()}
    assert stars == {(100.0, 0.2186), (100.0, 0.2090), (100.0, 0.2375), (380.0, 0.1199)}


def test_figure_6_has_titled_panels_and_its_dashed_line_in_the_legend(paper):
    figure = FIGURES["6"](paper).draw()
    left_axes, right_axes = figure.axes
    assert all(len(axes.get_title(loc="left")) > len("(a) ") for axes in (left_axes, right_axes))
    (dashed,) = (line for line in right_axes.get_lines() if line.get_linestyle() == "--")
    (legend,) = figure.legends
    assert dashed.get_label() in {text.get_text() for text in legend.get_texts()}


def test_a_suffix_that_names_no_format_is_refused_before_results_are_read(tmp_path):
    for name in ("scores", "robot", "9"):
        done = bench_here("figure", name, "--results", "none", "--output", "a.txt", cwd=tmp_path)
        assert_refused(done, "extension .txt")
    assert not [*tmp_path.iterdir()]


@pytest.mark.slow
def test_the_robot_of_a_data_set_needs_no_results(tmp_path):
    words = ["figure", "robot", "--dataset", "kr10-twin"]
    done = bench_here(*words, "--row", "3", "--output", "a.svg", cwd=tmp_path)
    assert done.returncode == 0, done.stderr
    assert "kr10-twin (simulated), pose " in (tmp_path / "a.svg").read_text()
    assert_refused(bench_here(*words, "--dataset", "ur5-twin", cwd=tmp_path), "one --dataset")
