"""The page in a real browser: the answer first, at three widths, on paper, for screen readers."""

from __future__ import annotations

import base64
import io
import shutil
from importlib.util import find_spec
from pathlib import Path

import pytest

from helpers.made_results import TWINS, MadeResults
from stiff_bench.report.report_content import PageOptions, write_report

BROWSERS = ("chromium", "chromium-browser", "google-chrome")
PROGRAM, DRIVER = next(filter(None, map(shutil.which, BROWSERS)), ""), shutil.which("chromedriver")
pytestmark = [
    pytest.mark.slow,
    pytest.mark.xdist_group("browser"),  # a browser takes seconds to start
    pytest.mark.skipif(
        not (PROGRAM and DRIVER and find_spec("selenium")),
        reason=f"needs selenium, chromedriver and one of {', '.join(BROWSERS)}",
    ),
]
FLAGS = (
    *("--headless=new", "--no-sandbox", "--disable-gpu", "--disable-quic", "--no-first-run"),
    *("--disable-background-networking", "--disable-component-update", "--disable-sync"),
)
HACKS = (
    "<img src=x onerror=\"document.title='hacked'\">",
    "</script><script>document.title='hacked'</script>",
    "&lt;img src=x onerror=document.title='hacked'&gt;",
)
N_MORE = 30  # models, so that a table has a second page
PHONE, TABLET, DESKTOP = (390, 844), (768, 1024), (1400, 900)
N_SETS, SMALL_MODELS = 4, ("vjm", "vjm-full", "vjm-gp", "gp", "knn")


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
def small(tmp_path_factory) -> Path:
    """The page of 5 models on 4 data sets under 2 protocols, one of them with two conditions."""
    folder = tmp_path_factory.mktemp("small")
    made = MadeResults(folder / "runs")
    for number in range(N_SETS):
        kind = {"kind": "measured" if number == 0 else "simulated", "caveats": ("made up",)}
        for condition in ("", "heavier", "other way"):
            protocol = "load-extrapolation" if condition else "holdout"
            for place, model in enumerate(SMALL_MODELS):
                errors = [0.111 * (1 + place) + 0.013 * number + 0.001 * n for n in range(3)]
                made.add(model, errors, f"set-{number}", protocol, condition=condition, **kind)
    output = folder / "report.html"
    write_report([made.folder], PageOptions(), output, "bench report")
    return output


@pytest.fixture(scope="module")
def browser(page, tmp_path_factory):
    from selenium import webdriver

    options = webdriver.ChromeOptions()
    options.binary_location = PROGRAM
    for flag in (*FLAGS, f"--user-data-dir={tmp_path_factory.mktemp('profile')}"):
        options.add_argument(flag)
    options.set_capability("goog:loggingPrefs", {"browser": "ALL", "performance": "ALL"})
    service = webdriver.ChromeService(executable_path=DRIVER)
    opened = webdriver.Chrome(options=options, service=service)
    opened.get(page.as_uri())
    yield opened
    opened.quit()


@pytest.fixture()
def ranks(browser, page):
    """The leaderboard's table, unfolded, as it is before anybody touches it."""
    set_width(browser, *DESKTOP)
    browser.get(page.as_uri())
    (summary,) = (
        one
        for one in browser.find_elements("css selector", "details.block > summary")
        if one.text == "Leaderboard"
    )
    summary.click()
    return summary.find_element("xpath", "..").find_element("css selector", "table.widget")


def set_width(browser, width, height):
    metrics = {"width": width, "height": height, "deviceScaleFactor": 1, "mobile": width < 500}
    browser.execute_cdp_cmd("Emulation.setDeviceMetricsOverride", metrics)


def heading(table, title):
    (found,) = (
        cell for cell in table.find_elements("css selector", "thead th") if cell.text == title
    )
    return found


def wait_until_sorted(browser, title, direction):
    """The widget sorts a moment after a click."""
    from selenium.webdriver.support.wait import WebDriverWait

    said = f"the heading does not come to say that its column is {direction}"
    wait = WebDriverWait(browser, 20)
    wait.until(lambda _: title.get_attribute("aria-sort") == direction, said)


