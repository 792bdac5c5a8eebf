"""Extend MkDocs for the docs site: equations as MathML, links of the repository.

No network is needed: the pages contain the equations, which any browser can draw.
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
"""Placeholder of the leaderboard in a page."""
BOARD_SENTENCES = ("- How sure:", "- But:", "- Data:")
MOUNT = "repository"
"""Folder of the site for pages and pictures from outside docs/."""


def on_files(files: Files, *, config: Any) -> Files:
    """Add the files of `extra.mounted`, paths and patterns from the repository's root."""
    root = _root(config)
    for pattern in config["extra"]["mounted"]:
        for path in sorted(root.glob(pattern)):
            name = f"{MOUNT}/{path.relative_to(root).as_posix()}"
            files.append(File.generated(config, name, abs_src_path=str(path)))
    return files


def on_page_markdown(text: str, *, page: Any, config: Any, files: Files) -> str:
    """Insert the leaderboard, and convert the repository's links to links of the site."""
    page_path = page.file.src_uri
    if page_path.startswith("api/"):  # the search shows the pages of the guide first
        page.meta["search"] = {"boost": 0.3}
    if BOARD_PLACE in text:
        text = text.replace(BOARD_PLACE, leaderboard(_root(config)))

    def moved(match: re.Match[str]) -> str:
        return match[0] if match["code"] else _moved_link(match, page_path, _root(config), files)

    parts = FENCE.split(text)
    parts[::2] = [LINK.sub(moved, part) for part in parts[::2]]
    return "".join(parts)


def on_page_content(text: str, *, page: Any, config: Any, files: Files) -> str:
    """Write every equation as MathML."""
    return EQUATION.sub(lambda match: _mathml(match, page.file.src_uri), text)


def leaderboard(root: Path) -> str:
    """Return headline and first table of the committed leaderboard, in Markdown."""
    text = (root / BOARD).read_text(encoding="utf-8")
    headline, _, body = text.partition("\n\n")
    table, _, notes = body.partition("\n\n")
    sentences = [line for line in notes.splitlines() if line.startswith(BOARD_SENTENCES)]
    return "\n\n".join([headline, table, "\n".join(sentences)])


def _root(config: Any) -> Path:
    return Path(config["docs_dir"]).parent


def _moved_link(match: re.Match[str], page_path: str, root: Path, files: Files) -> str:
    target, _, anchor = match["to"].partition("#")
    if not target or "://" in target or target.startswith("mailto:"):
        return match[0]
    source_path = (
        page_path.removeprefix(f"{MOUNT}/") if page_path.startswith(MOUNT) else f"docs/{page_path}"
    )
    path = posixpath.normpath(posixpath.join(posixpath.dirname(source_path), target))
    site_path = path.removeprefix("docs/") if path.startswith("docs/") else f"{MOUNT}/{path}"
    if files.get_file_from_path(site_path) is None:
        if not (root / path).exists():
            return match[0]  # MkDocs reports a broken link
        return f"{match['text']} (`{path}`)"  # it is in the repository, but not on the site
    link = posixpath.relpath(site_path, posixpath.dirname(page_path) or ".")
    return f"{match['picture']}[{match['text']}]({link}{'#' + anchor if anchor else ''})"


def _mathml(match: re.Match[str], page: str) -> str:
    block = match["block"] is not None
    tex = html.unescape(html.unescape(match["block"] if block else match["inline"])).strip()
    mathml = convert(tex, display="block" if block else "inline")
    unknown = re.search(r"\\[A-Za-z]+", mathml)
    if unknown:
        raise PluginError(f"{page}: unknown command {unknown[0]} in the equation {tex}")
    return f'<div class="equation" tabindex="0">{mathml}</div>' if block else mathml
