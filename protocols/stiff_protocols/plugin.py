"""The catalogue line of a model, a data set or a protocol.

The target is "module:Class", imported only when the entry is used, or the class itself.
"""

from __future__ import annotations

import importlib
from dataclasses import dataclass
from typing import Any

from stiff_protocols.errors import ConfigError


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
        module, _, name = self.target.partition(":")
        try:
            return getattr(importlib.import_module(module), name)
        except (ImportError, AttributeError) as error:
            raise ConfigError(f"{self.key!r}: cannot import {self.target!r}: {error}") from error


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
        caveats: printed under every table that contains the data set.
        published: name of the table in `results/published` that belongs beneath; "" for none.
    """

    kind: str
    caveats: tuple[str, ...] = ()
    published: str = ""


@dataclass(frozen=True, kw_only=True)
class ProtocolInfo(PluginInfo):
    """A protocol.

    Attributes:
        warning: printed above every table made under it; "" for none.
    """

    warning: str = ""
