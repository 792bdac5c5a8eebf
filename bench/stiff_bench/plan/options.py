"""Turn words of a command line into catalogue lines with typed options.

The type of an option is the annotation of the constructor argument (with `annotated_types`
bounds), or the type of its default if it has no annotation. Words are split only here; later code
uses the typed `Choice`.
"""

from __future__ import annotations

import functools
import inspect
import math
import os
import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, is_dataclass, replace
from itertools import chain
from pathlib import Path
from typing import Any, Generic, Literal, get_args, get_origin, get_type_hints

from pydantic import PydanticUserError, TypeAdapter, ValidationError

from stiff_bench.plan.registry import EVERY_MODEL, Info, Kind, Registry
from stiff_bench.store.names import Variant, split_word
from stiff_datasets.dataset_catalog import MEASURED_FILE
from stiff_datasets.measured.data_card import read_card
from stiff_datasets.measured.file_options import FileOptions
from stiff_protocols.contract.errors import ConfigError, describe_error, unknown_name
from stiff_protocols.contract.plugin import DatasetInfo, Grid, ModelInfo, Range
from stiff_protocols.contract.protocol_base import EvaluationProtocol
from stiff_protocols.contract.stiffness_model import offers
from stiff_protocols.contract.types import BenchmarkData, Robot


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
        """Return whether it has no default."""
        return self.default is inspect.Parameter.empty

    @property
    def type_text(self) -> str:
        """The type as a user reads it."""
        try:
            schema = TypeAdapter(self.annotation).json_schema()
        except PydanticUserError:
            return str(self.annotation)  # a type of a third-party class
        return " or ".join(_schema_text(part) for part in schema.get("anyOf", [schema]))


@functools.cache
def options_of(cls: type) -> Mapping[str, Option]:
    """Return the constructor's options by name (cached)."""
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


