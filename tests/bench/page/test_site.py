"""The web pages of a leaderboard: all pages exist, links work, the numbers are the board's."""

from __future__ import annotations

import csv
import re
from pathlib import Path
from urllib.parse import unquote

import pytest

from stiff_bench.api.evaluation import reproduction
from stiff_bench.page.site import CITATIONS, INDEX, SCORES, file_stem
from stiff_protocols.contract.errors import ConfigError

pytestmark = [pytest.mark.slow, pytest.mark.xdist_group("site")]
MODELS = ("vjm", "vjm-full", "zero", "knn@neighbours=3")
DATASETS = ("ur5-twin", "kr10-twin@plan=wide", *(f"arm-family@robot={n}" for n in (1, 2, 3)))
STUDY = f"""
title = "A small board"
models = {list(MODELS)}
datasets = {[*DATASETS, "fanuc-r2000ic"]}
protocols = ["holdout-paths"]
splits = 1
tables = ["leaderboard"]
[board]
protocol = "holdout-paths"
extras = ["tabm"]
[groups]
"tilting, wide" = {list(DATASETS)}
"""
HOW = {"jobs": 1, "isolate": False, "timeout": None, "memory": None, "threads": 1, "dask": ""}
LINK = re.compile(r'<(?:a href|script src)="(?!https?:)([^"#]+)"')
RATIO = re.compile(r'</th><td[^>]*>[^<]*</td><td[^>]* data-order="([^"]*)"')


@pytest.fixture(scope="module")
def study(tmp_path_factory) -> Path:
    folder = tmp_path_factory.mktemp("study")
    (folder / "small.toml").write_text(STUDY)
    return folder


@pytest.fixture(scope="module")
def site(study) -> Path:
    study_run = reproduction(
        str(study / "small.toml"), output=study, command="bench reproduce", rerun="missing", **HOW
    )
    assert all(result.status == "ok" for result in study_run.compute().every)
    assert list(study_run.write())
    assert list(study_run.write_site(study / "site"))
    return study / "site"


def test_the_pages_name_their_folder_and_the_studys_page_does_not(site, study):
    assert f"bench reproduce --site {site}" in (site / INDEX).read_text("utf-8")
    assert "--site" not in (study / "small" / "README.md").read_text("utf-8")


def pages(site: Path) -> list[Path]:
    return sorted(site.rglob("*.html"))


def test_every_model_and_every_data_set_has_a_page(site):
    names = {page.stem for page in pages(site)}
    assert {file_stem(name) for name in (*MODELS, *DATASETS, "fanuc-r2000ic")} < names


def test_every_link_leads_to_a_file_of_the_site(site):
    for page in pages(site):
        for address in LINK.findall(page.read_text(encoding="utf-8")):
            assert (page.parent / unquote(address)).resolve().is_file(), (page, address)


def test_every_data_set_has_files_next_to_its_page(site):
    for name in DATASETS:
        files = {file.suffix for file in (site / "data" / "files" / file_stem(name)).iterdir()}
        assert {".csv", ".urdf", ".md", ".json"} <= files


def test_the_numbers_to_download_are_those_of_the_board(site):
    with (site / SCORES).open(encoding="utf-8", newline="") as file:
        rows = [row for row in csv.DictReader(file) if row["table"] == "board"]
    ratios = {row["model"]: row["value"] for row in rows if row["column"] == "error / VJM's"}
    assert set(ratios) == set(MODELS) and float(ratios["vjm"]) == pytest.approx(1.0)


def test_each_metric_has_the_models_in_the_order_of_its_ratios(site):
    text = (site / INDEX).read_text("utf-8")
    choices = re.findall(r'<div id="[^"]*choice-\d+">(.*?)</table>', text, re.S)
    assert len(choices) >= 3  # readings, 95th percentile, tool paths
    for choice in choices:
        ranks = re.findall(r'<td class="number" data-order="(\d+)">\d+</td><th', choice)
        ratios = re.findall(r"</th>.*?<td class=\"number\" data-order=\"([^\"]*)\"", choice)
        assert [*map(int, ranks)] == [*range(1, len(MODELS) + 1)]
        assert [*map(float, ratios)] == sorted(map(float, ratios))


def test_a_model_s_page_has_its_kind_its_paper_and_a_bibtex_entry(site):
    text = (site / "models" / "vjm-full.html").read_text("utf-8")
    assert "physics" in text and "@misc{vjm-full," in text
    assert "Code: models/stiff_models/physics/full_vjm.py" in text and "class FullVjm(" in text
    entries = (site / CITATIONS).read_text("utf-8")
    assert {"@misc{vjm,", "@misc{vjm-full,"} <= set(entries.splitlines())


def test_data_sets_have_the_names_that_people_use(site):
    text = (site / INDEX).read_text("utf-8")
    assert all(f">{name}</a>" in text for name in ("TX60, all, wide", "KR 10, clean, wide"))


def test_a_study_without_results_on_five_robots_has_no_pages(study, site):
    text = STUDY.replace(str([*DATASETS, "fanuc-r2000ic"]), str([*DATASETS[:2]]))
    (study / "two.toml").write_text(text)
    study_run = reproduction(
        str(study / "two.toml"), output=study, command="bench", rerun="missing", **HOW
    )
    study_run.compute()
    with pytest.raises(ConfigError, match="five robots"):
        list(study_run.write_site(study / "none"))


def test_a_data_set_has_the_models_in_the_order_of_their_ratios(site):
    text = (site / "data" / "ur5-twin.html").read_text("utf-8")
    table = text[text.index("Models on this data set") :].split("</table>")[0]
    ratios = [*map(float, RATIO.findall(table))]
    assert ratios == sorted(ratios) and len(ratios) == len(MODELS)
