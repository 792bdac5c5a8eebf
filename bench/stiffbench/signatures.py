"""Make the parameters of a command from the signature and the "Args:" of its function.

A parameter that no word can give, such as a fitted model, is made by a function: the one in its
annotation, or in `MAKERS` for its type. The parameters of this function are options in its place.
"""

from __future__ import annotations

import inspect
import math
import re
import sys
from collections.abc import Callable, Collection, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from types import NoneType, SimpleNamespace, UnionType
from typing import Annotated, Any, Literal, Union, get_args, get_origin, get_type_hints

from cyclopts import Group, Parameter

from stiff_bench.parameter_types import PICTURE, SIZE, Bounds, Form
from stiff_bench.tables.picture_file import check_suffix
from stiff_protocols.contract.errors import ConfigError
from stiffbench.options import MAKERS

ARGUMENTS = ("kind", "number", "name", "key", "file", "a", "b", "folders")
"""Parameters that are given by their place; all others are options."""
SPELLINGS = {
    **{"settings": "set", "equivalence_mm": "equivalence", "fmt": "format"},
    **{"results": "results", "plan_only": "plan"},
}
"""Parameter -> its option, if the name differs; a sequence of `models` is a repeated --model."""
OPTION_GROUPS = {
    "Models and data": (
        *("model", "dataset", "protocol", "condition", "splits", "set", "study", "lite", "against"),
        *("metric", "axis", "coverage", "seed", "plugin", "results", "input"),
    ),
    "Your own data": (
        *("data", "urdf", "robot", "tip", "tcp", "no-torque", "sheet", "pose-tolerance"),
        *("licence", "citation", "source"),
    ),
    "Computation": (
        *("plan", "rerun", "jobs", "threads", "device", "isolate", "timeout", "memory", "dask"),
    ),
    "Output": ("output", "figure", "format", "paper", "verbose"),
}
"""Heading -> options of all commands, in the order of the help page; others come first."""
MANY_OPTIONS = 12
"""A command with fewer options has one list of them."""
SHAPE = re.compile(r"^(\([\w,]+\) (or )?)+")
"""Shape of an array before its description."""
SMALLEST_SIZE = 2**20
"""Bytes; smaller numbers are refused, because their unit is probably missing."""
REQUIRED = inspect.Parameter.empty


