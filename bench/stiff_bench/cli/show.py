"""The texts of `bench list` and `bench show KEY`.

What needs numpy or pydantic is imported where it is used: a list of keys answers without them.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from typing import TYPE_CHECKING

from stiff_bench.tables.render import plain_text
from stiff_bench.tables.table import Cell, Column, Table
from stiff_protocols.contract.plugin import (
    DatasetInfo,
    Grid,
    ModelFamily,
    ModelInfo,
    PluginInfo,
    ProtocolInfo,
    Range,
)

if TYPE_CHECKING:
    from stiff_bench.plan.options import Option


def overview(infos: Iterable[PluginInfo], families: Iterable[ModelFamily] = ()) -> str:
    """Return a line for each catalogue line of one kind, and one for each family of models.

    A line holds key, for data sets the kind, and what it is.
    """
    rows: list[list[Cell]] = []
    headers = ["key", "what it is"]
    for info in infos:
        why = info.missing()
        summary = f"{info.summary} [{why}]" if why else info.summary
        if isinstance(info, DatasetInfo):
            headers = ["key", "kind", "what it is"]
            rows.append([info.key, info.label, summary])
        else:
            rows.append([info.key, summary])
    rows += [[family.example, family.summary] for family in families]
    return _plain(headers, rows)


def _plain(
    headers: Sequence[str], rows: Sequence[Sequence[Cell]], widths: Sequence[int | None] = ()
) -> str:
    return plain_text(Table("", [Column(name, "text") for name in headers], rows), widths=widths)


def metrics_overview() -> str:
    """Return a line for each metric: key, unit as printed, what is best, what it is."""
    from stiff_bench.tables.units import PRINTED
    from stiff_protocols.contract.types import AXES
    from stiff_protocols.scoring.metrics import METRICS

    rows: list[list[Cell]] = []
    for item in METRICS.values():
        values = "x, y, z" if item.axes == AXES else "one"
        rows.append([item.key, PRINTED[item.unit][0], item.direction, values, item.meaning])
    return _plain(["key", "unit", "best", "values", "what it is"], rows)


def describe(info: PluginInfo) -> str:
    """Return summary, reference, version, caveats and options of a catalogue line."""
    from stiff_bench.plan.options import options_of

    parts = [f"{info.key}: {info.summary}"]
    parts += [f"reference: {info.reference}"] if info.reference else []
    if isinstance(info, DatasetInfo):
        parts.append(f"kind: {info.label}")
        parts += [f"caveat: {caveat}" for caveat in info.caveats]
    if why := info.missing():
        parts.append(f"cannot be used here yet: {why}")
    if isinstance(info, ModelInfo):
        of_library = f", and the version of {info.library}" if info.library else ""
        parts.append(f"version: {info.version}{of_library} (part of a result's identity)")
        parts += [f"grid {name} of `nested`: {_text(grid)}" for name, grid in info.grids.items()]
    if isinstance(info, ProtocolInfo):
        parts += [f"reasoning: {info.reasoning}"] if info.reasoning else []
        parts += [f"warning: {info.warning}"] if info.warning else []
    options = options_of(info.load()).values()
    if not options:
        return "\n".join([*parts, "", "no options"])
    rows = [
        [f"{info.key}.{option.name}", option.type_text, _default(option), option.description]
        for option in options
    ]
    headers = ("--set", "valid", "default", "what it does")
    table = _plain(headers, rows, widths=(None, 40, None, 60))
    return "\n".join([*parts, "", table])


def _text(grid: Grid) -> str:
    return "; ".join(
        f"{option} = {values if isinstance(values, Range) else ' | '.join(map(str, values))}"
        for option, values in grid.items()
    )


def _default(option: Option) -> str:
    if option.required:
        return "must be set"
    return "none" if option.default is None else str(option.default)
