"""Options of models, data sets and protocols: read off their constructors, checked on the way in.

An option's type is the constructor argument's annotation (with `annotated_types` bounds), or the
type of its default where there is no annotation.
"""

from __future__ import annotations

import functools
import inspect
import math
import os
import re
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, is_dataclass
from typing import Any, Generic, Literal, get_args, get_origin, get_type_hints

from pydantic import PydanticUserError, TypeAdapter, ValidationError

from stiff_bench.plan.registry import Info
from stiff_bench.store.names import Variant
from stiff_protocols.contract.errors import ConfigError, said_by, unknown_name
from stiff_protocols.contract.plugin import DatasetInfo, Grid, ModelInfo, ProtocolInfo, Range
from stiff_protocols.contract.protocol_base import EvaluationProtocol
from stiff_protocols.contract.stiffness_model import offers


@dataclass(frozen=True)
class Option:
    """A constructor argument.

    Attributes:
        name: of the argument.
        annotation: its type.
        default: its default; `inspect.Parameter.empty` where it has none.
        description: from the class's docstring.
    """

    name: str
    annotation: Any
    default: Any
    description: str

    @property
    def required(self) -> bool:
        """Whether it has no default."""
        return self.default is inspect.Parameter.empty

    @property
    def type_text(self) -> str:
        """The type as a user reads it."""
        try:
            schema = TypeAdapter(self.annotation).json_schema()
        except PydanticUserError:
            return str(self.annotation)  # a stranger's own type
        return " or ".join(_schema_text(part) for part in schema.get("anyOf", [schema]))


@functools.cache
def options_of(cls: type) -> Mapping[str, Option]:
    """Return the constructor's options by name; asked for in every cell, read off once."""
    init = cls.__init__  # type: ignore[misc]
    try:
        hints = get_type_hints(cls if is_dataclass(cls) else init, include_extras=True)
    except NameError as error:
        raise ConfigError(f"{cls.__name__}: an annotation cannot be resolved: {error}") from error
    descriptions = _descriptions(cls)
    options = {}
    for name, parameter in inspect.signature(cls).parameters.items():
        if parameter.kind in (parameter.VAR_KEYWORD, parameter.VAR_POSITIONAL):
            continue
        annotation = hints.get(name)
        if annotation is None:
            plain = isinstance(parameter.default, bool | int | float | str)
            annotation = type(parameter.default) if plain else str
        options[name] = Option(name, annotation, parameter.default, descriptions.get(name, ""))
    return options


def parse_option(said: str, key: str, cls: type, name: str, text: str) -> Any:
    """Turn the text of a value into one of an option's type.

    `said` is what the user wrote, for messages; `key` is of the catalogue line, `cls` its class.

    Raises:
        ConfigError: there is no such option, or its value is wrong.
    """
    option = _option(said, key, cls, name)
    if text.lower() == "none" and option.default is None:
        return None
    if get_origin(option.annotation) is Literal:  # pydantic takes no text for a number in it
        words = {str(word): word for word in get_args(option.annotation)}
        if text in words:
            return words[text]
    return _checked(said, option, text, TypeAdapter.validate_strings)


def check_option(said: str, key: str, cls: type, name: str, value: Any) -> Any:
    """Return a value that Python code gave as one of an option's type; see `parse_option`.

    Raises:
        ConfigError: there is no such option, or its value is wrong.
    """
    option = _option(said, key, cls, name)
    if value is None and option.default is None:
        return None
    if isinstance(value, os.PathLike):
        value = os.fspath(value)  # options that name a file are texts
    return _checked(said, option, value, TypeAdapter.validate_python)


def _option(said: str, key: str, cls: type, name: str) -> Option:
    options = options_of(cls)
    if name not in options:
        raise ConfigError(f"{said}: {unknown_name(f'{key} option', name, options)}")
    return options[name]


def _checked(
    said: str, option: Option, given: Any, validate: Callable[[TypeAdapter[Any], Any], Any]
) -> Any:
    """Return what pydantic makes of a value, if a result can store it."""
    name = option.name
    try:
        str(given).encode()
        value = validate(TypeAdapter(option.annotation), given)
    except UnicodeEncodeError:
        raise ConfigError(f"{said}: {given!r} is no UTF-8, which results are stored in") from None
    except PydanticUserError:
        raise ConfigError(f"{said}: {name} is a {option.type_text}, which no text gives") from None
    except ValidationError as error:
        own = (one["ctx"]["error"] for one in error.errors() if one["type"] == "value_error")
        why = "".join(f": {reason}" for reason in own)  # pydantic's words are for programmers
        wrong = f"{said}: {given!r} is no valid {name}{why}"
        raise ConfigError(f"{wrong} (valid: {option.type_text})") from None
    if isinstance(value, float) and not math.isfinite(value):
        raise ConfigError(f"{said}: {given!r} is not finite (valid: {option.type_text})")
    if isinstance(value, int) and not -(2**63) <= value < 2**63:
        raise ConfigError(f"{said}: {given} takes more than the 64 bits that a result stores")
    return value