@dataclass(frozen=True)
class Option:
    """A parameter of a function.

    Attributes:
        name: name of the parameter.
        hint: its type.
        default: its default, or `REQUIRED`.
        text: description.
    """

    name: str
    hint: Any
    default: Any
    text: str

    @property
    def types(self) -> list[Any]:
        """Return the alternatives of the type and their metadata, without None."""
        parts = get_args(self.hint) if get_origin(self.hint) in (Union, UnionType) else [self.hint]
        pairs = [get_args(part) if get_origin(part) is Annotated else (part,) for part in parts]
        return [part for pair in pairs for part in pair if part is not NoneType]

    @property
    def maker(self) -> Callable[..., Any] | None:
        """Return the function that makes the value; None: a word gives it."""
        makers: list[Callable[..., Any]] = [
            *(part for part in self.types if inspect.isfunction(part)),
            *(MAKERS[part.__name__] for part in self.types if _name(part) in MAKERS),
        ]
        return makers[0] if makers else None

    @property
    def form(self) -> Form:
        """Return the form of a value."""
        return next((part for part in self.types if isinstance(part, Form)), Form(""))

    @property
    def is_argument(self) -> bool:
        """Return whether the parameter is given by its place."""
        return self.name in ARGUMENTS

    @property
    def is_mapping(self) -> bool:
        """Return whether each word is an item of a mapping."""
        return any(get_origin(part) is Mapping for part in self.types)

    @property
    def is_repeated(self) -> bool:
        """Return whether each word is an element of a sequence or mapping."""
        is_sequence = any(get_origin(part) is Sequence for part in self.types)
        return self.is_mapping or (is_sequence and not self.form.valid)

    @property
    def spelling(self) -> str:
        """Return the name of the option, without the hyphens before it."""
        if self.name in SPELLINGS:
            return SPELLINGS[self.name]
        return (self.name.removesuffix("s") if self.is_repeated else self.name).replace("_", "-")

    @property
    def word(self) -> str:
        """Return the name in messages."""
        if self.is_argument:
            return self.form.name or self.name.upper()
        return f"--{self.spelling}"

    @property
    def metavar(self) -> str:
        """Return the placeholder of a value in help pages."""
        if self.choices:
            return "|".join(self.choices)
        names = {int: "N", float: "NUMBER", Path: "FILE"}
        types = [kind for part in self.types for kind in (part, *get_args(part))]
        by_type = [names[kind] for kind in types if kind in names]
        return self.form.name or next(iter(by_type), "NAME")

    @property
    def choices(self) -> tuple[str, ...]:
        """Return the valid words; empty: any word."""
        return next((get_args(part) for part in self.types if get_origin(part) is Literal), ())

    def as_parameter(self, group: Group, options: Mapping[str, Option]) -> inspect.Parameter:
        """Return the parameter for cyclopts, which splits words; `value` reads them."""
        text = spell_options(SHAPE.sub("", self.text), options)
        in_group: dict[str, Any] = {} if self.is_argument else {"group": group}
        is_flag = bool in self.types
        hint: Any = bool | None if is_flag else list[str] if self.is_repeated else Any
        has_negative = is_flag and self.default is not False
        parameter = Parameter(
            name=self.word,
            help=text[:1].upper() + text[1:] + self._default_text(),
            show_default=False,
            negative=(self.form.name or f"--no-{self.spelling}") if has_negative else (),
            allow_leading_hyphen=not is_flag and not self.is_argument,
            metavar=None if is_flag else self.metavar,
            **in_group,
        )
        places = inspect.Parameter.POSITIONAL_ONLY, inspect.Parameter.KEYWORD_ONLY
        default: Any = REQUIRED if self.default is REQUIRED else [] if self.is_repeated else None
        return inspect.Parameter(
            self.name,
            places[0 if self.is_argument else 1],
            default=default,
            annotation=Annotated[hint, parameter],
        )

    def _default_text(self) -> str:
        """Return the default as a user types it, after the description."""
        default = self.default
        if default is REQUIRED:
            return "" if self.is_argument else " [required]"
        if default in (None, "", ()) or isinstance(default, bool):
            return ""
        values = default if isinstance(default, tuple) else (default,)
        words = [f"{value:.12g}" if isinstance(value, float) else str(value) for value in values]
        words = [f"{default // 2**30}GiB"] if self.form == SIZE else words
        return f" [default: {','.join(words)}]"

    def value(self, given: Any) -> Any:
        """Return the value of a word or of several; ConfigError: a word is wrong."""
        if bool in self.types:
            return given
        if not self.is_repeated:
            return self._value(given)
        values = [self._value(word) for word in given]
        return dict(values) if self.is_mapping else values

    def _value(self, word: str) -> Any:
        types = self.types
        if self.choices:
            if word not in self.choices:
                raise self._refusal(word, ", ".join(self.choices))
            return word
        if self.is_mapping:
            return self._joint_value(word)
        if self.form.valid:
            return self._numbers(word)
        if self.form == SIZE:
            return self._size(word)
        if int in types or float in types:
            return self._number(word, int if int in types else float)
        if Path in types or any(Path in get_args(part) for part in types):
            if not word:
                raise self._refusal(word, "the name of a file or folder")
            if self.form == PICTURE:
                check_suffix(Path(word))
            return Path(word)
        return word

    def _refusal(self, word: str, valid: str) -> ConfigError:
        return ConfigError(f"{self.word} {word!r} (valid: {valid})")

    def _number(self, word: str, kind: type[int] | type[float]) -> float:
        bounds = next((part for part in self.types if isinstance(part, Bounds)), Bounds())
        is_length = self.form.name == "MM"
        try:
            number = kind(word.removesuffix("mm") if is_length else word)
        except ValueError:
            number = math.nan
        if bounds.hold(number):
            return number
        what = "a whole number" if kind is int else "a finite number"
        what = "a length in mm such as 0.5 or 0.5mm" if is_length else what
        raise self._refusal(word, ", ".join(filter(None, (what, str(bounds)))))

    def _numbers(self, word: str) -> tuple[float, ...] | str:
        if word in self.form.words:
            return word
        try:
            numbers = tuple(float(number) for number in word.split(","))
        except ValueError:
            numbers = (math.nan,)
        if all(map(math.isfinite, numbers)) and len(numbers) in (
            self.form.counts or [len(numbers)]
        ):
            return numbers
        raise self._refusal(word, self.form.valid)

    def _joint_value(self, word: str) -> tuple[str, float | None]:
        name, equals, text = word.partition("=")
        try:
            value = float(text) if equals else None
        except ValueError:
            value = math.nan
        if name and math.isfinite(value or 0.0):
            return name, value
        raise self._refusal(word, "JOINT=VALUE with a number in deg or mm")

    def _size(self, word: str) -> int:
        from pydantic import ByteSize, TypeAdapter, ValidationError

        try:
            size = int(TypeAdapter(ByteSize).validate_python(word))
        except ValidationError:
            size = 0
        if size >= SMALLEST_SIZE:
            return size
        raise self._refusal(word, "a size with its unit, such as 2GiB or 500MB, at least 1MiB")


