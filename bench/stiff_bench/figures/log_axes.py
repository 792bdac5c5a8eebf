"""Numbers on logarithmic axes, without the formulas that names with "$" forbid."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from matplotlib.axis import Axis

_RAISED = str.maketrans("-0123456789", "⁻⁰¹²³⁴⁵⁶⁷⁸⁹")


def powers(axis: Axis) -> None:
    """Write the decades of an axis that spans many: 10⁻³, 10⁻²."""
    from matplotlib.ticker import FuncFormatter, NullFormatter

    axis.set_major_formatter(FuncFormatter(lambda value, _: power_of_ten(value)))
    axis.set_minor_formatter(NullFormatter())


def power_of_ten(value: float) -> str:
    """Return "10⁻³" for 0.001; other numbers in digits."""
    if value <= 0.0:
        return f"{value:g}"
    exponent = round(math.log10(value))
    exact = math.isclose(value, 10.0**exponent)
    return f"10{str(exponent).translate(_RAISED)}" if exact else f"{value:g}"


def plain_numbers(axis: Axis) -> None:
    """Write 0.1, 0.2, 0.5, 1 on an axis that spans few decades."""
    from matplotlib.ticker import LogLocator, NullFormatter

    axis.set_major_locator(LogLocator(subs=(1.0, 2.0, 5.0)))
    axis.set_major_formatter("{x:g}")
    axis.set_minor_formatter(NullFormatter())
