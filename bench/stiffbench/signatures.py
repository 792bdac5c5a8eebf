"""Make the options of a command from the signature and the "Args:" of its function.

A parameter that no word can give, such as a fitted model, is made by a function: the one in its
annotation, or in `MAKERS` for its type. The parameters of this function are options in its place.
"""

from __future__ import annotations

import inspect
import re
import sys
from collections.abc import Callable, Collection, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from types import SimpleNamespace
from typing import Annotated, Any, Literal, get_args, get_origin, get_type_hints

from cyclopts import Group, Parameter, Token

from stiff_bench.parameter_types import Bounds, Form, Point, PoseTolerance
from stiff_protocols.contract.errors import ConfigError
from stiffbench.options import MAKERS

ARGUMENTS = ("kind", "number", "name", "key", "file", "a", "b", "folder", "folders")
"""Parameters that are given by their place; all others are options."""
SHARED = {"hold"}
"""Options of a command that the functions of its other options read, too."""
SPELLINGS = {
    **{"settings": "set", "equivalence_mm": "equivalence", "fmt": "format"},
    **{"results": "results", "plan_only": "plan"},
}
"""Parameter -> its option, if the name differs; a sequence of `models` is a repeated --model."""
TYPES = {"hook": Point, "pose_tolerance": PoseTolerance}
"""Parameter of a class below the front door -> type with the form of its value."""
HEADINGS = {
    **{"select": "Selection", "Execution": "Computation", "Limits": "Computation"},
    **dict.fromkeys(("name_robot", "find_own_data", "FileOptions"), "Your own data"),
}
"""Function or class -> heading of its parameters; the others are below "Options"."""
GROUPS = {name: Group.create_ordered(name) for name in ("Options", *HEADINGS.values())}
SHAPE = re.compile(r"^(\([\w,]+\) (or )?)+")
"""Shape of an array before its description."""
REQUIRED = inspect.Parameter.empty


@dataclass(frozen=True)
class Option:
    """A parameter of a function.

    Attributes:
        name: name of the parameter.
        types: types in its annotation, and their metadata.
        default: its default, or `REQUIRED`.
        text: description.
        heading: heading above the option in help pages.
    """

    name: str
    types: Sequence[Any]
    default: Any
    text: str
    heading: str

    @property
    def maker(self) -> Callable[..., Any] | None:
        """Return the function that makes the value; None: a word gives it."""
        names = [part.__name__ for part in self.types if isinstance(part, type)]
        makers: list[Callable[..., Any]] = [
            *filter(inspect.isfunction, self.types),
            *(MAKERS[name] for name in names if name in MAKERS),
        ]
        return makers[0] if makers else None

    @property
    def form(self) -> Form:
        """Return the form of a value."""
        form = next((part for part in self.types if isinstance(part, Form)), Form(""))
        bounds = next((part for part in self.types if isinstance(part, Bounds)), Bounds())
        if form.valid:
            return form
        if int in self.types:
            return bounds.form(form.name or "N", int)
        if float in self.types:
            return bounds.form(form.name or "NUMBER", float)
        is_path = Path in self.types
        return Form(form.name or ("FILE" if is_path else "NAME"), "", Path if is_path else str)

    @property
    def is_repeated(self) -> bool:
        """Return whether each word is an element of a sequence or mapping."""
        return Mapping in self.types or (Sequence in self.types and float not in self.types)

    @property
    def spelling(self) -> str:
        """Return the name of the option, without the hyphens before it."""
        if self.name in SPELLINGS:
            return SPELLINGS[self.name]
        return (self.name.removesuffix("s") if self.is_repeated else self.name).replace("_", "-")

    @property
    def word(self) -> str:
        """Return the name in messages."""
        if self.name not in ARGUMENTS:
            return f"--{self.spelling}"
        return self.name.upper() if self.form.name in ("FILE", "NAME") else self.form.name

    def parameter(self, options: Mapping[str, Option]) -> inspect.Parameter:
        """Return the parameter for cyclopts; names of `options` are in its description."""
        is_argument, is_flag = self.name in ARGUMENTS, bool in self.types
        choices = next((part for part in self.types if get_origin(part) is Literal), None)
        is_word = not is_flag and choices is None
        text = spell_options(SHAPE.sub("", self.text), options)
        negative = next((part.name for part in self.types if isinstance(part, Form)), None)
        parameter = Parameter(
            name=self.word,
            group="Arguments" if is_argument else GROUPS[self.heading],
            help=text[:1].upper() + text[1:],
            show_default="" if "by default" in text else default_text(self.default),
            negative=negative if is_flag and self.default is not False else (),
            converter=self.value if is_word else None,
            metavar=self.form.name if is_word else "|".join(get_args(choices)) or None,
            allow_leading_hyphen=not is_flag and not is_argument,
        )
        kind: Any = bool if is_flag else choices or (list[Any] if self.is_repeated else Any)
        places = inspect.Parameter.KEYWORD_ONLY, inspect.Parameter.POSITIONAL_ONLY
        return inspect.Parameter(
            self.name,
            places[is_argument],
            default=REQUIRED if self.default is REQUIRED else None,
            annotation=Annotated[kind | None, parameter],
        )

    def value(self, tokens: Sequence[Token]) -> Any:
        """Return the value of the user's words; ConfigError: a word is not valid."""
        values = []
        for token in tokens:
            try:
                if not token.value:
                    raise ValueError
                values.append(self.form.read(token.value))
            except ValueError:
                valid = self.form.valid or self.form.name
                raise ConfigError(f"{self.word} {token.value!r} (valid: {valid})") from None
        if Mapping in self.types and len(values) > len(dict(values)):
            names = [name for name, _ in values]
            raise ConfigError(f"{self.word} {max(names, key=names.count)}: given twice")
        return values if self.is_repeated else values[0]