def spell_options(text: str, options: Mapping[str, Option]) -> str:
    """Replace names of parameters in a docstring, such as `after`, by options, such as --after."""
    for name, option in options.items():
        text = text.replace(f"`{name}`", option.word)
    return text.replace("``", "`")


class CommandFunction:
    """A function whose arguments are given by words.

    Attributes:
        function: function of the command.
        options: parameters that words give, by name.
        makers: parameters that other functions make, by name, and whether they have a default.
    """

    def __init__(
        self,
        function: Callable[..., Any],
        *documented: Callable[..., Any],
        without: Collection[str] = (),
    ) -> None:
        """Read the parameters; `**options` of the function are parameters of `documented`."""
        from docstring_parser import parse  # not needed for the first help page

        self.function = function
        self.options: dict[str, Option] = {}
        self.makers: dict[str, tuple[CommandFunction, bool]] = {}
        texts: dict[str, str] = {}
        for source in reversed((function, *documented)):
            parsed = parse(inspect.getdoc(source) or "").params
            texts |= {part.arg_name: " ".join((part.description or "").split()) for part in parsed}
        for source in (function, *documented):
            known_names = {
                *self.all_options(),
                *self.makers,
                *(without if source is not function else ()),
            }
            for option in _options_of(source, texts, known_names):
                if (maker := option.maker) is None:
                    self.options[option.name] = option
                else:
                    has_default = option.default is not REQUIRED
                    self.makers[option.name] = CommandFunction(maker), has_default

    def all_options(self) -> dict[str, Option]:
        """Return the options of the function and of its makers."""
        options = dict(self.options)
        for maker, has_default in self.makers.values():
            for name, option in maker.all_options().items():
                optional = replace(option, default=None) if option.default is REQUIRED else option
                options.setdefault(name, optional if has_default else option)
        return options

    def __call__(self, given: Mapping[str, Any]) -> Any:
        """Call the function with given values by name."""
        values = {
            name: option.value(given[name])
            for name, option in self.options.items()
            if name in given
        }
        for name, (maker, has_default) in self.makers.items():
            if not has_default or given.keys() & maker.all_options().keys():
                values[name] = maker(given)
        return self.function(**values)


def _name(part: object) -> str:
    return part.__name__ if isinstance(part, type) else ""


def _options_of(
    function: Callable[..., Any], texts: Mapping[str, str], known_names: Collection[str]
) -> list[Option]:
    """Return the parameters of a function, except known ones, `self` and `**options`."""
    parameters = [
        parameter
        for parameter in inspect.signature(function).parameters.values()
        if parameter.kind is not parameter.VAR_KEYWORD
        and parameter.name not in {"self", *known_names}
    ]
    written = SimpleNamespace(__annotations__={part.name: part.annotation for part in parameters})
    names = vars(sys.modules[function.__module__])
    hints = get_type_hints(written, names, include_extras=True)
    return [
        Option(part.name, hints[part.name], part.default, texts.get(part.name, ""))
        for part in parameters
    ]


def command_signature(options: Mapping[str, Option]) -> inspect.Signature:
    """Return the signature of a command for cyclopts: arguments first, options in groups."""
    names = [option for names in OPTION_GROUPS.values() for option in names]
    heading_of = {name: heading for heading, group in OPTION_GROUPS.items() for name in group}
    headings = ["Options", *OPTION_GROUPS]
    groups = {name: Group(name, sort_key=number) for number, name in enumerate(headings)}
    has_groups = sum(not option.is_argument for option in options.values()) >= MANY_OPTIONS

    def heading(option: Option) -> str:
        return heading_of.get(option.spelling, "Options") if has_groups else "Options"

    def place(option: Option) -> int:
        if option.is_argument:
            return -2
        return names.index(option.spelling) if option.spelling in names else -1

    return inspect.Signature(
        [
            option.as_parameter(groups[heading(option)], options)
            for option in sorted(options.values(), key=place)
        ]
    )
