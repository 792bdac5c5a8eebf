"""Small phrases that every table and sentence says alike."""

from __future__ import annotations


def counted(number: int, thing: str) -> str:
    """Return "1 split", "5 splits"."""
    return f"{number} {thing}" if number == 1 else f"{number} {thing}s"


def marked(name: str, mark: str) -> str:
    """Return a name with what must stand beside it; "" for nothing."""
    return f"{name} [{mark}]" if mark else name
