"""List models, data sets, protocols, metrics and figures, including plugins.

Modules that need numpy or pydantic are imported at their use, so that lists of keys are fast.
"""

from __future__ import annotations

from collections.abc import Collection, Mapping, Sequence
from typing import TYPE_CHECKING

from stiff_bench.console import wrapped
from stiff_bench.plan.registry import registry
from stiff_bench.tables.table import Column, Entry, Name, Table
from stiff_bench.tables.units import PRINTED
from stiff_bench.tables.writers import Tables, Text, plain_text
from stiff_protocols.contract.plugin import (
    DatasetInfo,
    Grid,
    ModelInfo,
    PluginInfo,
    ProtocolInfo,
    Range,
)

if TYPE_CHECKING:
    from stiff_bench.plan.options import Option


def list_models() -> Tables:
    """Return keys and summaries of all models; families such as scikit-learn come last."""
    families = [[family.example, family.summary] for family in registry().families]
    return _listed("models", _KEY, [*_rows(registry().models), *families])


def list_datasets() -> Tables:
    """Return keys, kinds and summaries of all data sets."""
    datasets = registry().datasets
    rows = [[key, datasets[str(key)].kind, what] for key, what in _rows(datasets)]
    return _listed("datasets", ("key", "kind", "what it is"), rows)


def list_protocols() -> Tables:
    """Return keys and summaries of all protocols."""
    return _listed("protocols", _KEY, _rows(registry().protocols))


def list_metrics() -> Tables:
    """Return keys, printed units, best directions and meanings of all metrics."""
    from stiff_protocols.contract.types import AXES
    from stiff_protocols.scoring.metrics import METRICS

    rows: list[list[Entry]] = []
    for item in METRICS.values():
        values = "x, y, z" if item.axes == AXES else "one"
        rows.append([item.key, PRINTED[item.unit][0], item.direction, values, item.meaning])
    return _listed("metrics", ["key", "unit", "best", "values", "what it is"], rows)


def list_figures() -> Tables:
    """Return names and summaries of all figures; numbers are figures of the paper."""
    from stiff_bench.figures.figure_catalog import FIGURES
    from stiff_bench.paper import paper_figures

    figures = {**FIGURES, **paper_figures.FIGURES}
    summaries = {
        name: str(function.__doc__).partition("\n")[0] for name, function in figures.items()
    }
    rows = [[name, text.removeprefix("Show ").strip(".")] for name, text in summaries.items()]
    return _listed("figures", ("name", "what it shows"), rows)


_KEY = ("key", "what it is")


def _rows(infos: Mapping[str, PluginInfo]) -> list[list[Entry]]:
    return [[info.key, str(Name(info.summary, info.missing()))] for info in infos.values()]


class _List(Tables):
    def __repr__(self) -> str:
        """Return the list."""
        return self.text_as("github")

    def text_as(self, fmt: str) -> str:
        """Return the list; as text it has no title."""
        return plain_text(self.tables[0]) if fmt == "github" else super().text_as(fmt)


def _listed(what: str, headers: Sequence[str], rows: Sequence[Sequence[Entry]]) -> Tables:
    return _List([_table(headers, rows, what)], f"bench list {what}")


def _table(headers: Sequence[str], rows: Sequence[Sequence[Entry]], title: str = "") -> Table:
    return Table(title, [Column(name, "text") for name in headers], rows)


def show(key: str) -> Text:
    """Explain a model, data set or protocol, with its options.

    For fanuc-drilling, which is not used for fits, it returns the data card.

    Args:
        key: model, data set or protocol.

    Raises:
        ConfigError: the key is unknown.
    """
    from stiff_bench.plan.options import options_of
    from stiff_datasets.dataset_catalog import DRILLED_HOLES

    if key == DRILLED_HOLES.key:
        from stiff_bench.tables.dataset_facts import card_text

        return Text(card_text(key, DRILLED_HOLES.card))
    info = registry().find(key)
    parts = [f"{info.key}: {info.summary}"]
    if isinstance(info, ModelInfo) and info.equation:
        parts.append(f"equation: {info.equation}")
    parts += [f"reference: {info.reference}"] if info.reference else []
    if isinstance(info, DatasetInfo):
        parts.append(f"kind: {info.kind}")
        parts += [f"caveat: {caveat}" for caveat in info.caveats]
    if reason := info.missing():
        parts.append(f"cannot be used here yet: {reason}")
    if isinstance(info, ModelInfo):
        of_library = f", and the version of {info.library}" if info.library else ""
        parts.append(f"version: {info.version}{of_library} (part of a result's identity)")
        parts += [f"grid {name} of `nested`: {_text(grid)}" for name, grid in info.grids.items()]
    if isinstance(info, ProtocolInfo):
        parts += [f"reasoning: {info.reasoning}"] if info.reasoning else []
        parts += [f"warning: {info.warning}"] if info.warning else []
    options = options_of(info.load()).values()
    heading = f"options: --set {info.key}.OPTION=VALUE, or {info.key}@OPTION=VALUE as the name"
    parts += ["", heading if options else "no options"]
    lines = [wrapped(part, indent="  ") for part in parts]
    describe_parts = getattr(info.load(), "describe_parts", dict)
    return Text("\n".join([*lines, *_option_lines(options), *_part_lines(describe_parts())]))


def _option_lines(options: Collection[Option]) -> list[str]:
    """Return lines on each option: default, valid values and description."""
    width = max((len(option.name) for option in options), default=0) + 4
    lines = []
    for option in options:
        values = f"{_default(option)} (valid: {option.type_text})"
        lines.append(wrapped(values, f"  {option.name}".ljust(width), " " * width))
        lines += [wrapped(option.description, " " * width, " " * width)] * bool(option.description)
    return lines


def _part_lines(parts: Mapping[str, str]) -> list[str]:
    """Return lines on the parts of a model: their names and descriptions."""
    width = max(map(len, parts), default=0) + 4
    lines = (wrapped(text, f"  {name}".ljust(width), " " * width) for name, text in parts.items())
    return ["", "groups:", *lines] if parts else []


def _text(grid: Grid) -> str:
    return "; ".join(
        f"{option} = {values if isinstance(values, Range) else ' | '.join(map(str, values))}"
        for option, values in grid.items()
    )


def _default(option: Option) -> str:
    if option.required:
        return "required"
    default = option.default
    word = str(default).lower() if default is None or isinstance(default, bool) else default
    return f"default: {word}" if word != "" else "no default"