_BOUNDS = {"minimum": ">=", "exclusiveMinimum": ">", "maximum": "<=", "exclusiveMaximum": "<"}


def _schema_text(schema: Mapping[str, Any]) -> str:
    if "enum" in schema:
        return " | ".join(map(str, schema["enum"]))
    if "const" in schema:
        return str(schema["const"])
    names = {"integer": "whole number", "string": "text", "null": "none", "boolean": "true | false"}
    kind = schema.get("type", "value")
    bounds = [f"{sign} {schema[word]:g}" for word, sign in _BOUNDS.items() if word in schema]
    return f"{names.get(kind, kind)} {' and '.join(bounds)}".rstrip()


def _descriptions(cls: type) -> dict[str, str]:
    """Return the entries of the "Attributes:" or "Args:" sections, base classes first."""
    found = {}
    for base in reversed(cls.__mro__):
        doc = inspect.cleandoc(vars(base).get("__doc__") or "")
        for section in re.findall(r"^(?:Attributes|Args):\n((?: {4}.*\n?|\n)+)", doc, re.M):
            for name, text in re.findall(r"^ {4}(\w+): (.*(?:\n {8}.*)*)", section, re.M):
                found[name] = " ".join(text.split())
    return found


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

        A default spelled out is the same result, and a default that changes is another one. An
        option that the class calls `added_later` is left out where it has its default, so that
        results from before it keep their keys and seeds.
        """
        defaults = {name: option.default for name, option in options_of(self.cls).items()}
        later = getattr(self.cls, "added_later", ())
        found = {}
        for name, value in {**defaults, **self.params}.items():
            if name in self.context or (name in later and value == defaults[name]):
                continue
            plain = isinstance(value, str | int | float | type(None))
            if not plain or (isinstance(value, float) and not math.isfinite(value)):
                value = str(value)  # JSON has no infinity and no NaN
            found[name] = value
        return found

    @classmethod
    def of(cls, info: Info, params: Mapping[str, Any] | None = None) -> Choice[Info]:
        """Load the class of a line, and set these options of it.

        Raises:
            ConfigError: the class cannot be loaded.
        """
        return cls(info, info.load(), dict(params or {}), {})

    @classmethod
    def of_stored(cls, info: Info, identity: Mapping[str, Any]) -> Choice[Info]:
        """Return the choice that has an `identity`, as a stored cell has it.

        Raises:
            ConfigError: there is no such option any more, or no such value of it.
        """
        usual = cls.of(info).identity
        changed = {k: v for k, v in identity.items() if k not in usual or usual[k] != v}
        return cls.of(
            info,
            {k: check_option(info.key, info.key, info.load(), k, v) for k, v in changed.items()},
        )

    @property
    def options_text(self) -> str:
        """What was set, for people: "name=value, ..."; "" for all defaults."""
        return ", ".join(f"{name}={value}" for name, value in sorted(self.params.items()))

    @property
    def name(self) -> str:
        """Key with every option that differs from its default: a word of the command line."""
        options = options_of(self.cls)
        changed = {k: value for k, value in self.params.items() if value != options[k].default}
        return Variant(self.info.key, changed).name

    def missing(self) -> str:
        """Return why this cannot be used here, with its options; "" where it can."""
        if offers(self.cls, "missing"):
            return str(self.make().missing())
        return self.info.missing()

    def make(self) -> Any:
        """Return a new object.

        Raises:
            ConfigError: the constructor, which may be a stranger's, refuses.
        """
        for name, option in options_of(self.cls).items():
            if option.required and name not in {**self.params, **self.context}:
                raise ConfigError(f"{self.info.key!r} needs its option: {self.info.key}@{name}=...")
        try:
            return self.cls(**self.params, **self.context)
        except ConfigError as error:
            raise ConfigError(f"{self.name}: {error}") from error
        except Exception as error:
            raise ConfigError(f"{self.info.key!r} cannot be made: {said_by(error)}") from error


@dataclass(frozen=True)
class TunedChoice(Choice[ModelInfo]):
    """A model that chooses options in its fit.

    Attributes:
        tuner: the protocol that has it do so.
        grid: the candidates; empty if it has none.
    """

    tuner: EvaluationProtocol
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
        """Return a new object that chooses."""
        return self.tuner.tuned(super().make(), self.grid)


@dataclass(frozen=True)
class Chosen:
    """What a run is of, before it is checked."""

    models: Sequence[Choice[ModelInfo]]
    datasets: Sequence[Choice[DatasetInfo]]
    protocols: Sequence[Choice[ProtocolInfo]] = ()
