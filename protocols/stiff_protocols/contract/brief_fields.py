"""Print dataclasses in one line, with arrays as shapes."""

from __future__ import annotations

import reprlib
from dataclasses import fields
from typing import Any


class _Brief(reprlib.Repr):
    """Shorten values to a few characters, arrays to their shape."""

    def __init__(self) -> None:
        super().__init__()
        self.maxlevel, self.maxother, self.maxstring = 2, 60, 60
        self.maxdict = self.maxtuple = self.maxlist = 3

    def repr_ndarray(self, array: Any, level: int) -> str:
        """Return the shape."""
        return f"<array {'x'.join(map(str, array.shape))}>"

    def repr_instance(self, x: Any, level: int) -> str:
        """Return the first line of the object's own text, shortened."""
        return super().repr_instance(x, level).partition("\n")[0]


class BriefFields:
    """Mixin: print a dataclass (with `repr=False`) in one line, with arrays as shapes."""

    def __repr__(self) -> str:
        brief = _Brief()
        record: Any = self
        parts = [f"{item.name}={brief.repr(getattr(self, item.name))}" for item in fields(record)]
        return f"{type(self).__name__}({', '.join(parts)})"
