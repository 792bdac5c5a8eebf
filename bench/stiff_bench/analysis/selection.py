"""Which stored results are shown: models, data sets, protocols and conditions, by words."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

from stiff_bench.analysis.collected import Case, competitor_names
from stiff_bench.store.names import OPTION_MARK, Variant
from stiff_protocols.contract.errors import unknown_name
from stiff_protocols.contract.record import Cell


@dataclass(frozen=True)
class Selection:
    """What is shown of stored results, as `Results.select` and the command line choose it.

    A key without options stands for all its variants: "kr10-twin" for every specimen,
    "kr10-twin@specimen=0", where the default is spelled out, for the one shown as "kr10-twin".

    Attributes:
        models, datasets, protocols: names, or keys that stand for all variants; none: all.
        conditions: of the protocols, such as "n = 40"; none: all.
    """

    models: tuple[str, ...] = ()
    datasets: tuple[str, ...] = ()
    protocols: tuple[str, ...] = ()
    conditions: tuple[str, ...] = ()

    @property
    def options(self) -> list[tuple[str, str]]:
        """The same as options of the command line: ("model", "vjm") ..."""
        kinds = ("model", "dataset", "protocol", "condition")
        return [(kind, word) for kind in kinds for word in getattr(self, f"{kind}s")]

    def takes(self, model: str) -> bool:
        """Say whether a model's name is among those that are shown."""
        return not self.models or any(stands_for(word, model) for word in self.models)

    def models_of(self, cases: Iterable[Case]) -> list[str]:
        """Return the names of the models that are shown of these cases.

        Raises:
            ConfigError: a word has no results.
        """
        known = competitor_names(cases)
        for word in self.models:
            if not any(stands_for(word, name) for name in known):
                raise unknown_name("model with results", word, known)
        return [name for name in known if self.takes(name)]

    def cases_of(self, cases: Sequence[Case]) -> list[Case]:
        """Return the cases of the data sets, protocols and conditions that are shown.

        Raises:
            ConfigError: a name has no results.
        """
        chosen = list(cases)
        for kind in ("dataset", "protocol", "condition"):
            words = getattr(self, f"{kind}s")
            for word in words:
                if not any(_is_of(case, kind, word) for case in cases):
                    known = {getattr(case.name, kind) for case in cases} - {""}
                    raise unknown_name(f"{kind} with results", word, known)
            if words:
                chosen = [case for case in chosen if any(_is_of(case, kind, w) for w in words)]
        return chosen


EVERYTHING = Selection()


def _is_of(case: Case, kind: str, word: str) -> bool:
    """Say whether a word stands for a case's data set, protocol or condition."""
    if kind == "condition":
        return word == case.name.condition
    key, options = getattr(case.cell, kind), getattr(case.cell, f"{kind}_params")
    return stands_for(word, getattr(case.name, kind)) or _spells_out(
        Variant.of_word(word), key, options
    )


def stands_for(word: str, name: str) -> bool:
    """Say whether a word is a name, or the key of a name with options."""
    return name == word or name.startswith(f"{word}{OPTION_MARK}")


def competitor_meant(word: str, cases: Sequence[Case]) -> str:
    """Return the name of the model with results that a word stands for.

    A word may spell out defaults, as for `bench run`: "knn@neighbours=5" is what is stored as
    "knn". The defaults are those that the results were made with.

    Raises:
        ConfigError: there are no results of it.
    """
    cells = _cells_of(cases)
    name = word if word in cells else meant(Variant.of_word(word), cases)
    if name is None:
        raise unknown_name("model with results", word, cells)
    return name


def meant(asked: Variant, cases: Sequence[Case]) -> str | None:
    """Return the name of the model with results that has these options; None: there is none.

    They may be defaults, as in `competitor_meant`.
    """
    for name, cell in sorted(_cells_of(cases).items()):
        shown = Variant.shown("", name, cell.model_params).options.keys()
        if shown <= asked.options.keys() and _spells_out(asked, cell.model, cell.model_params):
            return name
    return None


def _cells_of(cases: Sequence[Case]) -> dict[str, Cell]:
    """Return a cell of each model that has results or failures, by the model's name."""
    return {name: one.cell for case in cases for name, one in case.competitors.items()}


def _spells_out(asked: Variant, key: str, options: Mapping[str, Any]) -> bool:
    """Say whether a key and some of these options, which may be defaults, were asked for."""
    return asked.key == key and all(
        option in options and _is(options[option], value) for option, value in asked.options.items()
    )


def _is(value: Any, asked: Any) -> bool:
    """Say whether a value is what was asked for, however its number was written."""
    try:
        return float(value) == float(asked)
    except (TypeError, ValueError):
        return str(value).lower() == str(asked).lower()
