"""The page as HTML: one file, with its style, its scripts and its pictures inside."""

from __future__ import annotations

import base64
import hashlib
import subprocess
import sys
import tarfile
import tempfile
from collections.abc import Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Any

from stiff_bench.console import printable
from stiff_bench.report.content import Page, Picture
from stiff_bench.store.names import OPTION_MARK
from stiff_protocols.contract.errors import StoreError
from stiff_protocols.contract.files import written_whole

if TYPE_CHECKING:
    from markupsafe import Markup


LEAST_CONTRAST = 4.5
"""Of text and its ground: WCAG 2.2, success criterion 1.4.3, level AA."""

LIGHT: Mapping[str, str] = {
    "ink": "#1c2430",
    "quiet": "#4f5b6b",
    "ground": "#ffffff",
    "raised": "#f2f5f9",
    "line": "#c3ccd8",
    "link": "#0b57a4",
    "better": "#d9ecff",
    "worse": "#ffe6d5",
}
DARK: Mapping[str, str] = {
    "ink": "#e8edf4",
    "quiet": "#b4c0cf",
    "ground": "#14181f",
    "raised": "#1f2630",
    "line": "#46525f",
    "link": "#8cc4ff",
    "better": "#123a5e",
    "worse": "#5a3016",
}
TEXT_ON: tuple[tuple[str, str], ...] = (
    *(("ink", ground) for ground in ("ground", "raised", "better", "worse")),
    *(("quiet", ground) for ground in ("ground", "raised")),
    *(("link", ground) for ground in ("ground", "raised")),
)
"""Text colour and ground, wherever one stands on the other."""


def contrast(one: str, other: str) -> float:
    """Return the contrast ratio of two colours, 1..21, as WCAG 2 defines it.

    >>> contrast("#000000", "#ffffff")
    21.0
    """
    dark, light = sorted((_luminance(one), _luminance(other)))
    return (light + 0.05) / (dark + 0.05)


def variables() -> str:
    """Return the colours as CSS variables; the dark ones where the reader's system is dark."""
    dark = "@media screen and (prefers-color-scheme: dark) "
    return f":root {{ {_declared(LIGHT)} }}\n{dark}{{ :root {{ {_declared(DARK)} }} }}\n"


def _declared(colours: Mapping[str, str]) -> str:
    return " ".join(f"--{name}: {colour};" for name, colour in colours.items())


def _luminance(colour: str) -> float:
    channels = (int(colour[start : start + 2], 16) / 255.0 for start in (1, 3, 5))
    red, green, blue = (
        c / 12.92 if c <= 0.04045 else ((c + 0.055) / 1.055) ** 2.4 for c in channels
    )
    return 0.2126 * red + 0.7152 * green + 0.0722 * blue


PACKAGE, VERSION = "datatables.net", "3.1.5"
LICENCE = "MIT"
SHA256 = "38017a5586acd9c6eb6bbfe8b6938e1a25bdc717c5acfcb07e0c9d663282c59d"
FOLDER = Path(__file__).parent / "npm"
SCRIPT = FOLDER / "dataTables.min.js"
_FILES = {"package/js/dataTables.min.js": SCRIPT, "package/License.txt": FOLDER / "LICENSE.txt"}


def widget_code() -> str:
    """Return the widget's code.

    Raises:
        StoreError: the file is not the one that was taken from npm.
    """
    return checked_code(SCRIPT.read_bytes())


def checked_code(content: bytes) -> str:
    """Return a file's content as text, if it has the hash that was recorded.

    Raises:
        StoreError: it has another one.
    """
    found = hashlib.sha256(content).hexdigest()
    if found != SHA256:
        raise StoreError(
            f"{SCRIPT}: is not {PACKAGE} {VERSION}: its sha256 is {found}, expected {SHA256}; "
            "install stiffbench again"
        )
    return content.decode()


def refresh() -> None:
    """Fetch the pinned version with npm and write its files.

    Raises:
        StoreError: what came is not what was recorded.
    """
    with tempfile.TemporaryDirectory() as folder:
        subprocess.run(["npm", "pack", f"{PACKAGE}@{VERSION}"], cwd=folder, check=True)
        (archive,) = Path(folder).glob("*.tgz")
        with tarfile.open(archive) as packed:
            contents = {path: packed.extractfile(name) for name, path in _FILES.items()}
            read = {path: held.read() for path, held in contents.items() if held is not None}
    checked_code(read[SCRIPT])
    for path, content in read.items():
        with written_whole(path) as temporary:
            temporary.write_bytes(content)


if __name__ == "__main__":
    refresh()
    sys.stdout.write(f"{PACKAGE} {VERSION} is in {FOLDER}\n")


_HERE = Path(__file__).parent


def render_page(page: Page) -> str:
    """Return the page as HTML.

    All texts are escaped, and nothing but the two scripts and the style of this package can act in
    it: its content security policy names them by their hashes and allows no request.
    """
    from jinja2 import Environment, FileSystemLoader, StrictUndefined
    from markupsafe import Markup

    scripts = [widget_code(), (_HERE / "page.js").read_text(encoding="utf-8")]
    style = variables() + (_HERE / "page.css").read_text(encoding="utf-8")
    environment = Environment(
        loader=FileSystemLoader(_HERE),
        autoescape=True,
        undefined=StrictUndefined,
        finalize=_visible,
        trim_blocks=True,
        lstrip_blocks=True,
    )
    environment.filters |= {"source": _source, "breakable": _breakable}
    return environment.get_template("page.html.jinja").render(
        page=page,
        policy=_policy(scripts, style),
        scripts=[Markup(script) for script in scripts],
        style=Markup(style),
        widget=f"{PACKAGE} {VERSION} ({LICENCE})",
    )


def _visible(value: Any) -> Any:
    """Escape control characters and those that turn text around; ours have none."""
    return printable(value) if type(value) is str else value


def _breakable(name: str) -> Markup:
    """Let a name with options break before one of them rather than inside a word."""
    from markupsafe import Markup, escape

    return Markup("<wbr>@").join(map(escape, printable(name).split(OPTION_MARK)))


def _source(picture: Picture) -> str:
    return f"data:{picture.media_type};base64,{base64.b64encode(picture.content).decode()}"


def _policy(scripts: list[str], style: str) -> str:
    allowed = " ".join(map(_hash, scripts))
    return (
        f"default-src 'none'; img-src data:; script-src {allowed}; style-src {_hash(style)}; "
        "base-uri 'none'; form-action 'none'"
    )


def _hash(text: str) -> str:
    digest = hashlib.sha256(text.encode()).digest()
    return f"'sha256-{base64.b64encode(digest).decode()}'"