def column(browser, table, title):
    script = """
        const [table, title] = arguments;
        const at = [...table.tHead.rows[0].cells].findIndex((cell) => cell.innerText === title);
        return [...table.tBodies[0].rows].map((row) => row.cells[at].innerText);
    """
    return browser.execute_script(script, table, title)


def test_a_heading_sorts_its_column_by_numbers_and_says_so(browser, ranks):
    title = heading(ranks, "mean rank")
    title.click()
    wait_until_sorted(browser, title, "ascending")
    rising = column(browser, ranks, "mean rank")
    assert list(map(float, rising)) == sorted(map(float, rising))
    title.click()
    wait_until_sorted(browser, title, "descending")
    falling = column(browser, ranks, "mean rank")
    numbers = [float(text) for text in falling if text != "-"]
    assert numbers == sorted(numbers, reverse=True)
    assert numbers[0] > 30.0 > float(rising[-1])  # all rows took part, not those of a page


def test_missing_numbers_stand_last_both_ways(browser, ranks):
    field = ranks.find_element("css selector", "tr.filters input")
    field.send_keys("o")  # "model-.." and "broken"
    title = heading(ranks, "mean rank")
    for direction in ("ascending", "descending"):
        title.click()
        wait_until_sorted(browser, title, direction)
        browser.execute_script("new DataTable.Api(arguments[0]).page.len(-1).draw()", ranks)
        assert column(browser, ranks, "mean rank").index("-") >= N_MORE


@pytest.mark.parametrize(
    ("title", "typed", "n_most"), [("model", "VJM", 1), ("mean rank", "< 4.6", 9)]
)
def test_the_field_under_a_heading_filters_rows_by_text_or_bounds(
    browser, ranks, title, typed, n_most
):
    fields = ranks.find_elements("css selector", "tr.filters input")
    (field,) = (f for f in fields if f.get_attribute("aria-label") == f"Filter {title}")
    field.send_keys(typed)
    shown = column(browser, ranks, title)
    assert 0 < len(shown) <= n_most
    assert shown == ["vjm"] if title == "model" else max(map(float, shown)) < 4.6


@pytest.mark.parametrize("size", [PHONE, TABLET, DESKTOP], ids=["phone", "tablet", "desktop"])
@pytest.mark.parametrize("name", ["page", "small"])
def test_the_page_is_no_wider_than_the_screen_and_shows_every_picture(browser, request, name, size):
    set_width(browser, *size)
    browser.get(request.getfixturevalue(name).as_uri())
    wide = browser.execute_script("return document.documentElement.scrollWidth")
    assert wide <= size[0]
    widths = browser.execute_script(
        "return [...document.images].map((image) => image.naturalWidth)"
    )
    assert len(widths) > 2 and all(widths)


def boxes(browser, selector):
    """Return top and bottom of elements on the screen, px, and their widths."""
    script = """
        return [...document.querySelectorAll(arguments[0])].map((one) => {
            const box = one.getBoundingClientRect();
            return [box.top, box.bottom, box.width];
        });
    """
    return browser.execute_script(script, selector)


def test_the_first_screen_holds_the_answer_the_models_and_the_matrix(browser, small):
    set_width(browser, *DESKTOP)
    browser.get(small.as_uri())
    (card,) = boxes(browser, ".answer")
    models, matrix = boxes(browser, ".models tbody tr"), boxes(browser, ".matrix tbody tr")
    assert len(models) == len(matrix) == len(SMALL_MODELS)
    bottoms = [bottom for _, bottom, _ in (card, *models, *matrix)]
    assert bottoms == sorted(bottoms) and bottoms[-1] <= DESKTOP[1]
    charts = boxes(browser, ".models tbody .chart svg")
    assert len(charts) == len(SMALL_MODELS) and all(width > 150 for *_, width in charts)


