"""The web pages of a leaderboard: all pages exist, links work, nothing is loaded."""

from __future__ import annotations

import csv
import re
from pathlib import Path
from urllib.parse import unquote

import pytest

from helpers.browser import (
    BROWSER_MARKS,
    DESKTOP,
    SIZES,
    WIDER,
    axe_violations,
    column,
    heading,
    open_again,
    opened_browser,
    set_width,
    unfold,
    wait_until_sorted,
)
from stiff_bench.api.evaluation import reproduction
from stiff_bench.api.leaderboard_site import INDEX, SCORES, file_stem
from stiff_protocols.contract.errors import ConfigError

pytestmark = BROWSER_MARKS
MODELS = ("vjm", "vjm-full", "vjm-multisegment", "knn", "zero", "gp-springs@springs=6")
DATASETS = ("ur5-twin", "kr10-twin@plan=wide", *(f"arm-family@robot={n}" for n in (1, 2, 3)))
WITHDRAWN = "Withdrawn: the claim of this board"
STUDY = f"""
title = "A small board"
models = {list(MODELS)}
datasets = {[*DATASETS, "fanuc-r2000ic"]}
protocols = ["holdout-paths"]
tables = ["leaderboard"]
[board]
protocol = "holdout-paths"
extras = ["tabm"]
withdrawn = "{WITHDRAWN}"
[groups]
"tilting, wide" = {list(DATASETS)}
"""
HOW = {"jobs": 1, "isolate": False, "timeout": None, "memory": None, "threads": 1, "dask": ""}
LINK = re.compile(r'<a href="([^"#]+)"')


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
    assert all(result.status == "ok" for result in study_run.compute().cells)
    assert list(study_run.write())
    assert list(study_run.write_site(study / "site"))
    return study / "site"


@pytest.fixture(scope="module")
def browser(site, tmp_path_factory):
    for opened in opened_browser(tmp_path_factory.mktemp("profile")):
        opened.get((site / INDEX).as_uri())
        yield opened


def test_the_pages_name_their_folder_and_the_studys_page_does_not(site, study):
    assert f"bench reproduce --site {site}" in (site / INDEX).read_text("utf-8")
    assert "--site" not in (study / "small" / "README.md").read_text("utf-8")


def test_the_reason_of_a_withdrawal_is_the_headline_of_the_board(site, study):
    assert f"<h3>{WITHDRAWN}</h3>" in (site / INDEX).read_text("utf-8")
    assert f"\n**{WITHDRAWN}**\n" in (study / "small" / "README.md").read_text("utf-8")


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


def test_a_study_without_results_on_five_robots_has_no_pages(study, site):
    text = STUDY.replace(str([*DATASETS, "fanuc-r2000ic"]), str([*DATASETS[:2]]))
    (study / "two.toml").write_text(text)
    study_run = reproduction(
        str(study / "two.toml"), output=study, command="bench", rerun="missing", **HOW
    )
    study_run.compute()
    with pytest.raises(ConfigError, match="five robots"):
        list(study_run.write_site(study / "none"))


@SIZES
def test_no_page_is_wider_than_the_screen(browser, site, size):
    set_width(browser, *size)
    for page in (site / INDEX, site / "models" / "vjm-full.html", site / "data" / "ur5-twin.html"):
        browser.get(page.as_uri())
        assert browser.execute_script("return document.documentElement.scrollWidth") <= size[0]
        assert browser.execute_script(WIDER, size[0]) == []


@pytest.mark.parametrize("scheme", ["light", "dark"])
@SIZES
def test_axe_finds_nothing(browser, site, size, scheme):
    set_width(browser, *size)
    for page in (site / INDEX, site / "models" / "vjm-full.html", site / "data" / "ur5-twin.html"):
        browser.get(page.as_uri())
        assert axe_violations(browser, scheme) == []


def test_the_board_is_sorted_by_the_keyboard(browser, site):
    from selenium.webdriver.common.keys import Keys

    set_width(browser, *DESKTOP)
    browser.get((site / INDEX).as_uri())
    unfold(browser)
    table = browser.find_element("css selector", "table.widget")
    title = heading(table, "error / VJM's")
    in_focus = title.find_element("css selector", "[tabindex='0']")
    in_focus.send_keys(Keys.ENTER)
    wait_until_sorted(browser, title, "ascending")
    numbers = [float(text) for text in column(browser, table, "error / VJM's")]
    assert numbers == sorted(numbers) and len(numbers) > 5


def test_a_filter_shows_one_kind_of_data(browser, site):
    set_width(browser, *DESKTOP)
    open_again(browser, site / INDEX)
    table = browser.find_element("css selector", "table.widget")
    fields = table.find_elements("css selector", "tr.filters input")
    (field,) = (f for f in fields if f.get_attribute("aria-label") == "Filter data")
    field.send_keys("measured")
    assert {text.split()[0] for text in column(browser, table, "data")} == {"measured"}


def test_only_the_page_is_loaded(browser, site):
    browser.get((site / INDEX).as_uri())
    resource_names = browser.execute_script(
        "return performance.getEntriesByType('resource').map((entry) => entry.name)"
    )
    assert [name for name in resource_names if not name.startswith("data:")] == []
    assert browser.get_log("browser") == []
