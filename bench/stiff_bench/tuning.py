"""Models whose options a protocol has chosen in their fit."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

from stiff_bench.choice import Choice
from stiff_bench.grids import checked_grid, written_grids
from stiff_protocols.contract import ChecksParams, TunesModels
from stiff_protocols.errors import ConfigError
from stiff_protocols.plugin import ModelInfo, ProtocolInfo
from stiff_protocols.search_space import Grid, Range


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
        """Return a new object that chooses.

        Raises:
            ConfigError: the model's constructor refuses.
        """
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
                _tuned(said, model, tuner, grids.get(model.info.key, {})) for model in models
            ]
    return found


def _tuned(
    said: str, model: Choice[ModelInfo], tuner: TunesModels, written: Mapping[str, Any]
) -> TunedChoice:
    """Return the checked choice; an option that the user set is taken out of the grid."""
    said = f"{said}: {model.info.key}"
    grid = checked_grid(said, model, written)
    left = {name: grid[name] for name in grid if name not in {**model.params, **model.context}}
    tuned = TunedChoice(model.info, model.cls, model.params, model.context, tuner, left)
    made = tuned.make()
    if isinstance(made, ChecksParams) and not tuned.missing():
        try:
            made.check_params()
        except ConfigError as error:
            raise ConfigError(f"{said}: {error}") from error
    return tuned
