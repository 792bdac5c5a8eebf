"""Candidates of a search: a named grid of the catalogue lines, or the user's TOML file.

A file has a table a model (quoted where the key holds a colon or a dot)::

    [ft-mlp]
    freeze = ["layers:1,2", "full"]
    learning_rate = {low = 1e-4, high = 1e-2, log = true}
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

from stiff_bench.plan.options import Choice, parse_option
from stiff_protocols.contract.errors import ConfigError, unknown_name
from stiff_protocols.contract.files import read_toml
from stiff_protocols.contract.interfaces import TunesModels
from stiff_protocols.contract.plugin import DEFAULT_GRID, Grid, ModelInfo, ProtocolInfo, Range
from stiff_protocols.contract.stiffness_model import optional

FILE_ENDING = ".toml"
VALID = "a list of values, or {low = ..., high = ..., log = true} of numbers for search=optuna"


def written_grids(
    name: str, said: str, models: Sequence[Choice[ModelInfo]]
) -> Mapping[str, Mapping[str, Any]]:
    """Return each model key's grid as it is written, for those that have one.

    `name` is a grid's, or a path that ends in .toml; `said` is what the user set, for messages.

    Raises:
        ConfigError: there is none for any of the models, or the file cannot be read.
    """
    if name.endswith(FILE_ENDING):
        return _read(Path(name), said, {model.info.key for model in models})
    grids = {model.info.key: model.info.grids[name] for model in models if name in model.info.grids}
    if not grids and name != DEFAULT_GRID:
        known = {grid for model in models for grid in model.info.grids}
        unknown = unknown_name("grid of these models", name, known | {DEFAULT_GRID})
        raise ConfigError(f"{said}: {unknown}; a file's name ends in {FILE_ENDING}")
    return grids


def _read(path: Path, said: str, keys: set[str]) -> dict[str, dict[str, Any]]:
    content = read_toml(path, named=said, error=ConfigError)
    for key, table in content.items():
        if not isinstance(table, dict):
            raise ConfigError(f"{said}: {key} is {table!r} (valid: tables [MODEL] of options)")
    if not keys & set(content):
        raise ConfigError(
            f"{said}: has tables for {', '.join(content) or 'no model'}, none for a model of this "
            f"run ({', '.join(sorted(keys))})"
        )
    return content


def checked_grid(said: str, model: Choice[ModelInfo], written: Mapping[str, Any]) -> Grid:
    """Return the candidates of a model's options, with the options' types.

    `written` has option -> list of values, Range, or mapping of a range's fields.

    Raises:
        ConfigError: an option is unknown, or a value is wrong.
    """
    return {
        name: _candidates(f"{said}.{name}", model, name, candidates)
        for name, candidates in written.items()
    }


def _candidates(
    said: str, model: Choice[ModelInfo], name: str, written: Any
) -> tuple[Any, ...] | Range:
    """Return the values, or the range whose ends have the option's type."""

    def value(text: object) -> Any:
        return parse_option(said, model.info.key, model.cls, name, str(text))

    if isinstance(written, Range):
        written = asdict(written)
    if isinstance(written, list | tuple) and written:
        return tuple(value(each) for each in written)
    wrong = ConfigError(f"{said} is {written!r} (valid: {VALID})")
    ends = {"low", "high"}
    if not (isinstance(written, Mapping) and ends <= written.keys() <= ends | {"log"}):
        raise wrong
    low, high, log = value(written["low"]), value(written["high"]), written.get("log", False)
    if {type(low), type(high)} - {int, float} or type(log) is not bool:
        raise wrong
    if not low < high:
        raise ConfigError(f"{said}: low {low:g} must lie below high {high:g}")
    if log and low <= 0:
        raise ConfigError(f"{said}: low {low:g} has no logarithm (valid with log: above 0)")
    return Range(low, high, log)


@dataclass(frozen=True)
class TunedChoice(Choice[ModelInfo]):
    """A model that chooses options in its fit.

    Attributes:
        tuner: the protocol that has it do so.
        grid: the candidates; empty where it has none.
    """

    tuner: TunesModels
    grid: Grid

    @property
    def identity(self) -> dict[str, Any]:
        """Every option and its value, with the candidates for those that are chosen."""
        candidates = {
            name: str(values) if isinstance(values, Range) else [str(value) for value in values]
            for name, values in self.grid.items()
        }
        return {**super().identity, **candidates}

    def make(self) -> Any:
        """Return a new object that chooses."""
        return self.tuner.tuned(super().make(), self.grid)


def tuned_models(
    protocols: Sequence[Choice[ProtocolInfo]], models: Sequence[Choice[ModelInfo]]
) -> dict[str, list[TunedChoice]]:
    """Return what each protocol that tunes makes of the models, by the protocol's name.

    Raises:
        ConfigError: a grid or a file holds nothing for these models, names no option, or holds a
            value that is wrong or does not fit the others.
    """
    found = {}
    for protocol in protocols:
        tuner = protocol.make()
        if isinstance(tuner, TunesModels):
            said = f"{protocol.info.key}.grid={tuner.grid}"
            grids = written_grids(tuner.grid, said, models)
            found[protocol.name] = [
                _tuned(f"{said}: {model.info.key}", model, tuner, grids.get(model.info.key, {}))
                for model in models
            ]
    return found


def _tuned(
    said: str, model: Choice[ModelInfo], tuner: TunesModels, written: Mapping[str, Any]
) -> TunedChoice:
    """Return the checked choice; an option that the user set is taken out of the grid."""
    grid = checked_grid(said, model, written)
    left = {name: grid[name] for name in grid if name not in {**model.params, **model.context}}
    tuned = TunedChoice(model.info, model.cls, model.params, model.context, tuner, left)
    made = tuned.make()
    if not tuned.missing():
        try:
            optional(made, "check_params")()
        except ConfigError as error:
            raise ConfigError(f"{said}: {error}") from error
    return tuned
