"""Pictures on disk: PNG, PDF or SVG, whole or not at all, the same for the same content."""

from __future__ import annotations

from collections.abc import Mapping
from contextlib import AbstractContextManager
from pathlib import Path
from typing import TYPE_CHECKING, Any, BinaryIO

from stiff_protocols.contract.errors import ConfigError
from stiff_protocols.contract.files import written_whole

if TYPE_CHECKING:
    from matplotlib.figure import Figure

DOTS_PER_INCH = 150  # of a PNG
# Suffix -> metadata that would otherwise hold the time.
_TIMELESS: dict[str, dict[str, Any]] = {
    ".png": {},
    ".pdf": {"CreationDate": None},
    ".svg": {"Date": None},
}


def check_suffix(path: Path) -> None:
    """See that the file's suffix names a format.

    Raises:
        ConfigError: it does not.
    """
    if path.suffix.lower() not in _TIMELESS:
        valid = ", ".join(_TIMELESS)
        raise ConfigError(f"picture {path}: suffix {path.suffix!r} is not known (valid: {valid})")


def drawing(style: Mapping[str, Any]) -> AbstractContextManager[None]:
    """Draw with matplotlib's defaults and a style: no matplotlibrc that lies about takes part."""
    from matplotlib.style import context

    return context(dict[Any, Any](style), after_reset=True)


def save_figure(figure: Figure, path: Path, dots_per_inch: int = DOTS_PER_INCH) -> None:
    """Write a figure in the format that the file's suffix names.

    Raises:
        ConfigError: the suffix names none.
        StoreError: the file cannot be written.
    """
    check_suffix(path)
    with written_whole(path) as temporary:
        write_picture(figure, temporary, path.suffix.lower(), dots_per_inch)


def write_picture(
    figure: Figure, target: Path | BinaryIO, suffix: str, dots_per_inch: int = DOTS_PER_INCH
) -> None:
    """Write a figure in the format of a known suffix, without the time."""
    figure.savefig(target, format=suffix[1:], dpi=dots_per_inch, metadata=_TIMELESS[suffix])