def test_the_matrix_has_colours_by_the_ratio_and_a_bold_best(browser, small):
    browser.get(small.as_uri())
    script = """
        return [...document.querySelectorAll(".matrix tbody tr")].map((row) => ({
            name: row.cells[0].innerText,
            ground: getComputedStyle(row.cells[1]).backgroundColor,
            bold: row.cells[1].querySelector("strong") !== null,
        }));
    """
    rows = browser.execute_script(script)
    assert [row["name"] for row in rows] == list(SMALL_MODELS)
    assert [row["bold"] for row in rows] == [True, *[False] * 4]
    assert rows[0]["ground"] != rows[-1]["ground"]


def test_on_a_phone_rows_are_cards_that_name_their_columns(browser, small):
    set_width(browser, *PHONE)
    browser.get(small.as_uri())
    script = """
        const cell = document.querySelector(".matrix tbody td");
        return [getComputedStyle(document.querySelector(".matrix thead")).display,
                getComputedStyle(cell, "::before").content, cell.dataset.label];
    """
    head, before, label = browser.execute_script(script)
    assert head == "none" and label in before and label.startswith("set-0")


def test_a_menu_shows_the_figures_of_one_data_set_and_without_scripts_all_are_there(browser, small):
    from selenium.webdriver.support.select import Select

    set_width(browser, *DESKTOP)
    browser.get(small.as_uri())
    figures = browser.find_elements("css selector", ".by-data figure")
    datasets = {figure.get_attribute("data-dataset") for figure in figures}
    assert len(datasets) == N_SETS and " hidden" not in small.read_text().split("by-data")[1][:200]
    for name in sorted(datasets):
        menu = browser.find_element("css selector", ".chooser select")
        Select(menu).select_by_visible_text(name)
        shown = [one.get_attribute("data-dataset") for one in figures if one.is_displayed()]
        assert shown and set(shown) == {name}


def test_on_paper_every_number_of_the_matrix_is_text_on_at_most_six_pages(browser, small):
    from pypdf import PdfReader

    set_width(browser, *DESKTOP)
    browser.get(small.as_uri())
    numbers = browser.execute_script(
        'return [...document.querySelectorAll(".matrix tbody td")].map((one) => one.innerText)'
    )
    printed = browser.execute_cdp_cmd("Page.printToPDF", {"preferCSSPageSize": True})
    pages = PdfReader(io.BytesIO(base64.b64decode(printed["data"]))).pages
    words = " ".join(one.extract_text() for one in pages).split()
    assert len(pages) <= 6 and len(numbers) == 3 * N_SETS * len(SMALL_MODELS)
    box = pages[0].mediabox
    assert box.width > box.height  # landscape
    for number in set(numbers):
        assert words.count(number) >= numbers.count(number)


@pytest.mark.parametrize("size", [PHONE, DESKTOP], ids=["phone", "desktop"])
@pytest.mark.parametrize("name", ["page", "small"])
def test_axe_finds_nothing(browser, request, name, size):
    """Folded parts are opened, so that they are looked at too."""
    import axe_core_python

    script = Path(axe_core_python.__file__).with_name("axe.min.js").read_text(encoding="utf-8")
    set_width(browser, *size)
    browser.get(request.getfixturevalue(name).as_uri())
    browser.execute_cdp_cmd("Runtime.evaluate", {"expression": script})  # past the page's policy
    found = browser.execute_async_script(
        """
        const done = arguments[arguments.length - 1];
        for (const one of document.querySelectorAll("details")) one.open = true;
        axe.run(document).then((found) => done(found.violations.map(
            (one) => `${one.id}: ${one.nodes.map((node) => node.html.slice(0, 90)).slice(0, 3)}`
        )));
        """
    )
    assert found == []


def test_the_console_stays_silent_and_the_page_alone_is_loaded(browser, ranks, page):
    assert browser.get_log("browser") == []
    asked = browser.execute_script(
        "return performance.getEntriesByType('resource').map((one) => one.name)"
    )
    assert [name for name in asked if not name.startswith("data:")] == []
