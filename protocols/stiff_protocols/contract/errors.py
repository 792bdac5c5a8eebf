"""The one root of every error that stiffbench raises on purpose, and its few children."""

from __future__ import annotations

import difflib
import warnings
from collections.abc import Iterable
from pathlib import PurePath


class StiffBenchError(Exception):
    """Something the user can fix; the message names the thing, its value and what is valid.

    Attributes:
        argument: that is wrong, "" for none: the text begins with it, and on the command line with
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
    """A file of samples, a robot description or an array cannot be what it claims to be."""


class ModelError(StiffBenchError):
    """A model cannot be fitted or returned something that is no prediction."""


class NotFittedError(ModelError):
    """`predict` was called before `fit`."""


class TooFewToCalibrate(ModelError):
    """The training side is too small for intervals of the coverage that was asked for."""


class StoreError(StiffBenchError):
    """A result cannot be written or read."""


class NotSavable(StoreError):
    """The model has no form that can be written without pickle or another's licence."""


class StiffBenchWarning(UserWarning):
    """A finding that does not stop a run but must stand beside its result."""


def warn(finding: str, stacklevel: int = 2) -> None:
    """Warn the user, with `StiffBenchWarning`; `stacklevel` counts as of `warnings.warn`."""
    warnings.warn(finding, StiffBenchWarning, stacklevel=stacklevel + 1)


def said_by(error: BaseException) -> str:
    """Return an error's type and message, whatever a stranger's class does when it is asked."""
    try:
        return f"{type(error).__name__}: {error}"
    except Exception:
        return f"{type(error).__name__}, whose message cannot be read"


def unsupported_extension(path: PurePath, valid: Iterable[str], argument: str = "") -> ConfigError:
    """Return the error for a file to write whose extension names no valid format."""
    extension = path.suffix or "none"
    text = f"{path}: unsupported extension {extension} (use {' or '.join(valid)})"
    return ConfigError(text, argument)


def unknown_name(kind: str, name: str, valid: Iterable[str], listed: str = "") -> ConfigError:
    """Return the error for a name that is not registered, with the nearest valid one.

    `kind` is what the name should have been, e.g. "model"; `valid` all names that would do.
    `listed` is the text for them where they are too many for a message.
    """
    names = sorted(valid)
    lower = {one.lower(): one for one in names}
    near = difflib.get_close_matches(name.lower(), lower, n=1)
    hint = f"; did you mean {lower[near[0]]!r}?" if near else ""
    text = listed or ", ".join(names) or "none"
    return ConfigError(f"unknown {kind} {name!r}{hint} (valid: {text})")
