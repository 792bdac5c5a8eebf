"""Read-only arrays that are checked once, at the input."""

from __future__ import annotations

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
        DataError: the shape differs, or an entry is not a finite real number.
    """
    given = np.asarray(value)
    if given.dtype.kind not in "fiub":  # complex numbers and dates would lose a part
        raise DataError(f"{name} holds {given.dtype}, expected real numbers")
    with np.errstate(over="ignore", invalid="ignore"):  # too large numbers are refused below
        array = np.array(given, dtype=np.float64, order="C")
    if array.ndim != len(shape) or any(
        want is not None and want != have for want, have in zip(shape, array.shape, strict=True)
    ):
        expected_shape = "x".join("n" if size is None else str(size) for size in shape)
        raise DataError(f"{name} has shape {array.shape}, expected {expected_shape}")
    if not np.isfinite(array).all():
        row = tuple(int(i) for i in np.argwhere(~np.isfinite(array))[0])
        raise DataError(f"{name}{list(row)} is {array[row]}, expected a finite number")
    array.flags.writeable = False
    return array


def freeze(owner: object, **shapes: tuple[int | None, ...]) -> None:
    """Turn attributes of a frozen dataclass into `frozen_array`s; DataError as there."""
    for name, shape in shapes.items():
        object.__setattr__(owner, name, frozen_array(getattr(owner, name), name, shape))
