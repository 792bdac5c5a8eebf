"""Pictures on disk: PNG, PDF or SVG, whole or not at all, the same for the same content."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING, Any

from stiff_protocols.errors import ConfigError
from stiff_protocols.files import written_whole

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


@contextmanager
def drawing(style: Mapping[str, Any]) -> Iterator[None]:
    """Draw with matplotlib's defaults and a style: no matplotlibrc that lies about takes part."""
    import matplotlib

    with matplotlib.rc_context():
        matplotlib.rcdefaults()
        matplotlib.rcParams.update(dict[Any, Any](style))
        yield


def save_figure(figure: Figure, path: Path) -> None:
    """Write a figure in the format that the file's suffix names.

    Raises:
        ConfigError: the suffix names none.
        StoreError: the file cannot be written.
    """
    check_suffix(path)
    suffix = path.suffix.lower()
    with written_whole(path) as temporary:
        figure.savefig(temporary, format=suffix[1:], dpi=DOTS_PER_INCH, metadata=_TIMELESS[suffix])
