"""The docs site: complete, built from the repository alone, and its commands are ours."""

from __future__ import annotations

import os
import re
import shlex
import shutil
import subprocess
import sys
from collections.abc import Iterator
from functools import partial
from http.server import SimpleHTTPRequestHandler, ThreadingHTTPServer
from importlib.util import find_spec
from pathlib import Path
from threading import Thread

import click
import pytest

from stiff_bench.cli.main import bench
from stiff_protocols.catalog import PROTOCOLS
from stiff_protocols.scoring.metrics import METRICS

pytestmark = pytest.mark.xdist_group("site")  # one process builds it

TOP = Path(__file__).parents[1]
DOCS = TOP / "docs"
DEFINITIONS = (DOCS / "definitions.md").read_text(encoding="utf-8")
BLOCK = re.compile(r"^```sh\n(.*?)^```", re.MULTILINE | re.DOTALL)
LOADED = re.compile(r"<(?:script|link|img|iframe)\b[^>]*\b(?:src|href)=\"?((?:https?:)?//[^\" >]+)")
PHONE_WIDTH = 390  # px
ALLOWED_S = 600.0


def _shell(page: Path) -> list[str]:
    """Return the lines of a page's `sh` blocks."""
    return "".join(BLOCK.findall(page.read_text(encoding="utf-8"))).splitlines()


def _bench_lines() -> Iterator[tuple[str, str]]:
    for page in (TOP / "README.md", *sorted(DOCS.rglob("*.md"))):
        for line in _shell(page):
            if line.startswith("bench "):
                yield str(page.relative_to(TOP)), line


def test_every_metric_and_protocol_is_defined():
    words = [f"**`{key}`**" for key in METRICS]
    words += [f"\n### `{info.key}`\n" for info in PROTOCOLS]
    assert [word for word in words if word not in DEFINITIONS] == []


def test_every_command_of_the_docs_has_its_options():
    lines = list(_bench_lines())
    assert len(lines) > 50  # that they are found at all
    wrong = [f"{page}: {line}" for page, line in lines if _unknown(line)]
    assert wrong == []


def _unknown(line: str) -> str:
    """Return the first word of a command line that bench does not know, "" where there is none."""
    words = shlex.split(line, comments=True)[1:]
    command: click.Command = bench
    while isinstance(command, click.Group) and words and not words[0].startswith("-"):
        name, *words = words
        if name not in command.commands:
            return name
        command = command.commands[name]
    options = {"-h", "--help"}.union(*((*one.opts, *one.secondary_opts) for one in command.params))
    given = [word.partition("=")[0] for word in words if word.startswith("-")]
    return next((option for option in given if option not in options), "")


@pytest.fixture(scope="session")
def site(tmp_path_factory) -> Path:
    for package in ("mkdocs", "material", "latex2mathml"):
        if find_spec(package) is None:
            pytest.skip(f"{package} is not installed: pip install 'stiffbench[docs]'")
    folder = tmp_path_factory.mktemp("site")
    command = [sys.executable, "-m", "mkdocs", "build", "--strict", "--site-dir", str(folder)]
    built = subprocess.run(command, cwd=TOP, capture_output=True, text=True, check=False)
    assert built.returncode == 0, built.stderr
    return folder


@pytest.mark.slow
def test_the_site_is_built_without_a_warning(site):
    pages = {page.relative_to(site).as_posix() for page in site.rglob("*.html")}
    ours = {page.relative_to(DOCS).with_suffix(".html").as_posix() for page in DOCS.rglob("*.md")}
    assert ours <= pages


@pytest.mark.slow
def test_no_page_loads_anything_from_elsewhere(site):
    pages = sorted(site.rglob("*.html"))
    assert [page for page in pages if LOADED.search(page.read_text("utf-8"))] == [] != pages


@pytest.mark.slow
def test_equations_are_in_the_pages(site):
    page = (site / "definitions.html").read_text("utf-8")
    text = re.sub(r"<(code|pre)\b.*?</\1>", "", page, flags=re.DOTALL)
    assert page.count("<math") == len(
        re.findall(r"\$\$.*?\$\$|\$[^$\n]+\$", DEFINITIONS, re.DOTALL)
    )
    assert "arithmatex" not in page
    assert re.findall(r"\\[a-zA-Z(\[]", text) == []


@pytest.fixture(scope="session")
def address(site) -> Iterator[str]:
    class Quiet(SimpleHTTPRequestHandler):
        def log_message(self, *_: object) -> None:
            pass

    with ThreadingHTTPServer(("127.0.0.1", 0), partial(Quiet, directory=str(site))) as server:
        Thread(target=server.serve_forever, daemon=True).start()
        yield f"http://127.0.0.1:{server.server_port}"
        server.shutdown()


@pytest.fixture()
def browser(tmp_path):
    webdriver = pytest.importorskip("selenium.webdriver", reason="selenium is not installed")
    chromium, driver = shutil.which("chromium"), shutil.which("chromedriver")
    if chromium is None or driver is None:
        pytest.skip("chromium and chromedriver are not installed")
    options = webdriver.ChromeOptions()
    options.binary_location = chromium
    for flag in ("headless=new", "no-sandbox", "disable-gpu", f"user-data-dir={tmp_path}"):
        options.add_argument(f"--{flag}")
    for flag in ("quic", "background-networking", "component-update", "sync"):
        options.add_argument(f"--disable-{flag}")
    found = webdriver.Chrome(options=options, service=webdriver.ChromeService(driver))
    yield found
    found.quit()


@pytest.mark.slow
def test_no_page_is_wider_than_a_phone(site, address, browser):
    size = {"width": PHONE_WIDTH, "height": 844, "deviceScaleFactor": 1, "mobile": True}
    browser.execute_cdp_cmd("Emulation.setDeviceMetricsOverride", size)
    widths = {}
    for page in sorted(site.rglob("*.html")):
        name = page.relative_to(site).as_posix()
        browser.get(f"{address}/{name}")
        widths[name] = browser.execute_script("return document.documentElement.scrollWidth")
    assert widths == dict.fromkeys(widths, PHONE_WIDTH)


@pytest.mark.slow
def test_a_browser_draws_the_equations_and_asks_nobody_but_the_site(address, browser):
    browser.get(f"{address}/definitions.html")
    drawn = "[...document.querySelectorAll('math')].map(one => one.getBoundingClientRect().height)"
    heights = browser.execute_script(f"return {drawn}")
    assert len(heights) > 20
    assert min(heights) > 3.0  # px
    asked = "performance.getEntriesByType('resource').map(one => one.name)"
    names = browser.execute_script(f"return {asked}")
    assert names  # its own style sheets and scripts
    assert [name for name in names if not name.startswith(address)] == []


@pytest.mark.slow
def test_the_tutorial_can_be_followed_to_the_end(tmp_path):
    for path in (DOCS / "assets").glob("*.*"):
        shutil.copy(path, tmp_path)
    script = "set -e\n" + "\n".join(_shell(DOCS / "tutorial.md"))
    path = os.pathsep.join([str(Path(sys.executable).parent), os.environ["PATH"]])
    done = subprocess.run(
        ["bash", "-c", script],
        cwd=tmp_path,
        env=os.environ | {"PATH": path, "STIFFBENCH_HOME": str(tmp_path / "home")},
        capture_output=True,
        text=True,
        timeout=ALLOWED_S,
        check=False,
    )
    assert done.returncode == 0, done.stderr
    assert "my.csv: valid" in done.stdout
    assert "vjm-multisegment is better than vjm on my.csv" in done.stdout
    assert len((tmp_path / "predicted.csv").read_text("utf-8").splitlines()) == 61
