"""The page in a real browser: the answer first, on screen, phone and paper; it loads nothing."""

from __future__ import annotations

import base64
import io
import re
from collections import Counter
from pathlib import Path

import pytest

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
from helpers.made_results import TWINS, MadeResults, made_data
from stiff_bench.figures.figure_catalog import FIGURES
from stiff_bench.report import report_content
from stiff_bench.report.report_content import PageOptions, write_report

pytestmark = BROWSER_MARKS
HACKS = (
    "<img src=x onerror=\"document.title='hacked'\">",
    "</script><script>document.title='hacked'</script>",
    "&lt;img src=x onerror=document.title='hacked'&gt;",
)
CHANGE = "vs VJM [%]"
N_MORE = 30  # models, so that a table has a second page


@pytest.fixture(scope="module")
def page(tmp_path_factory) -> Path:
    folder = tmp_path_factory.mktemp("page")
    made = MadeResults(folder / "runs")
    keys = []
    for twin in TWINS[:3]:
        for number in range(N_MORE):
            keys += made.add(f"model-{number}", [0.1 + 0.01 * number, 0.1 + 0.02 * number], twin)
        for model in ("vjm", *HACKS):
            keys += made.add(model, [0.2, 0.3], twin)
    keys += made.add("broken", [0.2], TWINS[0], failed=(1,))
    made.add_run("run-1", keys)
    output = folder / "report.html"
    write_report([made.folder], PageOptions(), output, f"bench report {HACKS[1]}")
    return output


@pytest.fixture(scope="module")
def usual_page(tmp_path_factory) -> Path:
    """Write a page of five models, four data sets, two protocols and two figures."""
    folder = tmp_path_factory.mktemp("usual")
    made = MadeResults(folder / "runs")
    keys = []
    for number, dataset in enumerate(("robot-a", "robot-b", "robot-c", "robot-d")):
        data = made_data(number)
        for plan in (
            {"protocol": "holdout"},
            *({"protocol": "loads", "condition": text} for text in ("heavier", "other directions")),
        ):
            for place, model in enumerate(("vjm", "vjm-gp", "vjm-full", "gp", "knn")):
                errors = [0.2 + 0.07 * place + 0.01 * number, 0.21 + 0.1 * place]
                keys += made.add(model, errors, dataset, data=data, caveats=("a note",), **plan)
    made.add_run("run-1", keys)
    output = folder / "report.html"
    with pytest.MonkeyPatch.context() as patch:
        drawn = {name: FIGURES[name] for name in ("scores", "errors")}
        patch.setattr(report_content, "FIGURES", drawn)
        write_report([made.folder], PageOptions(), output, "bench report")
    return output


@pytest.fixture()
def usual(browser, usual_page):
    """Open the usual page on a desktop."""
    set_width(browser, *DESKTOP)
    open_again(browser, usual_page)
    return browser


@pytest.fixture(scope="module")
def browser(page, tmp_path_factory):
    for opened in opened_browser(tmp_path_factory.mktemp("profile")):
        opened.get(page.as_uri())
        yield opened


@pytest.fixture()
def errors(browser, page):
    """Return the first table of the leaderboard, unfolded and unsorted."""
    set_width(browser, *DESKTOP)
    open_again(browser, page)
    unfold(browser)
    return browser.find_element("css selector", "details.block table.widget")


def test_a_heading_sorts_its_column_by_numbers_and_shows_the_direction(browser, errors):
    title = heading(errors, CHANGE)
    title.click()
    wait_until_sorted(browser, title, "ascending")
    rising = column(browser, errors, CHANGE)
    assert list(map(float, rising)) == sorted(map(float, rising))
    title.click()
    wait_until_sorted(browser, title, "descending")
    falling = column(browser, errors, CHANGE)
    numbers = [float(text) for text in falling if text != "-"]
    assert numbers == sorted(numbers, reverse=True)
    assert numbers[0] > 100.0 > float(rising[-1])  # all rows are sorted, not only those of a page


def test_missing_numbers_are_last_in_both_directions(browser, errors):
    field = errors.find_element("css selector", "tr.filters input")
    field.send_keys("o")  # "model-.." and "broken"
    title = heading(errors, CHANGE)
    for direction in ("ascending", "descending"):
        title.click()
        wait_until_sorted(browser, title, direction)
        browser.execute_script("new DataTable.Api(arguments[0]).page.len(-1).draw()", errors)
        assert column(browser, errors, CHANGE).index("-") >= N_MORE


@pytest.mark.parametrize(("title", "typed", "n_most"), [("model", "VJM", 1), (CHANGE, "< 4.6", 15)])
def test_the_field_under_a_heading_filters_rows_by_text_or_bounds(
    browser, errors, title, typed, n_most
):
    fields = errors.find_elements("css selector", "tr.filters input")
    (field,) = (f for f in fields if f.get_attribute("aria-label") == f"Filter {title}")
    field.send_keys(typed)
    texts = column(browser, errors, title)
    assert 0 < len(texts) <= n_most
    assert texts == ["vjm"] if title == "model" else max(map(float, texts)) < 4.6


