"""The report in a real browser: the answer first, on screen and phone; it loads nothing."""

from __future__ import annotations

from pathlib import Path

import pytest

import stiffbench as sb
from helpers.browser import (
    BROWSER_MARKS,
    DESKTOP,
    PHONE,
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
from helpers.made_results import TWINS, MadeResults
from stiff_bench.figures.figure_catalog import FIGURES
from stiff_bench.page import report
from stiff_bench.page.page import Page, Section, html_page
from stiff_bench.tables.table import Column, Table

pytestmark = BROWSER_MARKS
HACKS = (
    "<img src=x onerror=\"document.title='hacked'\">",
    "</script><script>document.title='hacked'</script>",
    "&lt;img src=x onerror=document.title='hacked'&gt;",
)
RATIO = "error / VJM's"
N_MORE = 15  # models, so that a table has a second page


@pytest.fixture(scope="module")
def page(tmp_path_factory) -> Path:
    folder = tmp_path_factory.mktemp("page")
    made = MadeResults(folder / "runs")
    keys = []
    for twin in (*TWINS[:2], "other"):
        for number in range(N_MORE):
            keys += made.add(f"model-{number}", [0.1 + 0.01 * number, 0.1 + 0.02 * number], twin)
        for model in ("vjm", *HACKS):
            keys += made.add(model, [0.2, 0.3], twin, caveats=("a note",))
    keys += made.add("broken", [0.2], TWINS[0], failed=(1,))
    made.add_run("run-1", keys)
    output = folder / "report.html"
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(report, "FIGURES", {name: FIGURES[name] for name in ("scores", "errors")})
        sb.report(output, sb.Results(made.folder, command=f"bench report {HACKS[1]}"))
    return output


@pytest.fixture(scope="module")
def opened(tmp_path_factory):
    yield from opened_browser(tmp_path_factory.mktemp("profile"))


@pytest.fixture()
def browser(opened, page):
    """Open the page on a desktop, with all tables sortable."""
    set_width(opened, *DESKTOP)
    open_again(opened, page)
    n_tables = len(shown_tables(opened))
    assert n_tables > 2
    wait_for_tables(opened, n_tables)
    return opened


def test_a_heading_sorts_its_column_by_numbers_and_shows_the_direction(browser):
    models = browser.find_element("css selector", "table.sorted")
    title = heading(models, RATIO)
    for direction, sign in (("ascending", 1), ("descending", -1)):
        title.click()
        wait_until_sorted(browser, title, direction)
        numbers = [float(text) for text in column(browser, models, RATIO) if text != "-"]
        assert numbers == sorted(numbers, key=lambda number: sign * number) and len(numbers) > 5


def test_a_search_shows_only_the_rows_with_the_text(browser):
    browser.find_element("css selector", ".dt-search input").send_keys("MODEL-13")
    models = browser.find_element("css selector", "table.sorted")
    assert column(browser, models, "model") == ["model-13"]


@SIZES
def test_nothing_is_wider_than_the_screen_and_every_picture_is_shown(browser, size):
    set_width(browser, *size)
    unfold(browser)
    assert browser.execute_script("return document.documentElement.scrollWidth") <= size[0]
    assert browser.execute_script(WIDER, size[0]) == []
    widths = browser.execute_script(
        "return [...document.images].map((image) => image.naturalWidth)"
    )
    assert len(widths) == 2 and all(widths)


def test_the_answer_and_the_best_models_with_their_charts_are_on_the_first_screen(browser):
    bottoms = browser.execute_script(
        """return [".card", "table.sorted tbody tr:last-child td svg"].map(
               (name) => document.querySelector(name).getBoundingClientRect().bottom)"""
    )
    assert 0 < bottoms[0] < bottoms[1] <= DESKTOP[1]


def test_a_link_opens_the_folded_section_that_it_leads_to(browser):
    (link,) = (a for a in browser.find_elements("css selector", "nav a") if a.text == "Provenance")
    link.click()
    opened = browser.find_elements("css selector", "details[open] h3")
    assert [title.text for title in opened] == ["Provenance"]


@pytest.mark.parametrize("scheme", ["light", "dark"])
@pytest.mark.parametrize("size", [PHONE, DESKTOP], ids=lambda size: f"{size[0]} px")
def test_axe_finds_nothing(browser, size, scheme):
    set_width(browser, *size)
    assert axe_violations(browser, scheme) == []


def test_the_console_stays_silent_and_only_the_page_is_loaded(browser):
    assert browser.get_log("browser") == [] and "hacked" not in browser.title
    resource_names = browser.execute_script(
        "return performance.getEntriesByType('resource').map((entry) => entry.name)"
    )
    assert [name for name in resource_names if not name.startswith("data:")] == []


@pytest.fixture(scope="module")
def choices(tmp_path_factory) -> Path:
    """Write a page with two tables, of which it shows one."""
    columns = [Column("rank"), Column("model", "text"), Column("error", format=".2f")]
    tables = [
        (name, Table(f"By {name}", columns, [[1, first, 0.1], [2, second, 0.2]]))
        for name, first, second in (("truth", "vjm", "mlp"), ("readings", "mlp", "vjm"))
    ]
    section = Section("Models", choices=tables)
    page = Page(
        "A board", [section], "bench", {"mlp": "https://example.org"}, words={"rank": "place"}
    )
    file = tmp_path_factory.mktemp("choices") / "index.html"
    file.write_text(html_page(page), encoding="utf-8")
    return file


def test_the_page_shows_the_table_of_the_chosen_metric_and_its_search_filters_it(opened, choices):
    set_width(opened, *DESKTOP)
    open_again(opened, choices)
    wait_for_tables(opened, 2)
    assert [table.is_displayed() for table in shown_tables(opened)] == [True, False]
    opened.find_elements("css selector", ".choice input")[1].click()
    _, readings = shown_tables(opened)
    assert [table.is_displayed() for table in shown_tables(opened)] == [False, True]
    assert column(opened, readings, "model") == ["mlp", "vjm"]
    opened.find_elements("css selector", "input[type=search]")[1].send_keys("vjm")
    assert column(opened, readings, "model") == ["vjm"]


@pytest.mark.parametrize("size", [PHONE, DESKTOP], ids=lambda size: f"{size[0]} px")
def test_axe_finds_nothing_on_a_page_with_a_choice(opened, choices, size):
    set_width(opened, *size)
    open_again(opened, choices)
    wait_for_tables(opened, 2)
    assert axe_violations(opened, "light") == []
    assert opened.find_element("css selector", "abbr").get_attribute("title") == "place"


def shown_tables(browser):
    return browser.find_elements("css selector", "table.sorted")


def wait_for_tables(browser, number: int) -> None:
    from selenium.webdriver.support.wait import WebDriverWait

    wait = WebDriverWait(browser, 20)
    wait.until(lambda b: len(b.find_elements("css selector", "table.dataTable")) == number)
