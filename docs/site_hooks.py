"""What the docs site needs beyond MkDocs: equations as MathML, links as the repository has them.

Nothing here asks the network: the equations are in the pages, for any browser to draw.
"""

from __future__ import annotations

import html
import posixpath
import re
from pathlib import Path
from typing import Any

from latex2mathml.converter import convert
from mkdocs.exceptions import PluginError
from mkdocs.structure.files import File, Files

EQUATION = re.compile(
    r'<(?P<tag>span|div) class="arithmatex">'
    r"(?:\\\((?P<inline>.*?)\\\)|\\\[(?P<block>.*?)\\\])</(?P=tag)>",
    re.DOTALL,
)
LINK = re.compile(r"(?P<code>`[^`\n]+`)|(?P<picture>!?)\[(?P<text>[^\]\n]*)\]\((?P<to>[^)\s]+)\)")
FENCE = re.compile(r"^(```.*?^```[^\n]*$)", re.MULTILINE | re.DOTALL)
BOARD = Path("results/leaderboard/tables/table_leaderboard.md")
BOARD_PLACE = "<!-- leaderboard -->"
"""Stands in a page where the site shows the leaderboard."""
BOARD_SENTENCES = ("- How sure:", "- But:", "- Data:")
MOUNT = "repository"
"""Where the site has the pages and pictures that stand outside docs/."""


def on_files(files: Files, *, config: Any) -> Files:
    """Add what `extra.mounted` names: paths and patterns from the top of the repository."""
    root = _root(config)
    for pattern in config["extra"]["mounted"]:
        for path in sorted(root.glob(pattern)):
            name = f"{MOUNT}/{path.relative_to(root).as_posix()}"
            files.append(File.generated(config, name, abs_src_path=str(path)))
    return files


def on_page_markdown(text: str, *, page: Any, config: Any, files: Files) -> str:
    """Put in the leaderboard, and point links, which are the repository's, to their places."""
    here = page.file.src_uri
    if BOARD_PLACE in text:
        text = text.replace(BOARD_PLACE, leaderboard(_root(config)))

    def moved(found: re.Match[str]) -> str:
        return found[0] if found["code"] else _moved_link(found, here, _root(config), files)

    parts = FENCE.split(text)
    parts[::2] = [LINK.sub(moved, part) for part in parts[::2]]
    return "".join(parts)


def on_page_content(text: str, *, page: Any, config: Any, files: Files) -> str:
    """Write every equation as MathML."""
    return EQUATION.sub(lambda found: _mathml(found, page.file.src_uri), text)


def leaderboard(root: Path) -> str:
    """Return headline and first table of the committed leaderboard, in Markdown."""
    text = (root / BOARD).read_text(encoding="utf-8")
    headline, _, rest = text.partition("\n\n")
    table, _, notes = rest.partition("\n\n")
    sentences = [line for line in notes.splitlines() if line.startswith(BOARD_SENTENCES)]
    return "\n\n".join([headline, table, "\n".join(sentences)])


def _root(config: Any) -> Path:
    return Path(config["docs_dir"]).parent


def _moved_link(found: re.Match[str], here: str, root: Path, files: Files) -> str:
    to, _, anchor = found["to"].partition("#")
    if not to or "://" in to or to.startswith("mailto:"):
        return found[0]
    own = here.removeprefix(f"{MOUNT}/") if here.startswith(MOUNT) else f"docs/{here}"
    path = posixpath.normpath(posixpath.join(posixpath.dirname(own), to))
    place = path.removeprefix("docs/") if path.startswith("docs/") else f"{MOUNT}/{path}"
    if files.get_file_from_path(place) is None:
        if not (root / path).exists():
            return found[0]  # MkDocs names a link that leads nowhere
        return f"{found['text']} (`{path}`)"  # it is in the repository and not on the site
    link = posixpath.relpath(place, posixpath.dirname(here) or ".")
    return f"{found['picture']}[{found['text']}]({link}{'#' + anchor if anchor else ''})"


def _mathml(found: re.Match[str], page: str) -> str:
    block = found["block"] is not None
    tex = html.unescape(html.unescape(found["block"] if block else found["inline"])).strip()
    mathml = convert(tex, display="block" if block else "inline")
    unknown = re.search(r"\\[A-Za-z]+", mathml)
    if unknown:
        raise PluginError(f"{page}: {unknown[0]} in the equation {tex} is not known")
    return f'<div class="equation" tabindex="0">{mathml}</div>' if block else mathml