@SIZES
def test_nothing_is_wider_than_the_screen_and_every_picture_is_shown(browser, errors, size):
    """Wide tables scroll in their box on a desktop."""
    set_width(browser, *size)
    assert browser.execute_script("return document.documentElement.scrollWidth") <= size[0]
    assert browser.execute_script(WIDER, size[0]) == []
    widths = browser.execute_script(
        "return [...document.images].map((image) => image.naturalWidth)"
    )
    assert len(widths) > 2 and all(widths)


def bottoms(browser, selector):
    script = """
        return [...document.querySelectorAll(arguments[0])]
            .map((one) => one.getBoundingClientRect()).filter((box) => box.height > 0)
            .map((box) => box.bottom);
    """
    return browser.execute_script(script, selector)


def test_the_answer_the_models_and_the_matrix_are_on_the_first_screen(usual):
    (card,) = bottoms(usual, ".card")
    charts = bottoms(usual, ".models td.chart svg[role=img]")
    matrix = bottoms(usual, ".matrix tbody tr")
    assert len(charts) == 5 and len(matrix) >= 5
    assert card < charts[0] and charts[-1] < matrix[0]
    assert matrix[-1] <= DESKTOP[1]


def test_the_best_ten_of_many_models_are_shown_until_all_are_requested(browser, errors):
    browser.execute_script("document.querySelector('details.all').open = false")
    for table in (".models", ".matrix"):
        assert len(bottoms(browser, f"{table} tbody tr:not(.noise)")) == 10
    browser.find_element("css selector", "details.all summary").click()
    for table in (".models", ".matrix"):
        assert len(bottoms(browser, f"{table} tbody tr:not(.noise)")) > N_MORE


def test_tables_are_cards_on_a_phone_and_each_cell_names_its_column(usual):
    set_width(usual, *PHONE)
    labels = usual.execute_script(
        """return [...document.querySelectorAll(".matrix td[data-label]")]
               .map((cell) => getComputedStyle(cell, "::before").content)"""
    )
    assert {'"robot-a | holdout"', '"robot-d | loads | heavier"'} <= {*labels}
    assert bottoms(usual, ".matrix thead") == []
    left_edge, right_edge = usual.execute_script(
        """const box = document.querySelector(".models td.chart svg").getBoundingClientRect();
           return [box.left, box.right]"""
    )
    assert 0 <= left_edge < left_edge + PHONE[0] / 2 < right_edge <= PHONE[0]
    assert len(bottoms(usual, ".models td.chart .labels")) == 5  # each card has an axis


def test_a_choice_shows_the_figures_of_one_data_set_and_protocol(usual):
    from selenium.webdriver.support.select import Select

    def n_shown():
        return len(bottoms(usual, "figure.one-case"))

    selects = usual.find_elements("css selector", ".choices select")
    dataset, protocol = map(Select, selects)
    assert n_shown() == 1
    dataset.select_by_visible_text("robot-c")
    (figure,) = (
        figure for figure in usual.find_elements("css selector", "figure.one-case:not([hidden])")
    )
    assert figure.get_attribute("data-dataset") == "robot-c"
    protocol.select_by_visible_text("all")
    assert n_shown() == 3
    dataset.select_by_visible_text("all")
    assert n_shown() == 12


def test_a_link_opens_the_folded_block_that_it_leads_to(usual):
    (link,) = (
        link
        for link in usual.find_elements("css selector", ".chips a")
        if link.text == "Provenance"
    )
    link.click()
    opened = usual.find_elements("css selector", "details.block[open] h3")
    assert [heading.text for heading in opened] == ["Provenance"]


def test_the_print_has_few_pages_in_landscape_with_every_number_of_the_matrix(usual):
    from pypdf import PdfReader

    cells = usual.execute_script(
        """return [...document.querySelectorAll(".matrix tbody td")]
               .map((cell) => cell.textContent)"""
    )
    printed = usual.execute_cdp_cmd("Page.printToPDF", {"preferCSSPageSize": True})
    pages = PdfReader(io.BytesIO(base64.b64decode(printed["data"]))).pages
    assert len(pages) <= 6
    assert all(page.mediabox.width > page.mediabox.height for page in pages)
    numbers = Counter(re.findall(r"\d+\.\d+", "\n".join(page.extract_text() for page in pages)))
    matrix_numbers = Counter(filter(re.compile(r"\d").search, cells))
    assert matrix_numbers.total() >= 5 * 12
    assert not matrix_numbers - numbers


@pytest.mark.parametrize("scheme", ["light", "dark"])
@pytest.mark.parametrize("size", [PHONE, DESKTOP], ids=lambda size: f"{size[0]} px")
@pytest.mark.parametrize("name", ["page", "usual_page"])
def test_axe_finds_nothing(browser, request, name, size, scheme):
    set_width(browser, *size)
    browser.get(request.getfixturevalue(name).as_uri())
    assert axe_violations(browser, scheme) == []


def test_the_console_stays_silent_and_only_the_page_is_loaded(browser, errors, page):
    assert browser.get_log("browser") == []
    resource_names = browser.execute_script(
        "return performance.getEntriesByType('resource').map((entry) => entry.name)"
    )
    assert [name for name in resource_names if not name.startswith("data:")] == []
