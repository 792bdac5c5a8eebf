"""The pages of studies: what is on them, and what is said where something is missing."""

from __future__ import annotations

import re
from dataclasses import replace

import pytest

from helpers.figure_results import ranked
from helpers.made_results import MadeResults
from stiff_bench.paper.pages import former_models, write_leaderboard, write_paper
from stiff_bench.paper.study import DT_CNN
from stiff_bench.store.database import read_results
from stiff_models.model_catalog import MODELS


@pytest.mark.slow
def test_the_papers_page_names_what_was_made_how_and_what_cannot_be_made_with_its_reason(tmp_path):
    """Of all models the VJM and DT-CNN alone were run."""
    made = MadeResults(tmp_path / "paper" / "runs")
    keys = []
    for protocol in ("paper-holdout", "holdout"):
        for model, error in (("vjm", 0.2), (DT_CNN.name, 0.3)):
            keys += made.add(model, [error], dataset="kr10-twin", protocol=protocol)
    made.add_run("run-1", keys)
    files = [*write_paper(tmp_path, "bench reproduce --quick", 39)]
    assert all(path.stat().st_size for path in files)
    assert files[-1] == tmp_path / "paper" / "README.md"
    assert {path.suffix for path in files} == {".md", ".csv", ".tex", ".png", ".pdf"}
    page = files[-1].read_text()
    shown = {tmp_path / "paper" / name for name in re.findall(r"!\[.*?\]\((.*?)\)", page)}
    assert shown == {path for path in files if path.suffix == ".png"} != set()
    assert "made by `bench reproduce --quick`" in page
    assert "not finished: 39 fits not computed" in page
    for number in (2, 3, 10):
        assert f"**Table {number}." in page
    assert re.search(r"^- Table 6: .*bench reproduce", page, re.MULTILINE)
    assert re.search(r"^- Figure 9: ", page, re.MULTILINE)


def test_models_whose_version_was_raised_since_are_named(tmp_path):
    made = MadeResults(tmp_path)
    for model in ("vjm", "ft-mlp", "mine"):
        made.add(model, [0.2])
    today = {info.key: info.version for info in MODELS}

    def of_versions(**versions):
        for result in read_results(tmp_path):
            key = result.cell.model
            number = versions.get(key.replace("-", "_"), today.get(key, 7))
            yield replace(result, cell=replace(result.cell, model_version=str(number)))

    assert former_models(of_versions()) == []
    assert former_models(of_versions(ft_mlp=1, mine=1)) == ["ft-mlp"]


@pytest.mark.slow
def test_a_leaderboard_comes_with_its_numbers_figures_and_what_was_shortened(tmp_path):
    ranked(tmp_path / "leaderboard" / "runs")
    files = [*write_leaderboard(tmp_path, "bench reproduce leaderboard", 39)]
    page = (tmp_path / "leaderboard.md").read_text()
    assert "| gp " in page and "`pretrain_steps=300`" in page
    assert ",column,value," in (tmp_path / "leaderboard.csv").read_text()
    for picture in re.findall(r"!\[.*?\]\((.*?)\)", page):
        assert tmp_path / picture in files
