"""By how many per cent one method's errors are below another's."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

from stiff_bench.paper.paper_table import Entry
from stiff_bench.units import MM
from stiff_protocols.errors import StoreError
from stiff_protocols.metrics import metric
from stiff_protocols.record import CellResult

Errors = Mapping[tuple[str, str], float]
"""(metric key, axis) -> mm."""


def errors_mm(result: CellResult, metrics: Sequence[str]) -> Errors:
    """Return a result's errors by axis.

    Raises:
        StoreError: it has no predictions.
    """
    if result.prediction is None:
        raise StoreError(f"{result.shown.model}: a result without predictions")
    return {
        (key, axis): value * MM
        for key in metrics
        for axis, value in metric(key).values(result.prediction).items()
    }


def reduction(old: float, new: float) -> float:
    """Return by how many per cent `new` is below `old`; negative where it is above."""
    return 100.0 * (1.0 - new / old)


def mean_reduction(old: Sequence[float], new: Sequence[float], mark: str = "") -> Entry | None:
    """Return the reduction split by split, as mean and deviation; None where `old` is 0."""
    if not all(old):
        return None
    each = [reduction(before, after) for before, after in zip(old, new, strict=True)]
    return Entry.of(each, mark)
