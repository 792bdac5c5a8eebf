"""Check formats of pictures: PNG, PDF or SVG, with reproducible files."""

from __future__ import annotations

from pathlib import Path
from typing import Any

from stiff_protocols.contract.errors import unsupported_extension

METADATA: dict[str, dict[str, Any]] = {
    ".png": {},
    ".pdf": {"CreationDate": None},
    ".svg": {"Date": None},
}
"""Metadata for `savefig` by suffix; without the time, so that files are reproducible."""


def check_suffix(path: Path) -> None:
    """Check the extension of a picture file.

    Raises:
        ConfigError: the extension is not supported.
    """
    if path.suffix.lower() not in METADATA:
        raise unsupported_extension(path, METADATA)
