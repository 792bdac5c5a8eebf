"""Names: of models with options, of comparisons, and in which order they stand.

A key with options is one word, ``KEY@OPTION=VALUE@OPTION=VALUE``: `kr10-twin@specimen=3`. An @ in
a value, which may be such a word itself, is doubled: `cross-robot@source=ur5-twin@@seed=1`.
"""

from __future__ import annotations

import re
from collections import defaultdict
from collections.abc import Callable, Hashable, Iterable, Mapping
from dataclasses import dataclass, field
from typing import Any, TypeVar

Item = TypeVar("Item")
Key = TypeVar("Key", bound=Hashable)


def grouped(items: Iterable[Item], key: Callable[[Item], Key]) -> dict[Key, list[Item]]:
    """Group items by key; keys and items are in the order of their appearance."""
    groups: defaultdict[Key, list[Item]] = defaultdict(list)
    for item in items:
        groups[key(item)].append(item)
    return dict(groups)


def natural_key(text: str) -> str:
    """Return a sort key that orders numbers by size: "n = 5" before "n = 40"."""
    return re.sub("[0-9]+", lambda number: number[0].lstrip("0").zfill(10), text)


OPTION_MARK = "@"
"""Parts the options from the key and from each other in a word; doubled, it is part of a value."""
_HELD = "\0"  # stands for a doubled mark; no command line holds it


def split_word(word: str) -> tuple[str, list[str]]:
    """Return the key and the ``OPTION=VALUE`` parts of what a user wrote.

    What follows the command line has a `Variant`, a stored fit its options: neither is split.
    """
    key, *settings = (part.replace(_HELD, OPTION_MARK) for part in _held(word).split(OPTION_MARK))
    return key, settings


def _held(word: str) -> str:
    return word.replace(2 * OPTION_MARK, _HELD)


@dataclass(frozen=True)
class Variant:
    """A model, data set or protocol with options.

    Attributes:
        key: key in the catalogue.
        options: options that differ from their defaults.
    """

    key: str
    options: Mapping[str, Any] = field(default_factory=dict)

    @classmethod
    def of_word(cls, word: str) -> Variant:
        """Return the key and option texts of a word that selects stored results."""
        key, parts = split_word(word)
        return cls(key, {name: text for name, _, text in (part.partition("=") for part in parts)})

    @classmethod
    def of_stored_name(cls, key: str, name: str, options: Mapping[str, Any]) -> Variant:
        """Return the options of a stored fit that its name contains."""
        parts = f"{_held(name)}{OPTION_MARK}"
        shown_options = {
            k: v for k, v in options.items() if f"{_held(_part(k, v))}{OPTION_MARK}" in parts
        }
        return cls(key, shown_options)

    @property
    def name(self) -> str:
        """Name under which results are stored; `split_word` splits it again."""
        return self.key + "".join(_part(*option) for option in sorted(self.options.items()))


def without_options(name: str, *options: str) -> str:
    """Return a name without some of its options."""
    key, *parts = _held(name).split(OPTION_MARK)
    remaining = [part for part in parts if part.partition("=")[0] not in options]
    return OPTION_MARK.join([key, *remaining]).replace(_HELD, 2 * OPTION_MARK)


def _part(option: str, value: object) -> str:
    return OPTION_MARK + f"{option}={value}".replace(OPTION_MARK, 2 * OPTION_MARK)


SHORT = 8
"""Number of characters of a hash that distinguish data sets."""


@dataclass(frozen=True, order=True)
class TaskName:
    """Identify results that are comparable.

    Attributes:
        dataset, protocol, condition: as shown.
        seed: of the run's splits.
        data_sha256: hash of the data set's numbers.
        source_sha256: of the other robot's data that source domains come from; "" for none.
    """

    dataset: str
    protocol: str
    condition: str
    seed: int
    data_sha256: str
    source_sha256: str = ""

    @property
    def text(self) -> str:
        """Data set, protocol and condition for people."""
        return " | ".join(filter(None, (self.dataset, self.protocol, self.condition)))


def label_parts(names: Iterable[TaskName]) -> dict[TaskName, tuple[str, ...]]:
    """Return the parts of each name for people: data set, protocol, condition, and what differs.

    Tasks with one text have other seeds or other data (one file name, say); the seed or the
    hash that tells them apart stands there then, and only then.
    """
    parts = {}
    for same_text in grouped(dict.fromkeys(names), lambda name: name.text).values():
        differing = [
            kind
            for kind in ("seed", "data_sha256", "source_sha256")
            if len({getattr(name, kind) for name in same_text}) > 1
        ]
        for name in same_text:
            apart = {
                "seed": f"seed {name.seed}",
                "data_sha256": f"data {name.data_sha256[:SHORT]}",
                "source_sha256": f"source data {name.source_sha256[:SHORT] or 'none'}",
            }
            words = (name.dataset, name.protocol, name.condition, *map(apart.get, differing))
            parts[name] = tuple(word for word in words if word)
    return parts


def labels(names: Iterable[TaskName]) -> dict[TaskName, str]:
    """Return each name in one text, as `TaskName.text` has it, with what tells it apart."""
    return {name: " | ".join(parts) for name, parts in label_parts(names).items()}
