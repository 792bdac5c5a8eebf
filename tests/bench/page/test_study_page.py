"""The page of a study: what is on it, and what is said where something is missing."""

from __future__ import annotations

import re
from dataclasses import replace

import pytest

from helpers.made_results import MadeResults
from stiff_bench.page.study_page import check_names, write_page
from stiff_bench.paper.study_file import find_study
from stiff_bench.results.notes import outdated_models
from stiff_bench.store.database import read_results
from stiff_models.model_catalog import MODELS
from stiff_protocols.contract.errors import ConfigError, StoreError


def pictures(page):
    """The files of the pictures that a page shows."""
    return {page.parent / name for name in re.findall(r"!\[.*?\]\((.*?)\)", page.read_text())}


@pytest.fixture
def study(tmp_path):
    """A small study of the leaderboard's notes, with a table and a figure that cannot be made."""
    return replace(
        find_study("leaderboard"), board=None, tables=("leaderboard",), figures=("scores", "losses")
    )


@pytest.mark.slow
def test_a_page_has_its_notes_tables_and_figures_and_says_what_was_not_computed(study, tmp_path):
    made = MadeResults(tmp_path / study.name / "runs")
    keys = [
        key
        for dataset in ("kr10-twin-omni", "ur5-twin")
        for model in ("vjm", "gp")
        for key in made.add(model, [0.1], dataset, protocol="holdout")
    ]
    made.add_run("run-1", keys)
    *files, page = write_page(study, tmp_path, "bench reproduce mine", 7)
    assert page == tmp_path / study.name / "README.md"
    assert {file.suffix for file in files} == {".md", ".csv", ".tex", ".png", ".pdf"}
    assert all(file.stat().st_size for file in files)
    text = page.read_text()
    assert pictures(page) == {page.parent / "figures/figure_scores.png"}
    for part in ("| gp ", study.notes[0], "made by `bench reproduce mine`"):
        assert part in text
    assert "not finished: 7 fits not computed" in text
    assert re.search(r"## Not made\n\n- Figure losses: .*training curve", text)


def test_title_and_notes_of_a_study_are_never_markup(study, tmp_path):
    hostile = "<script>alert(1)\\</script> # [a](b)"
    MadeResults(tmp_path / study.name / "runs").add("vjm", [0.1])
    study = replace(study, title=hostile, notes=(hostile,), tables=(), figures=())
    *_, page = write_page(study, tmp_path, "bench", 0)
    title, _, note, *_ = page.read_text().split("\n")
    escaped = r"\<script>alert(1)\\\</script> # [a]\(b)"
    assert (title, note) == (f"# {escaped}", f"- {escaped}")


def test_a_study_without_results_has_no_page(study, tmp_path):
    with pytest.raises(StoreError, match="bench reproduce"):
        [*write_page(study, tmp_path, "", 0)]
    assert not (tmp_path / study.name).exists()


@pytest.mark.parametrize(("part", "wrong"), [("tables", "leaderbord"), ("figures", "scors")])
def test_an_unknown_table_or_figure_is_refused_with_the_valid_names(part, wrong, study):
    with pytest.raises(ConfigError, match=f"'{wrong}'; did you mean"):
        check_names(replace(study, **{part: (wrong,)}))


def test_models_whose_version_was_raised_since_are_named(tmp_path):
    made = MadeResults(tmp_path)
    for model in ("vjm", "ft-mlp", "mine"):
        made.add(model, [0.2])
    today = {info.key: info.version for info in MODELS}

    def of_versions(**versions):
        for result in read_results(tmp_path):
            key = result.fit.model
            number = versions.get(key.replace("-", "_"), today.get(key, 7))
            yield replace(result, fit=replace(result.fit, model_version=str(number)))

    assert outdated_models(of_versions()) == []
    assert outdated_models(of_versions(ft_mlp=1, mine=1)) == ["ft-mlp"]
