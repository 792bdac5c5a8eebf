"""What a search may choose from: an option's values, or a range of them."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

DEFAULT_GRID = "default"
"""Name of the grid that is searched where no other is asked for."""


@dataclass(frozen=True)
class Range:
    """All numbers from `low` to `high`, both included, whole ones where both are.

    With `log` they are drawn evenly on a logarithmic scale.
    """

    low: float
    high: float
    log: bool = False

    @property
    def whole(self) -> bool:
        """Whether the option takes whole numbers."""
        return isinstance(self.low, int) and isinstance(self.high, int)


Grid = Mapping[str, Sequence[Any] | Range]
"""Option -> its candidates."""


def in_words(params: Mapping[str, Any]) -> str:
    """Return options with their values for people."""
    return ", ".join(f"{name}={value}" for name, value in params.items())
