"""Convert SI units to printed units."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from stiff_protocols.scoring.metrics import Unit

PRINTED: dict[Unit, tuple[str, float]] = {
    "m": ("mm", 1000.0),
    "share": ("%", 100.0),
    "1": ("", 1.0),
    "s": ("ms", 1000.0),
    "B": ("MiB", 2.0**-20),
    "1/s": ("1/s", 1.0),
}
"""Printed unit and conversion factor, by unit of a metric."""


MM = PRINTED["m"][1]
"""Millimetres per metre."""


def percent(share: float) -> str:
    """Format a share as per cent."""
    return f"{100.0 * share:.4g} %"


def counted(number: int, thing: str) -> str:
    """Return a number with its noun: "1 split", "5 splits"."""
    return f"{number} {thing}" if number == 1 else f"{number} {thing}s"


def first_few(names: Sequence[str], most: int = 3) -> str:
    """Return the first names, and the number of further ones.

    >>> first_few(["a", "b", "c", "d", "e"])
    'a, b, c and 2 more'
    """
    more = f" and {len(names) - most} more" if len(names) > most else ""
    return f"{', '.join(names[:most])}{more}"


def duration(seconds: float | None) -> str:
    """Return a time in s as ms, s or min, with two digits.

    >>> duration(0.0123), duration(1.53), duration(754.0)
    ('12 ms', '1.5 s', '13 min')
    """
    if seconds is None:
        return "-"
    if seconds < 1.0:
        return f"{_short(1000.0 * seconds)} ms"
    return f"{_short(seconds)} s" if seconds < 99.0 else f"{seconds / 60.0:.0f} min"


def _short(number: float) -> str:
    return f"{number:.0f}" if number >= 10.0 else f"{number:.2g}"
