"""Arrays that are checked once, where they enter, and read-only from then on."""

from __future__ import annotations

import reprlib
from dataclasses import fields
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from stiff_protocols.contract.errors import DataError

FloatArray = NDArray[np.float64]
BoolArray = NDArray[np.bool_]
IntArray = NDArray[np.int64]
TextArray = NDArray[np.str_]


def frozen_array(value: ArrayLike, name: str, shape: tuple[int | None, ...]) -> FloatArray:
    """Return `value` as a read-only float64 copy of the given shape (None: any length).

    Raises:
        DataError: the shape differs, or an entry is no real number, NaN or infinite.
    """
    given = np.asarray(value)
    if given.dtype.kind not in "fiub":  # complex numbers and dates would lose a part
        raise DataError(f"{name} holds {given.dtype}, expected real numbers")
    with np.errstate(over="ignore", invalid="ignore"):  # what is too large is refused below
        array = np.array(given, dtype=np.float64, order="C")
    if array.ndim != len(shape) or any(
        want is not None and want != have for want, have in zip(shape, array.shape, strict=True)
    ):
        wanted = "x".join("n" if size is None else str(size) for size in shape)
        raise DataError(f"{name} has shape {array.shape}, expected {wanted}")
    if not np.isfinite(array).all():
        row = tuple(int(i) for i in np.argwhere(~np.isfinite(array))[0])
        raise DataError(f"{name}{list(row)} is {array[row]}, expected a finite number")
    array.flags.writeable = False
    return array


def freeze(owner: object, **shapes: tuple[int | None, ...]) -> None:
    """Make attributes of a frozen dataclass `frozen_array`s of these shapes; DataError as there."""
    for name, shape in shapes.items():
        object.__setattr__(owner, name, frozen_array(getattr(owner, name), name, shape))


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
    """Show the fields of a dataclass (with `repr=False`) in a line, arrays by their shape."""

    def __repr__(self) -> str:
        brief = _Brief()
        known: Any = self
        parts = [f"{item.name}={brief.repr(getattr(self, item.name))}" for item in fields(known)]
        return f"{type(self).__name__}({', '.join(parts)})"
