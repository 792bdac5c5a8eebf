"""TOML files of settings, which are small: what is large or deep is refused before it is a trap."""

from __future__ import annotations

import tomllib
from pathlib import Path
from typing import Any

LARGEST = 2**16
"""Bytes; `tomllib` takes the square of a long dotted key's parts."""
DEEPEST = 16
"""Tables and lists inside each other."""


def read_toml(path: Path) -> dict[str, Any]:
    """Read a TOML file.

    Raises:
        OSError: it cannot be read.
        ValueError: it is no TOML, or larger or deeper than any settings are; the message does not
            name the file.
    """
    with path.open("rb") as file:
        content = file.read(LARGEST + 1)
    if len(content) > LARGEST:
        raise ValueError(f"larger than {LARGEST} bytes")
    try:
        table = tomllib.loads(content.decode())
    except RecursionError:
        raise _too_deep() from None
    level: list[Any] = [table]
    for _ in range(DEEPEST):
        level = [child for node in level for child in _children(node)]
    if level:
        raise _too_deep()
    return table


def _children(node: object) -> list[Any]:
    found = node.values() if isinstance(node, dict) else node if isinstance(node, list) else ()
    return [child for child in found if isinstance(child, dict | list)]


def _too_deep() -> ValueError:
    return ValueError(f"more than {DEEPEST} tables or lists inside each other")
