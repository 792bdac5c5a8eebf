"""The base class of all errors that stiffbench raises on purpose, and its subclasses."""

from __future__ import annotations

import difflib
import warnings
from collections.abc import Iterable
from pathlib import PurePath


class StiffBenchError(Exception):
    """Something the user can fix; the message names the thing, its value and what is valid.

    Attributes:
        argument: wrong argument, or "". The text begins with it; on the command line it begins with
            the option of this name.
    """

    def __init__(self, message: str = "", argument: str = "") -> None:
        super().__init__(message)
        self.argument = argument

    def __str__(self) -> str:
        return f"{self.argument} {super().__str__()}".lstrip()

    def as_typed(self) -> str:
        """Return the same for a user of the command line."""
        return f"--{self}" if self.argument else str(self)


class ConfigError(StiffBenchError):
    """A key, option or parameter is unknown, or its value has the wrong type or range."""


class DataError(StiffBenchError):
    """A file of samples, a robot description or an array is not valid."""


class ModelError(StiffBenchError):
    """A model cannot be fitted, or its prediction is not valid."""


class NotFittedError(ModelError):
    """`predict` was called before `fit`."""


class TooFewToCalibrate(ModelError):
    """The training side is too small for intervals of the requested coverage."""


class StoreError(StiffBenchError):
    """A result cannot be written or read."""


class NotSavable(StoreError):
    """The model cannot be written without pickle or a third-party licence."""


class StiffBenchWarning(UserWarning):
    """A finding that does not stop a run but must be shown with its result."""


def warn(finding: str, stacklevel: int = 2) -> None:
    """Warn the user with `StiffBenchWarning`; `stacklevel` counts as in `warnings.warn`."""
    warnings.warn(finding, StiffBenchWarning, stacklevel=stacklevel + 1)


def describe_error(error: BaseException) -> str:
    """Return an error's type and message."""
    return f"{type(error).__name__}: {error}"


def unsupported_extension(path: PurePath, valid: Iterable[str], argument: str = "") -> ConfigError:
    """Return the error for an output file with an unsupported extension."""
    extension = path.suffix or "none"
    text = f"{path}: unsupported extension {extension} (use {' or '.join(valid)})"
    return ConfigError(text, argument)


def unknown_name(kind: str, name: str, valid: Iterable[str], listed: str = "") -> ConfigError:
    """Return the error for an unregistered name, with the nearest valid name.

    `kind` is the kind of the name, e.g. "model"; `valid` are all valid names. `listed` replaces
    their list in the message if they are too many.
    """
    names = sorted(valid)
    lower = {valid_name.lower(): valid_name for valid_name in names}
    near = difflib.get_close_matches(name.lower(), lower, n=1)
    hint = f"; did you mean {lower[near[0]]!r}?" if near else ""
    text = listed or ", ".join(names) or "none"
    return ConfigError(f"unknown {kind} {name!r}{hint} (valid: {text})")
