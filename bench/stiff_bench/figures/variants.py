"""Variants of a model: results that differ in some options alone."""

from __future__ import annotations

from collections.abc import Sequence

from stiff_bench.grouped import grouped
from stiff_protocols.record import CellResult


def variants_of(results: Sequence[CellResult], *options: str) -> tuple[str, list[CellResult]]:
    """Return the model with most values of some options, and its results.

    They differ in nothing else than these options, and in their splits.

    Args:
        results: at least one.
        options: names of the model's options.
    """
    families = grouped(results, lambda one: _others(one, options)).values()
    largest = max(families, key=lambda members: len({_values(one, options) for one in members}))
    return largest[0].cell.model, largest


def _values(result: CellResult, options: Sequence[str]) -> tuple[str, ...]:
    return tuple(str(result.cell.model_params.get(name)) for name in options)


def _others(result: CellResult, options: Sequence[str]) -> tuple[str, ...]:
    given = result.cell.model_params
    return (result.cell.model, *(f"{k}={given[k]}" for k in sorted(given) if k not in options))