def parse_option(source_text: str, key: str, cls: type, name: str, value: Any) -> Any:
    """Turn a value, or its text, into a value of the option's type that can be stored.

    `source_text` is the text of the user, for messages. `key` is the key of the catalogue line,
    `cls` its class.

    Raises:
        ConfigError: the option does not exist, or its value is wrong.
    """
    options = options_of(cls)
    if name not in options:
        raise ConfigError(f"{source_text}: {unknown_name(f'{key} option', name, options)}")
    option, given = options[name], os.fspath(value) if isinstance(value, os.PathLike) else value
    if option.default is None and str(given).lower() == "none":
        return None
    is_text = isinstance(given, str)
    if is_text and get_origin(option.annotation) is Literal:  # pydantic takes no text for a number
        words = {str(word): word for word in get_args(option.annotation)}
        if given in words:
            return words[given]
    validate = TypeAdapter.validate_strings if is_text else TypeAdapter.validate_python
    try:
        parsed_value = validate(TypeAdapter(option.annotation), given)
    except PydanticUserError:
        raise ConfigError(
            f"{source_text}: {name} is a {option.type_text}, which no text gives"
        ) from None
    except ValidationError as error:
        value_errors = (item for item in error.errors() if item["type"] == "value_error")
        # pydantic's own words are for programmers
        reasons = "".join(f": {item['ctx']['error']}" for item in value_errors)
        wrong = f"{source_text}: invalid {name} {given!r}{reasons}"
        raise ConfigError(f"{wrong} (valid: {option.type_text})") from None
    if isinstance(parsed_value, float) and not math.isfinite(parsed_value):
        raise ConfigError(f"{source_text}: {given!r} is not finite (valid: {option.type_text})")
    return parsed_value


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
    texts = {}
    for base in reversed(cls.__mro__):
        doc = inspect.cleandoc(vars(base).get("__doc__") or "")
        for section in re.findall(r"^(?:Attributes|Args):\n((?: {4}.*\n?|\n)+)", doc, re.M):
            for name, text in re.findall(r"^ {4}(\w+): (.*(?:\n {8}.*)*)", section, re.M):
                texts[name] = " ".join(text.split())
    return texts


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
        """Return every option and its value, with defaults and without the context.

        The key of a result hashes it. A default that is given explicitly is the same result; a
        changed default is another result. Options in the `added_later` of the class are omitted
        at their default, so that older results keep their keys and seeds.
        """
        defaults = {name: option.default for name, option in options_of(self.cls).items()}
        later = getattr(self.cls, "added_later", ())
        stored_options = {}
        for name, value in {**defaults, **self.params}.items():
            if name in self.context or (name in later and value == defaults[name]):
                continue
            plain = isinstance(value, str | int | float | type(None))
            if not plain or (isinstance(value, float) and not math.isfinite(value)):
                value = str(value)  # JSON has no infinity and no NaN
            stored_options[name] = value
        return stored_options

    @classmethod
    def of(cls, info: Info, params: Mapping[str, Any] | None = None) -> Choice[Info]:
        """Load the class of a line, and set these options of it.

        Raises:
            ConfigError: the class cannot be loaded.
        """
        return cls(info, info.load(), dict(params or {}), {})

    @classmethod
    def of_stored(cls, info: Info, identity: Mapping[str, Any]) -> Choice[Info]:
        """Return the choice for the `identity` in a stored fit.

        Raises:
            ConfigError: the option or its value does not exist any more.
        """
        usual = cls.of(info).identity
        changed = {k: v for k, v in identity.items() if k not in usual or usual[k] != v}
        return cls.of(
            info,
            {k: parse_option(info.key, info.key, info.load(), k, v) for k, v in changed.items()},
        )

    @property
    def options_text(self) -> str:
        """Return the options that were set: "name=value, ..."; "" for all defaults."""
        return ", ".join(f"{name}={value}" for name, value in sorted(self.params.items()))

    @functools.cached_property
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
            ConfigError: the constructor, which may be third-party code, raises an error.
        """
        for name, option in options_of(self.cls).items():
            if option.required and name not in {**self.params, **self.context}:
                raise ConfigError(f"{self.info.key!r} needs its option: {self.info.key}@{name}=...")
        try:
            return self.cls(**self.params, **self.context)
        except ConfigError as error:
            raise ConfigError(f"{self.name}: {error}") from error
        except Exception as error:
            raise ConfigError(
                f"{self.info.key!r} cannot be made: {describe_error(error)}"
            ) from error


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


def parse_settings(
    settings: Sequence[str], classes: Mapping[str, type]
) -> dict[str, dict[str, Any]]:
    """Turn ``KEY.option=value`` words into checked values by key and option.

    `classes` has every key of the run and its class.

    Raises:
        ConfigError: a word is malformed, names what is not in the run, or its value is wrong.
    """
    parsed: dict[str, dict[str, Any]] = {key: {} for key in classes}
    for setting in settings:
        target, equals, text = setting.partition("=")
        key, dot, name = target.rpartition(".")
        if not (equals and dot and key and name):
            raise ConfigError(f"--set {setting!r}: expected KEY.OPTION=VALUE")
        if key not in classes:
            raise ConfigError(f"--set {setting!r}: {unknown_name('key', key, classes)} in this run")
        _parse_setting(parsed[key], f"--set {setting!r}", key, classes[key], name, text)
    return parsed


def _word_options(
    kind: Kind, word: str, key: str, parts: Sequence[str], cls: type
) -> dict[str, Any]:
    """Turn the ``OPTION=VALUE`` parts of a word into checked values."""
    parsed: dict[str, Any] = {}
    try:
        for part in parts:
            name, equals, text = part.partition("=")
            if not (equals and name):
                raise ConfigError(f"{word!r}: expected KEY@OPTION=VALUE")
            if parsed and name not in options_of(cls):
                unknown = unknown_name(f"{key} option", name, options_of(cls))
                raise ConfigError(f"{word!r}: {unknown}; an @ inside a value is doubled: @@")
            _parse_setting(parsed, repr(word), key, cls, name, text)
    except ConfigError as error:
        error.argument = kind
        raise
    return parsed


def _parse_setting(
    parsed: dict[str, Any], source_text: str, key: str, cls: type, name: str, text: str
) -> None:
    value = parse_option(source_text, key, cls, name, text)
    if name in parsed:
        raise ConfigError(f"{source_text}: {key}.{name} is set twice")
    parsed[name] = value


def chosen(
    given: Mapping[Kind, Sequence[str | Choice[Any]]], settings: Sequence[str], registry: Registry
) -> dict[Kind, list[Choice[Any]]]:
    """Return the choices for words; options in a word have priority over `settings`.

    Args:
        given: of each kind, ``KEY@OPTION=VALUE@...``, or what is chosen already; the model "all" is
            every registered model.
        settings: ``KEY.option=value`` words; each must be of a key among the words.
        registry: knows the keys.

    Raises:
        ConfigError: a key, an option or a value is unknown or wrong.
    """
    if EVERY_MODEL in given.get("model", ()):
        models = [registry.models if word == EVERY_MODEL else [word] for word in given["model"]]
        given = {**given, "model": [*chain.from_iterable(models)]}
    keys = {
        split_word(word)[0]: kind
        for kind, words in given.items()
        for word in words
        if isinstance(word, str)
    }
    infos = {key: registry.find(key, kind) for key, kind in keys.items()}
    classes = {key: info.load() for key, info in infos.items()}
    params = parse_settings(settings, classes)

    def choice(kind: Kind, word: str | Choice[Any]) -> Choice[Any]:
        if isinstance(word, Choice):
            return word
        key, parts = split_word(word)
        options = params[key] | _word_options(kind, word, key, parts, classes[key])
        return Choice(infos[key], classes[key], options, {})

    return {kind: [choice(kind, word) for word in words] for kind, words in given.items()}


def chosen_dataset(word: str, settings: Sequence[str], registry: Registry) -> Choice[DatasetInfo]:
    """Return one data set with its options.

    Raises:
        ConfigError: the key, an option or a value is unknown or wrong.
    """
    return chosen({"dataset": (word,)}, settings, registry)["dataset"][0]


def measured_file(path: Path, robot: Robot, options: FileOptions) -> Choice[DatasetInfo]:
    """Return the data set of a file of measured samples, which has the file's name.

    Raises:
        DataError: the file's data card cannot be read.
    """
    context = {"csv": path, "robot": robot, "options": options}
    caveat = f"{path.name} is simulated, never measured, as its data card says."
    kind = read_card(path).kind
    caveats = (caveat,) if kind == "simulated" else ()
    info = replace(MEASURED_FILE, key=path.name, kind=kind, caveats=caveats)
    return replace(Choice.of(info), context=context)


@dataclass(frozen=True)
class HeldData:
    """A data set that is in memory."""

    data: BenchmarkData

    def load(self) -> BenchmarkData:
        """Return it."""
        return self.data


OWN_DATA = DatasetInfo(
    key="own-data", target=HeldData, kind="unknown", summary="samples from memory"
)


def held_data(data: BenchmarkData, name: str, info: DatasetInfo = OWN_DATA) -> Choice[DatasetInfo]:
    """Return the data set of this name that is in memory; `info` says what it is."""
    return Choice(replace(info, key=name, target=HeldData), HeldData, {}, {"data": data})
