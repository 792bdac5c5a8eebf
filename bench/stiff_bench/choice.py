"""A catalogue line with the options that were set."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any, Generic

from stiff_bench.option_word import join_word
from stiff_bench.options import options_of
from stiff_bench.registry import Info
from stiff_protocols.contract import KnowsWhatIsMissing
from stiff_protocols.errors import ConfigError


@dataclass(frozen=True)
class Choice(Generic[Info]):
    """A catalogue line with the options that were set.

    Attributes:
        info: the line.
        cls: its class.
        params: what was set; the rest is default.
        context: arguments that do not belong to the result's identity (the device).
    """

    info: Info
    cls: type
    params: dict[str, Any]
    context: dict[str, Any]

    @property
    def identity(self) -> dict[str, Any]:
        """Every option and its value, defaults too, but for the context: what a key hashes.

        A default spelled out is the same result, and a default that changes is another one.
        """
        defaults = {name: option.default for name, option in options_of(self.cls).items()}
        merged = {**defaults, **self.params}
        return {
            name: value if _is_json(value) else str(value)
            for name, value in merged.items()
            if name not in self.context
        }

    @property
    def options_text(self) -> str:
        """What was set, for people: "name=value, ..."; "" for all defaults."""
        return ", ".join(f"{name}={value}" for name, value in sorted(self.params.items()))

    @property
    def name(self) -> str:
        """Key with every option that differs from its default: a word of the command line."""
        options = options_of(self.cls)
        changed = [
            f"{name}={value}"
            for name, value in sorted(self.params.items())
            if value != options[name].default
        ]
        return join_word(self.info.key, changed)

    def missing(self) -> str:
        """Return why this cannot be used here, with its options; "" where it can."""
        if issubclass(self.cls, KnowsWhatIsMissing):
            return str(self.make().missing())
        return self.info.missing()

    def make(self) -> Any:
        """Return a new object.

        Raises:
            ConfigError: the constructor, which may be a stranger's, refuses.
        """
        for name, option in options_of(self.cls).items():
            if option.required and name not in {**self.params, **self.context}:
                raise ConfigError(f"{self.info.key!r} needs --set {self.info.key}.{name}=...")
        try:
            return self.cls(**self.params, **self.context)
        except Exception as error:
            raise ConfigError(
                f"{self.info.key!r} cannot be made: {type(error).__name__}: {error}"
            ) from error


def _is_json(value: object) -> bool:
    """Say whether JSON has the value: it has no infinity and no NaN."""
    if isinstance(value, float):
        return math.isfinite(value)
    return isinstance(value, str | int | type(None))
