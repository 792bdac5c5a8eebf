"""The order in which people expect names with numbers."""

from __future__ import annotations

import re


def natural_key(text: str) -> list[tuple[int, str]]:
    """Return a sort key in which numbers stand by their size: "n = 5" before "n = 40"."""
    return [(int(part), "") if part.isdigit() else (-1, part) for part in re.split(r"(\d+)", text)]
