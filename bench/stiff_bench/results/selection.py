"""Select stored results by the names of models, data sets, protocols and conditions.

`BoardSettings` selects the results of a study's leaderboard.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from itertools import chain
from typing import Any

from pydantic import ConfigDict
from pydantic.dataclasses import dataclass as pydantic_dataclass

from stiff_bench.results.load import Task, model_names
from stiff_bench.store.names import OPTION_MARK, Variant
from stiff_protocols.contract.errors import unknown_name
from stiff_protocols.contract.record import Fit


@pydantic_dataclass(frozen=True, config=ConfigDict(extra="forbid"))
class BoardSettings:
    """Settings of a study's leaderboard.

    Attributes:
        protocol: word of the protocol whose errors count.
        metric: metric of the main score, on simulated robots.
        few: heading -> word of a protocol with fewer poses.
        controls: model -> the physics, teacher or variant that it is compared with.
        extras: models that need more packages, in a separate table.
        variants: models in a separate table, over the data on which they ran.
        fresh: name of the study of fresh robots, in a folder next to this one; "" for none.
    """

    protocol: str
    metric: str = "norm"
    few: Mapping[str, str] = field(default_factory=dict)
    controls: Mapping[str, str] = field(default_factory=dict)
    extras: tuple[str, ...] = ()
    variants: tuple[str, ...] = ()
    fresh: str = ""


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

    def models_of(self, tasks: Iterable[Task]) -> list[str]:
        """Return the names of the selected models of tasks.

        Raises:
            ConfigError: a name has no results.
        """
        names = model_names(tasks)
        matches = [[name for name in names if matches_key(word, name)] for word in self.models]
        for word, of_word in zip(self.models, matches, strict=True):
            if not of_word:
                raise unknown_name("model with results", word, names)
        return sorted({*chain.from_iterable(matches)}) if matches else names

    def tasks_of(self, tasks: Sequence[Task]) -> list[Task]:
        """Return the tasks of the selected data sets, protocols and conditions.

        Raises:
            ConfigError: a name has no results.
        """
        chosen = list(tasks)
        for kind in ("dataset", "protocol", "condition"):
            words = getattr(self, f"{kind}s")
            for word in words:
                if not any(_is_of(task, kind, word) for task in tasks):
                    valid_words = {getattr(task.name, kind) for task in tasks} - {""}
                    raise unknown_name(f"{kind} with results", word, valid_words)
            if words:
                chosen = [task for task in chosen if any(_is_of(task, kind, w) for w in words)]
        return chosen


EVERYTHING = Selection()


def _is_of(task: Task, kind: str, word: str) -> bool:
    """Return True if a word selects a task's data set, protocol or condition."""
    if kind == "condition":
        return word == task.name.condition
    key, options = getattr(task.fit, kind), getattr(task.fit, f"{kind}_params")
    return matches_key(word, getattr(task.name, kind)) or _spells_out(
        Variant.of_word(word), key, options
    )


def matches_key(word: str, name: str) -> bool:
    """Return True if a word is a name, or the key of a name with options."""
    return name == word or name.startswith(f"{word}{OPTION_MARK}")


def resolve_model_name(word: str, tasks: Sequence[Task]) -> str:
    """Return the stored name of a model that a user named.

    Defaults may be written out, as for `bench run`: "knn@neighbours=5" is stored as "knn". The
    defaults are taken from the results.

    Raises:
        ConfigError: the model has no results.
    """
    fits = _fits_of(tasks)
    name = word if word in fits else find_model(Variant.of_word(word), tasks)
    if name is None:
        raise unknown_name("model with results", word, fits)
    return name


def find_model(variant: Variant, tasks: Sequence[Task]) -> str | None:
    """Return the stored name of the model with these options; None: no results.

    The options may include defaults, as in `resolve_model_name`.
    """
    for name, fit in sorted(_fits_of(tasks).items()):
        option_names = Variant.of_stored_name("", name, fit.model_params).options.keys()
        if option_names <= variant.options.keys() and _spells_out(
            variant, fit.model, fit.model_params
        ):
            return name
    return None


def _fits_of(tasks: Sequence[Task]) -> dict[str, Fit]:
    """Return a fit per model with results or failures, by model name."""
    return {name: stored.fit for task in tasks for name, stored in task.models.items()}


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
