"""Select stored results by the names of models, data sets, protocols and conditions."""

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
    """Names that select stored results, for `Results.select` and the command line.

    A key without options selects all its variants: "kr10-twin" selects every specimen. With the
    default written out, "kr10-twin@specimen=0" selects only the variant stored as "kr10-twin".

    Attributes:
        models, datasets, protocols: names, or keys that select all variants; empty: all.
        conditions: conditions of the protocols, such as "n = 40"; empty: all.
    """

    models: tuple[str, ...] = ()
    datasets: tuple[str, ...] = ()
    protocols: tuple[str, ...] = ()
    conditions: tuple[str, ...] = ()

    @property
    def options(self) -> list[tuple[str, str]]:
        """Return the selection as options of the command line: ("model", "vjm") ..."""
        kinds = ("model", "dataset", "protocol", "condition")
        return [(kind, word) for kind in kinds for word in getattr(self, f"{kind}s")]

    def takes(self, model: str) -> bool:
        """Return True if a model is selected."""
        return not self.models or any(matches_key(word, model) for word in self.models)

    def models_of(self, cases: Iterable[Case]) -> list[str]:
        """Return the names of the selected models of cases.

        Raises:
            ConfigError: a name has no results.
        """
        model_names = competitor_names(cases)
        for word in self.models:
            if not any(matches_key(word, name) for name in model_names):
                raise unknown_name("model with results", word, model_names)
        return [name for name in model_names if self.takes(name)]

    def cases_of(self, cases: Sequence[Case]) -> list[Case]:
        """Return the cases of the selected data sets, protocols and conditions.

        Raises:
            ConfigError: a name has no results.
        """
        chosen = list(cases)
        for kind in ("dataset", "protocol", "condition"):
            words = getattr(self, f"{kind}s")
            for word in words:
                if not any(_is_of(case, kind, word) for case in cases):
                    valid_words = {getattr(case.name, kind) for case in cases} - {""}
                    raise unknown_name(f"{kind} with results", word, valid_words)
            if words:
                chosen = [case for case in chosen if any(_is_of(case, kind, w) for w in words)]
        return chosen


EVERYTHING = Selection()


def _is_of(case: Case, kind: str, word: str) -> bool:
    """Return True if a word selects a case's data set, protocol or condition."""
    if kind == "condition":
        return word == case.name.condition
    key, options = getattr(case.cell, kind), getattr(case.cell, f"{kind}_params")
    return matches_key(word, getattr(case.name, kind)) or _spells_out(
        Variant.of_word(word), key, options
    )


def matches_key(word: str, name: str) -> bool:
    """Return True if a word is a name, or the key of a name with options."""
    return name == word or name.startswith(f"{word}{OPTION_MARK}")


def resolve_model_name(word: str, cases: Sequence[Case]) -> str:
    """Return the stored name of a model that a user named.

    Defaults may be written out, as for `bench run`: "knn@neighbours=5" is stored as "knn". The
    defaults are taken from the results.

    Raises:
        ConfigError: the model has no results.
    """
    cells = _cells_of(cases)
    name = word if word in cells else find_model(Variant.of_word(word), cases)
    if name is None:
        raise unknown_name("model with results", word, cells)
    return name


def find_model(variant: Variant, cases: Sequence[Case]) -> str | None:
    """Return the stored name of the model with these options; None: no results.

    The options may include defaults, as in `resolve_model_name`.
    """
    for name, cell in sorted(_cells_of(cases).items()):
        option_names = Variant.of_stored_name("", name, cell.model_params).options.keys()
        if option_names <= variant.options.keys() and _spells_out(
            variant, cell.model, cell.model_params
        ):
            return name
    return None


def _cells_of(cases: Sequence[Case]) -> dict[str, Cell]:
    """Return a cell per model with results or failures, by model name."""
    return {
        name: competitor.cell for case in cases for name, competitor in case.competitors.items()
    }


def _spells_out(variant: Variant, key: str, options: Mapping[str, Any]) -> bool:
    """Return True if a variant has this key and only options from these."""
    return variant.key == key and all(
        option in options and _is(options[option], value)
        for option, value in variant.options.items()
    )


def _is(value: Any, requested_value: Any) -> bool:
    """Return True if two values are equal, also if a number is written differently."""
    try:
        return float(value) == float(requested_value)
    except (TypeError, ValueError):
        return str(value).lower() == str(requested_value).lower()
