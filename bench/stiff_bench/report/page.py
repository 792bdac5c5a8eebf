"""The page as HTML: one file, with its style, its scripts and its pictures inside."""

from __future__ import annotations

import base64
import hashlib
from pathlib import Path
from typing import TYPE_CHECKING, Any

from stiff_bench.messages import printable
from stiff_bench.option_word import OPTION_MARK
from stiff_bench.report.content import Page, Picture
from stiff_bench.report.palette import variables
from stiff_bench.report.widget import LICENCE, PACKAGE, VERSION, widget_code

if TYPE_CHECKING:
    from markupsafe import Markup

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
