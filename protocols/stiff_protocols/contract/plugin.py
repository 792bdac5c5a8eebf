"""The catalogue entry of a model, a data set or a protocol.

The target is "module:Class", imported only when the entry is used, or the class itself.
"""

from __future__ import annotations

import importlib
import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any, Literal, get_args

from stiff_protocols.contract.errors import ConfigError

DEFAULT_GRID = "default"
"""Name of the grid that is searched by default."""


@dataclass(frozen=True)
class Range:
    """All numbers from `low` to `high`, both included; integers if both are integers.

    With `log` they are drawn evenly on a logarithmic scale.
    """

    low: float
    high: float
    log: bool = False

    @property
    def is_integer(self) -> bool:
        """True if the option takes integers."""
        return isinstance(self.low, int) and isinstance(self.high, int)


Grid = Mapping[str, Sequence[Any] | Range]
"""Option -> its candidates."""


def in_words(params: Mapping[str, Any]) -> str:
    """Return options with their values as readable text."""
    return ", ".join(f"{name}={value}" for name, value in params.items())


@dataclass(frozen=True, kw_only=True)
class PluginInfo:
    """Common fields of every catalogue entry.

    Attributes:
        key: name on the command line.
        target: "module:Class", imported when it is used, or the class.
        summary: one line for `bench list`.
        reference: source of the definition.
        missing_because: "module:function" that returns why the entry cannot be used here yet (data
            not fetched, an optional package not installed), or "".
    """

    key: str
    target: str | type
    summary: str
    reference: str = ""
    missing_because: str = ""

    def missing(self) -> str:
        """Return why the entry cannot be used yet; "" if it can."""
        return str(_imported(self.key, self.missing_because)()) if self.missing_because else ""

    def load(self) -> Any:
        """Import and return the class; ConfigError if that fails."""
        if isinstance(self.target, type):
            return self.target
        if not isinstance(self.target, str):
            raise ConfigError(
                f"{self.key!r}: the target {self.target!r} is not valid (give a class or a text "
                "module:Class)"
            )
        return _imported(self.key, self.target)


def _imported(key: str, target: str) -> Any:
    module, _, name = target.partition(":")
    try:
        return getattr(importlib.import_module(module), name)
    except (Exception, SystemExit) as error:  # third-party modules may raise anything on import
        raise ConfigError(
            f"{key!r}: cannot import {target!r}: {type(error).__name__}: {error}"
        ) from error


ModelKind = Literal["physics", "Gaussian process", "network", "hybrid", "other"]
"""What a model is made of; hybrid: physics and a learned part."""


@dataclass(frozen=True, kw_only=True)
class Citation:
    """The paper, report or software that defines a method.

    Attributes:
        authors: full names, family name last; empty: unknown.
        year: of publication.
        title: title.
        url: address, such as https://doi.org/...; "" for none.
    """

    authors: Sequence[str] = ()
    year: int
    title: str
    url: str = ""

    @property
    def text(self) -> str:
        """Return authors and year, such as "Wu et al., 2024"; without authors the title."""
        families = [name if name[0].islower() else name.split()[-1] for name in self.authors]
        if len(families) > 2:
            families = [f"{families[0]} et al."]
        return f"{' and '.join(families) or self.title}, {self.year}"

    def bibtex(self, key: str) -> str:
        """Return the entry of a BibTeX file; signs with a meaning in TeX are left out."""
        texts = {"author": " and ".join(self.authors), "title": self.title, "year": str(self.year)}
        fields = {name: re.sub(r"[{}\\%$#&~^\s]+", " ", text) for name, text in texts.items()}
        fields["url"] = re.sub(r"[{}\\\s]", "", self.url)
        lines = [f"  {name} = {{{text.strip()}}}," for name, text in fields.items() if text]
        return "\n".join([f"@misc{{{re.sub(r'[^A-Za-z0-9]+', '-', key)},", *lines, "}"])


@dataclass(frozen=True, kw_only=True)
class ModelInfo(PluginInfo):
    """A model family.

    Attributes:
        kind: what the model is made of.
        citation: paper or report that defines the method; None if there is none.
        uses_validation: the model needs rows that choose an epoch. If not, it gets a protocol's
            inner validation rows as training rows.
        quick: option values with which a fit takes seconds, for the conformance suite.
        grids: name -> option -> candidates, for protocols that tune; "default" is searched by
            default.
        version: part of a fit's identity. Raise it with each change of the model's numbers. A
            plugin need not raise it: its files are also part of the identity.
        library: a distribution whose installed version belongs to the identity, because it
            implements the model; "" for none.
        equation: equation of the predicted deflection d, in plain text; "" for none.

    Raises:
        ConfigError: `version` is not a positive integer, `library` is not a text, or `kind` is
            unknown.
    """

    kind: ModelKind = "other"
    citation: Citation | None = None
    uses_validation: bool = False
    quick: Mapping[str, Any] = field(default_factory=dict)
    grids: Mapping[str, Grid] = field(default_factory=dict)
    version: int = 1
    library: str = ""
    equation: str = ""

    def __post_init__(self) -> None:
        if type(self.version) is not int or self.version < 1:
            raise ConfigError(
                f"{self.key!r}: version {self.version!r} is not valid (use 1, 2, ...)"
            )
        if not isinstance(self.library, str):
            raise ConfigError(
                f"{self.key!r}: library {self.library!r} is not a text (use the name of a "
                "distribution, such as 'scikit-learn')"
            )
        if self.kind not in get_args(ModelKind):
            valid = ", ".join(get_args(ModelKind))
            raise ConfigError(f"{self.key!r}: kind {self.kind!r} is not valid (use {valid})")


@dataclass(frozen=True, kw_only=True)
class ModelFamily:
    """A catalogue entry for any number of models whose keys have the same prefix.

    Attributes:
        prefix: beginning of the keys, e.g. "sklearn:".
        target: "module:function"; the function turns a key into its ModelInfo and raises
            ConfigError for an unknown key.
        example: a complete key.
        summary: one line for `bench list`.
    """

    prefix: str
    target: str
    example: str
    summary: str

    def member(self, key: str) -> ModelInfo:
        """Return the catalogue entry of a key with this prefix; ConfigError if unknown."""
        line = _imported(self.prefix, self.target)(key)
        assert isinstance(line, ModelInfo)  # families are built in, not plugins
        return line


@dataclass(frozen=True, kw_only=True)
class DatasetInfo(PluginInfo):
    """A data set.

    Attributes:
        kind: "simulated", "measured" or "unknown"; printed with every table.
        caveats: printed under every table that contains the data set.
        published: name of the table in `results/published` to print below; "" for none.
        card: the data card, a path inside the package `stiff_datasets`; "" for none.
        licence: licence of measured data, such as "MIT"; "" if it is not stated.
    """

    kind: str
    caveats: tuple[str, ...] = ()
    published: str = ""
    card: str = ""
    licence: str = ""


@dataclass(frozen=True, kw_only=True)
class ProtocolInfo(PluginInfo):
    """A protocol.

    Attributes:
        reasoning: its question, and the reason for its division; for `bench show`.
        warning: printed above every table made under it; "" for none.
    """

    reasoning: str = ""
    warning: str = ""
