"""`bench report`: from folders of results to a file."""

from __future__ import annotations

from collections.abc import Sequence
from importlib.metadata import version
from pathlib import Path

from stiff_bench.report.commands import Choice
from stiff_bench.report.content import Page
from stiff_bench.report.gather import part_of
from stiff_bench.report.narrowed import check_choice
from stiff_bench.report.page import render_page
from stiff_bench.sort_key import sort_key
from stiff_bench.stored_leaderboard import StoredResults
from stiff_protocols.errors import ConfigError
from stiff_protocols.files import written_whole

SUFFIXES = (".html", ".htm")


def write_report(folders: Sequence[Path], choice: Choice, output: Path, command: str) -> None:
    """Write the page of some folders of results, whole or not at all.

    Args:
        folders: each a part of the page.
        choice: what is shown of each.
        output: the file.
        command: the command line, for the record.

    Raises:
        ConfigError: the file's suffix is none of a page, a folder is named twice, a name has no
            results in any of them, or the metric cannot rank.
        StoreError: a folder holds no results or damaged ones, or the file cannot be written.
    """
    if output.suffix.lower() not in SUFFIXES:
        valid = ", ".join(SUFFIXES)
        raise ConfigError(
            f"--output {output}: suffix {output.suffix!r} is no page's (valid: {valid})"
        )
    for number, folder in enumerate(folders):
        if folder.resolve() in {other.resolve() for other in folders[:number]}:
            raise ConfigError(f"--results {folder}: is named twice")
    key = sort_key(choice.metric, choice.axis)
    stored = [StoredResults.read(folder) for folder in folders]
    check_choice([contest for one in stored for contest in one.contests], choice)
    parts = [part_of(one, choice, key) for one in stored]
    page = Page(command, version("stiffbench"), parts)
    with written_whole(output) as temporary:
        temporary.write_text(render_page(page), encoding="utf-8", newline="\n")
