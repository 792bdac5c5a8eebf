"""A headless Chromium for tests of pages."""

from __future__ import annotations

import shutil
from collections.abc import Iterator
from importlib.resources import files
from importlib.util import find_spec
from pathlib import Path

import pytest

BROWSERS = ("chromium", "chromium-browser", "google-chrome")
PROGRAM, DRIVER = next(filter(None, map(shutil.which, BROWSERS)), ""), shutil.which("chromedriver")
PACKAGES = ("selenium", "pypdf", "axe_core_python")
FLAGS = (
    *("--headless=new", "--no-sandbox", "--disable-gpu", "--disable-quic", "--no-first-run"),
    *("--disable-background-networking", "--disable-component-update", "--disable-sync"),
)
PHONE, TABLET, DESKTOP = (390, 844), (768, 1024), (1400, 900)
SIZES = pytest.mark.parametrize("size", [PHONE, TABLET, DESKTOP], ids=lambda size: f"{size[0]} px")
BROWSER_MARKS = [
    pytest.mark.slow,
    pytest.mark.xdist_group("browser"),  # a browser takes seconds to start
    pytest.mark.skipif(
        not (PROGRAM and DRIVER and all(map(find_spec, PACKAGES))),
        reason=f"needs {', '.join(PACKAGES)}, chromedriver and one of {', '.join(BROWSERS)}",
    ),
]


def opened_browser(profile: Path) -> Iterator[object]:
    """Yield a browser with a profile folder of its own, and close it."""
    from selenium import webdriver

    options = webdriver.ChromeOptions()
    options.binary_location = PROGRAM
    for flag in (*FLAGS, f"--user-data-dir={profile}"):
        options.add_argument(flag)
    options.set_capability("goog:loggingPrefs", {"browser": "ALL", "performance": "ALL"})
    service = webdriver.ChromeService(executable_path=DRIVER)
    opened = webdriver.Chrome(options=options, service=service)
    yield opened
    opened.quit()


def open_again(browser, page: Path) -> None:
    """Open a page from the start, even if it is open already with a fragment."""
    browser.get("about:blank")  # a refresh may come while the page is still loading
    browser.get(page.as_uri())


def unfold(browser):
    browser.execute_script(
        "for (const fold of document.querySelectorAll('details')) fold.open = true"
    )


def set_width(browser, width, height):
    metrics = {"width": width, "height": height, "deviceScaleFactor": 1, "mobile": width < 500}
    browser.execute_cdp_cmd("Emulation.setDeviceMetricsOverride", metrics)


def heading(table, title):
    (matching_cell,) = (
        cell for cell in table.find_elements("css selector", "thead th") if cell.text == title
    )
    return matching_cell


def wait_until_sorted(browser, title, direction):
    """Wait until the widget has sorted: a moment after a click."""
    from selenium.webdriver.support.wait import WebDriverWait

    message = f"the heading has no aria-sort of {direction}"
    wait = WebDriverWait(browser, 20)
    wait.until(lambda _: title.get_attribute("aria-sort") == direction, message)


def column(browser, table, title):
    script = """
        const [table, title] = arguments;
        const at = [...table.tHead.rows[0].cells].findIndex((cell) => cell.innerText === title);
        return [...table.tBodies[0].rows].map((row) => row.cells[at].innerText);
    """
    return browser.execute_script(script, table, title)


WIDER = """
    const inBox = (node) => node.parentElement.closest(".scroll") !== null;
    return [...document.body.querySelectorAll("*")]
        .filter((node) => node.getBoundingClientRect().right > arguments[0] + 1 && !inBox(node))
        .map((node) => node.outerHTML.slice(0, 200));
"""


def axe_violations(browser, scheme: str) -> list[tuple[str, str]]:
    """Return what axe finds on the open page in a colour scheme; folded parts are opened."""
    features = [{"name": "prefers-color-scheme", "value": scheme}]
    browser.execute_cdp_cmd("Emulation.setEmulatedMedia", {"features": features})
    unfold(browser)
    axe = files("axe_core_python").joinpath("axe.min.js").read_text(encoding="utf-8")
    browser.execute_cdp_cmd("Runtime.evaluate", {"expression": axe})  # the page's policy forbids it
    run = {"expression": "axe.run()", "awaitPromise": True, "returnByValue": True}
    result = browser.execute_cdp_cmd("Runtime.evaluate", run)["result"]["value"]
    browser.execute_cdp_cmd("Emulation.setEmulatedMedia", {"features": []})
    assert len(result["passes"]) > 10
    return [(rule["id"], rule["nodes"][0]["html"]) for rule in result["violations"]]
