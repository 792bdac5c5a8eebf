"""Formats of pictures: PNG, PDF or SVG, the same file for the same content."""

from __future__ import annotations

from pathlib import Path
from typing import Any

from stiff_protocols.contract.errors import unsupported_extension

METADATA: dict[str, dict[str, Any]] = {
    ".png": {},
    ".pdf": {"CreationDate": None},
    ".svg": {"Date": None},
}
"""Suffix -> what `savefig` writes into the file: without the time."""


def check_suffix(path: Path) -> None:
    """See that the file's suffix names a format.

    Raises:
        ConfigError: it does not.
    """
    if path.suffix.lower() not in METADATA:
        raise unsupported_extension(path, METADATA)
