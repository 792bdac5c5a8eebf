"""Figures on the page: one that cannot be drawn is a note, never the end of the page."""

from __future__ import annotations

from pathlib import Path

import pytest

from stiff_bench.figures.figure import FigureLine, Prepared
from stiff_bench.report import pictures
from stiff_bench.report.runs import Selection
from stiff_protocols.contract.errors import StoreError


class Drawn(Prepared):
    """Stands for a picture without drawing one."""

    def picture(self, kind):
        return f"a picture as {kind}".encode()


class Line(FigureLine):
    def prepare(self, source):
        return Drawn(self.name, self.title, "of nothing", self.gather)


class Broken(FigureLine):
    def prepare(self, source):
        self.gather(source)


def raising(error):
    def gather(source):
        raise error

    return gather


@pytest.mark.parametrize(
    ("error", "said"),
    [
        (StoreError("no curves"), "no figure of broken ones: no curves"),
        (ZeroDivisionError("by zero"), "drawing failed: ZeroDivisionError: by zero"),
        (ValueError("no positive values"), "drawing failed: ValueError: no positive values"),
    ],
)
def test_a_figure_that_cannot_be_drawn_is_a_note_beside_the_others(monkeypatch, error, said):
    lines = {
        "broken": Broken("broken", "broken ones", raising(error)),
        "whole": Line("whole", "whole ones", raising(error)),
    }
    monkeypatch.setattr(pictures, "FIGURES", lines)
    block = pictures.picture_block(type("Source", (), {"folder": Path("runs")}), Selection())
    assert [picture.title for picture in block.pictures] == ["whole ones"]
    (note,) = block.notes
    assert said in note
