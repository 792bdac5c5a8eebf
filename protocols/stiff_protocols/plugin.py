"""The catalogue line of a model, a data set or a protocol.

The target is "module:Class", imported only when the entry is used, or the class itself.
"""

from __future__ import annotations

import importlib
from dataclasses import dataclass
from typing import Any

from stiff_protocols.errors import ConfigError

STIFFNESS = "stiffness"


@dataclass(frozen=True, kw_only=True)
class PluginInfo:
    """What is common to every catalogue line.

    Attributes:
        key: the word used on the command line.
        target: "module:Class", or the class.
        summary: one line for `bench list`.
        reference: where the definition comes from.
    """

    key: str
    target: str | type
    summary: str
    reference: str = ""

    def load(self) -> Any:
        """Import and return the class.

        Raises:
            ConfigError: the target cannot be imported.
        """
        if isinstance(self.target, type):
            return self.target
        if not isinstance(self.target, str):
            raise ConfigError(f"{self.key!r}: {self.target!r} is no class and no module:Class")
        return _imported(self.key, self.target)


def _imported(key: str, target: str) -> Any:
    module, _, name = target.partition(":")
    try:
        return getattr(importlib.import_module(module), name)
    except (ImportError, AttributeError) as error:
        raise ConfigError(f"{key!r}: cannot import {target!r}: {error}") from error


@dataclass(frozen=True, kw_only=True)
class ModelInfo(PluginInfo):
    """A model family.

    Attributes:
        uses_validation: the model needs rows that choose an epoch. Where it does not, a
            protocol's inner validation rows are given to it as training rows.
    """

    uses_validation: bool = False


@dataclass(frozen=True, kw_only=True)
class DatasetInfo(PluginInfo):
    """A data set.

    Attributes:
        kind: "simulated" or "measured"; printed with every table.
        task: "stiffness", or what else the deflections are ("pose-error"); tables of another
            task say so, and no leaderboard of stiffness models holds them.
        caveats: printed under every table that contains the data set.
        published: name of the table in `results/published` that belongs beneath; "" for none.
        card: the data card, a path inside the package `stiff_datasets`; "" for none.
        missing_because: "module:function" that returns why there is nothing to load yet, or "".
    """

    kind: str
    task: str = STIFFNESS
    caveats: tuple[str, ...] = ()
    published: str = ""
    card: str = ""
    missing_because: str = ""

    @property
    def label(self) -> str:
        """Kind, and the task where it is not stiffness."""
        return self.kind if self.task == STIFFNESS else f"{self.kind} {self.task}, not stiffness"

    def missing(self) -> str:
        """Return why the data set cannot be loaded yet; "" where it can.

        Raises:
            ConfigError: the function that knows cannot be imported.
        """
        return str(_imported(self.key, self.missing_because)()) if self.missing_because else ""


@dataclass(frozen=True, kw_only=True)
class ProtocolInfo(PluginInfo):
    """A protocol.

    Attributes:
        warning: printed above every table made under it; "" for none.
    """

    warning: str = ""
