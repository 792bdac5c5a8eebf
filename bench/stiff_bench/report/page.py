"""The page as HTML: one file, with its style, its scripts and its pictures inside."""

from __future__ import annotations

import base64
import hashlib
import subprocess
import sys
import tarfile
import tempfile
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any, NamedTuple

from stiff_bench.console import printable
from stiff_bench.report.content import Page, Picture
from stiff_bench.store.names import OPTION_MARK
from stiff_bench.tables.table import Cell, Column, Table, natural_order, quantity
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
MOST_ROWS = 2000
"""So many rows of a table are embedded; the page says where there are more."""
_LONG = 40  # characters of a text that needs room


class PageCell(NamedTuple):
    """A cell of the page: text, what its column is sorted by ("" stands last), CSS class."""

    text: str
    order: str
    style: str


class PageTable(NamedTuple):
    """A table as the page's template reads it: the CSS class of a column, rows, notes."""

    styles: list[str]
    rows: list[list[PageCell]]
    notes: list[str]
    can_be_sorted: bool


def page_table(table: Table) -> PageTable:
    """Return a table's cells with their typed order, cut to `MOST_ROWS`."""
    rows = table.rows[:MOST_ROWS]
    notes = [*table.notes]
    if len(rows) < len(table.rows):
        notes.append(
            f"The first {len(rows)} of {len(table.rows)} rows are shown; name fewer models, data "
            "sets or protocols for the others."
        )
    styles = [
        _style(column, [row[number] for row in rows]) for number, column in enumerate(table.columns)
    ]
    cells = [
        [_page_cell(*each) for each in zip(table.columns, row, styles, strict=True)] for row in rows
    ]
    can_be_sorted = len(rows) > 1 and not any(column.by_sign for column in table.columns)
    return PageTable(styles, cells, notes, can_be_sorted)


def _style(column: Column, cells: Sequence[Cell]) -> str:
    if column.kind == "number":
        return "number"
    return "long" if any(len(column.text(cell)) > _LONG for cell in cells) else "text"


def _page_cell(column: Column, cell: Cell, style: str) -> PageCell:
    text = column.text(cell)
    if style != "number":
        return PageCell(text, natural_order(text), "" if style == "long" else style)
    found = quantity(cell)
    order = "" if found is None or found.order is None else f"{found.order:.12g}"
    tone = " worse" if order.startswith("-") else " better" if order not in ("", "0") else ""
    return PageCell(text, order, style + tone * column.by_sign)


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
    environment.filters |= {"source": _source, "breakable": _breakable, "laid_out": page_table}
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