def default_text(default: Any) -> str:
    """Return a default as a user types it; "" for none."""
    if default in (REQUIRED, None, "", ()) or isinstance(default, bool):
        return ""
    values = default if isinstance(default, tuple) else (default,)
    return ",".join(f"{item:.12g}" if isinstance(item, float) else str(item) for item in values)


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
            given_names = {*without, *self.all_options(), *self.makers}
            options = _options_of(source, texts, given_names)
            self.options |= {option.name: option for option in options if option.maker is None}
            for option in options:
                if (maker := option.maker) is not None:
                    made = CommandFunction(maker, without={*without, *self.options} - SHARED)
                    self.makers[option.name] = made, option.default is not REQUIRED

    def all_options(self) -> dict[str, Option]:
        """Return the options of the function and of its makers."""
        options = dict(self.options)
        for maker, has_default in self.makers.values():
            for name, option in maker.all_options().items():
                optional = replace(option, default=None) if option.default is REQUIRED else option
                options.setdefault(name, optional if has_default else option)
        return options

    def __call__(self, given: Mapping[str, Any], *first: Any) -> Any:
        """Call the function with `first` and with given values by name."""
        values = {
            name: dict(given[name]) if Mapping in option.types else given[name]
            for name, option in self.options.items()
            if name in given
        }
        for name, (maker, has_default) in self.makers.items():
            if not has_default or given.keys() & maker.all_options().keys() - self.options.keys():
                values[name] = maker(given)
        return self.function(*first, **values)


def _options_of(
    function: Callable[..., Any], texts: Mapping[str, str], known_names: Collection[str]
) -> list[Option]:
    """Return the parameters of a function, except known ones and `**options`."""
    parts = [
        part
        for part in inspect.signature(function).parameters.values()
        if part.kind is not part.VAR_KEYWORD and part.name not in known_names
    ]
    class_name = function.__qualname__.partition(".")[0]
    texts_of_types = {p.name: class_name if p.name == "self" else p.annotation for p in parts}
    names = vars(sys.modules[function.__module__])
    annotated = SimpleNamespace(__annotations__=texts_of_types)  # without the type of the result
    types = get_type_hints(annotated, names, include_extras=True)
    heading = HEADINGS.get(function.__name__, "Options")
    return [
        Option(
            part.name,
            types_in(TYPES.get(part.name, types[part.name])),
            part.default,
            texts.get(part.name, ""),
            heading,
        )
        for part in parts
    ]


def types_in(hint: Any) -> list[Any]:
    """Return the types in an annotation, with their metadata."""
    origin = get_origin(hint)
    if origin in (None, Literal):
        return [hint]
    inner = [part for argument in get_args(hint) for part in types_in(argument)]
    return [origin, *inner] if origin in (Sequence, Mapping) else inner


def command_signature(options: Mapping[str, Option]) -> inspect.Signature:
    """Return the signature of a command for cyclopts: arguments first."""
    parameters = [option.parameter(options) for option in options.values()]
    return inspect.Signature(sorted(parameters, key=lambda parameter: parameter.kind))
