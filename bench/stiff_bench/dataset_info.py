"""The text of `bench data info KEY`."""

from __future__ import annotations

from importlib.resources import files
from pathlib import Path

from stiff_bench.dataset_facts import facts, render_facts
from stiff_bench.dataset_picture import DEFLECTION
from stiff_protocols.errors import DataError
from stiff_protocols.plugin import STIFFNESS, DatasetInfo
from stiff_protocols.types import BenchmarkData

_CARD_NOTE = " (the card below is that of the defaults)"


def dataset_info(
    info: DatasetInfo, data: BenchmarkData, picture: Path | None, options: str = ""
) -> str:
    """Return what is known of a data set: catalogue line, facts, card, place of the picture.

    Args:
        info: its catalogue line.
        data: what its `load` gave.
        picture: a file that `save_picture` has written; None: there is none.
        options: what was set, "name=value, ..."; the card describes the defaults.

    Raises:
        DataError: there are no samples, or the card is not in the package.
    """
    parts = [_heading(info, options), render_facts(facts(data))]
    if info.card:
        parts.append(_card_text(info.key, info.card))
    if picture is not None:
        parts.append(f"picture: {picture}")
    return "\n\n".join(parts)


def picture_title(info: DatasetInfo) -> str:
    """Return the first line of the picture: the key, and whether anything was measured."""
    return f"{info.key} ({info.label})"


def picture_quantity(info: DatasetInfo) -> str:
    """Return what the data set's deflections are."""
    return DEFLECTION if info.task == STIFFNESS else f"The {info.task} (no load is applied)"


def _heading(info: DatasetInfo, options: str) -> str:
    lines = [f"{info.key} ({info.label}): {info.summary}"]
    if options:
        lines.append(f"options: {options}{_CARD_NOTE if info.card else ''}")
    if info.reference:
        lines.append(f"reference: {info.reference}")
    lines += [f"caveat: {caveat}" for caveat in info.caveats]
    return "\n".join(lines)


def _card_text(key: str, card: str) -> str:
    """Read a data card, named by its path inside stiff_datasets."""
    try:
        text = files("stiff_datasets").joinpath(card).read_text(encoding="utf-8")
    except OSError as error:
        raise DataError(
            f"data set {key!r}: card {card!r} cannot be read, expected a path inside the package "
            f"stiff_datasets such as data/fanuc_r2000ic.md: {error.strerror or error}"
        ) from error
    return text.strip()
