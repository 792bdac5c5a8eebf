"""Whoever reads the page can tell its texts from their grounds."""

from __future__ import annotations

import re
from pathlib import Path

import pytest

from stiff_bench.report import page as palette


@pytest.mark.parametrize("colours", [palette.LIGHT, palette.DARK], ids=["light", "dark"])
@pytest.mark.parametrize(("text", "ground"), palette.TEXT_ON)
def test_every_text_has_contrast_enough_on_its_ground(colours, text, ground):
    assert palette.contrast(colours[text], colours[ground]) >= palette.LEAST_CONTRAST


def test_contrast_is_that_of_the_guideline():
    assert palette.contrast("#777777", "#ffffff") == pytest.approx(4.48, abs=0.005)


def test_the_style_sheet_names_no_colour_that_the_palette_lacks():
    style = Path(palette.__file__).with_name("page.css").read_text(encoding="utf-8")
    assert set(re.findall(r"var\(--(\w+)\)", style)) <= set(palette.LIGHT)
    assert set(palette.LIGHT) == set(palette.DARK)
    assert set(re.findall(r"#[0-9a-f]{3,6}\b", style)) == {"#ffffff"}  # behind figures alone
