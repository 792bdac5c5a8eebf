"""Which stored model a word of the command line stands for."""

from __future__ import annotations

import difflib
from collections.abc import Iterable, Mapping, Sequence
from pathlib import Path
from typing import Any

from stiff_bench.collected import Contest, competitor_names
from stiff_bench.option_word import OPTION_MARK, split_word
from stiff_protocols.errors import ConfigError


def competitor_meant(word: str, contests: Sequence[Contest], folder: Path) -> str:
    """Return the name of the model with results that a word stands for.

    A word may spell out defaults, as for `bench run`: "knn@neighbours=5" is what is stored as
    "knn". The defaults are those that the results were made with.

    Raises:
        ConfigError: there are no results of it in the folder.
    """
    known = competitor_names(contests)
    if word in known:
        return word
    key, settings = split_word(word)
    said = dict(_option_and_value(settings))
    same_key = [name for name in known if split_word(name)[0] == key]
    for name in same_key:
        if _spells_out(said, name, contests):
            return name
    raise ConfigError(_no_results(word, known, same_key, folder))


def _option_and_value(settings: Iterable[str]) -> list[tuple[str, str]]:
    return [(name, value) for name, _, value in (one.partition("=") for one in settings)]


def _spells_out(said: Mapping[str, str], name: str, contests: Iterable[Contest]) -> bool:
    """Say whether options are those of a name and, beyond them, its defaults alone."""
    named = [option for option, _ in _option_and_value(split_word(name)[1])]
    options = next(
        (
            result.cell.model_params
            for contest in contests
            if name in contest.competitors
            for result in contest.results(name)
        ),
        {},
    )
    return all(option in said for option in named) and all(
        option in options and _is(options[option], text) for option, text in said.items()
    )


def _is(value: Any, text: str) -> bool:
    """Say whether a text is a value, however its number was written."""
    try:
        return float(value) == float(text)
    except (TypeError, ValueError):
        return str(value).lower() == text.lower()


def _no_results(word: str, known: Sequence[str], same_key: Sequence[str], folder: Path) -> str:
    if same_key:
        options = "" if OPTION_MARK in word else " with its default options"
        there = ", ".join(map(repr, same_key))
        return f"no results of {word!r}{options} in {folder}; there are results of {there}"
    near = difflib.get_close_matches(word, known, n=1)
    hint = f"; did you mean {near[0]!r}?" if near else ""
    return f"no results of {word!r} in {folder}{hint} (there are: {', '.join(known)})"
