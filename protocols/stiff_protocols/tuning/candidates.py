"""Candidates of a search: a named grid of the catalogue lines, or the user's TOML file.

A file has a table per model (quoted if the key holds a colon or a dot)::

    [ft-mlp]
    freeze = ["layers:1,2", "full"]
    learning_rate = {low = 1e-4, high = 1e-2, log = true}
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import asdict
from pathlib import Path
from typing import Any

from stiff_protocols.contract.errors import ConfigError, unknown_name
from stiff_protocols.contract.files import read_toml
from stiff_protocols.contract.plugin import DEFAULT_GRID, Grid, ModelInfo, Range
from stiff_protocols.contract.protocol_base import ParseOption

FILE_ENDING = ".toml"
VALID = "a list of values, or {low = ..., high = ..., log = true} of numbers for search=optuna"


def read_grids(
    name: str, option: str, models: Sequence[ModelInfo], parse: ParseOption
) -> dict[str, Grid]:
    """Return the candidates of options by model key, of the options' types.

    Args:
        name: name of a grid of the catalogue lines, or a path that ends in .toml.
        option: what the user set, for messages.
        models: models of the run; the result omits models without candidates.
        parse: function that turns the text of a value into the option's type.

    Raises:
        ConfigError: no model has candidates, the file cannot be read, an option is unknown, or a
            value is not valid.
    """
    keys = {model.key: model for model in models}
    if name.endswith(FILE_ENDING):
        written = _tables_of(Path(name), option, set(keys))
    else:
        written = {model.key: model.grids[name] for model in models if name in model.grids}
        if not written and name != DEFAULT_GRID:
            grid_names = {grid for model in models for grid in model.grids}
            unknown = unknown_name("grid of these models", name, grid_names | {DEFAULT_GRID})
            raise ConfigError(f"{option}: {unknown}; a file's name ends in {FILE_ENDING}")
    return {
        key: {
            name: _candidates(f"{option}: {key}.{name}", keys[key], name, values, parse)
            for name, values in table.items()
        }
        for key, table in written.items()
        if key in keys
    }


def _tables_of(path: Path, option: str, keys: set[str]) -> Mapping[str, Mapping[str, Any]]:
    content = read_toml(path, named=option, error=ConfigError)
    for key, table in content.items():
        if not isinstance(table, dict):
            raise ConfigError(f"{option}: {key} is {table!r} (valid: tables [MODEL] of options)")
    if not keys & set(content):
        raise ConfigError(
            f"{option}: has tables for {', '.join(content) or 'no model'}, none for a model of "
            f"this run ({', '.join(sorted(keys))})"
        )
    return content


def _candidates(
    option_name: str, model: ModelInfo, name: str, written: Any, parse: ParseOption
) -> tuple[Any, ...] | Range:
    """Return the values, or the range whose ends have the option's type."""
    if isinstance(written, Range):
        written = asdict(written)
    if isinstance(written, list | tuple) and written:
        return tuple(parse(option_name, model, name, str(value)) for value in written)
    wrong = ConfigError(f"{option_name} is {written!r} (valid: {VALID})")
    ends = {"low", "high"}
    if not (isinstance(written, Mapping) and ends <= written.keys() <= ends | {"log"}):
        raise wrong
    low, high = (parse(option_name, model, name, str(written[end])) for end in ("low", "high"))
    log = written.get("log", False)
    if {type(low), type(high)} - {int, float} or type(log) is not bool:
        raise wrong
    if not low < high:
        raise ConfigError(f"{option_name}: low {low:g} must lie below high {high:g}")
    if log and low <= 0:
        raise ConfigError(f"{option_name}: low {low:g} has no logarithm (valid with log: above 0)")
    return Range(low, high, log)
