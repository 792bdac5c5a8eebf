"""The figures of a folder as pictures inside the page."""

from __future__ import annotations

from collections.abc import Mapping

from stiff_bench.figures.catalog import FIGURES
from stiff_bench.figures.figure import Prepared
from stiff_bench.figures.source import FigureSource
from stiff_bench.report.content import Block, Picture
from stiff_bench.report.runs import Selection
from stiff_protocols.contract.errors import StiffBenchError

LARGEST_SVG = 300_000
"""Bytes; a picture of more is embedded as PNG."""


def picture_block(source: FigureSource, choice: Selection) -> Block:
    """Return all figures that the results are enough for, and why others are not there."""
    pictures, missing = [], {}
    for name, figure in FIGURES.items():
        try:
            pictures.append(_picture(figure.prepare(source), source, choice))
        except StiffBenchError as error:
            missing[name] = str(error)
        except (ArithmeticError, ValueError) as error:  # one picture must not cost the page
            missing[name] = f"drawing failed: {type(error).__name__}: {error}"
    return Block(
        "Figures",
        [] if pictures else ["The results shown are not enough for any figure."],
        pictures=pictures,
        notes=_missing_notes(missing),
    )


def _picture(figure: Prepared, source: FigureSource, choice: Selection) -> Picture:
    media_type, content = "image/svg+xml", figure.picture("svg")
    if len(content) > LARGEST_SVG:
        media_type, content = "image/png", figure.picture("png")
    return Picture(
        title=figure.title,
        caption=figure.caption,
        alt=figure.alt,
        media_type=media_type,
        content=content,
        command=choice.command("figure", figure.name, folder=source.folder),
    )


def _missing_notes(missing: Mapping[str, str]) -> list[str]:
    return [f"no figure of {FIGURES[name].title}: {why}" for name, why in missing.items()]
