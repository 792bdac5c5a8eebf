"""The page in a real browser: it sorts, filters, fits a phone, asks for nothing, runs nothing."""

from __future__ import annotations

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
PHONE, DESKTOP = (390, 844), (1440, 900)


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
def ranks(browser):
    """The leaderboard's table, as it is before anybody touches it."""
    set_width(browser, *DESKTOP)
    browser.refresh()
    return browser.find_element("css selector", "table.widget")


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


@pytest.mark.parametrize("size", [PHONE, DESKTOP], ids=["phone", "desktop"])
def test_the_page_is_no_wider_than_the_screen_and_shows_every_picture(browser, ranks, size):
    set_width(browser, *size)
    browser.refresh()
    wide = browser.execute_script("return document.documentElement.scrollWidth")
    assert wide <= size[0]
    widths = browser.execute_script(
        "return [...document.images].map((image) => image.naturalWidth)"
    )
    assert len(widths) > 2 and all(widths)


def test_the_console_stays_silent_and_the_page_alone_is_loaded(browser, ranks, page):
    assert browser.get_log("browser") == []
    asked = browser.execute_script(
        "return performance.getEntriesByType('resource').map((one) => one.name)"
    )
    assert [name for name in asked if not name.startswith("data:")] == []
