"""Lines can be seen on white paper: a contrast of 3:1, by the formula of WCAG 2."""

from __future__ import annotations

import pytest

from helpers.contrast import LEAST_CONTRAST, contrast_on_white
from stiff_apply.figures import corrected_path
from stiff_bench.figures import robot_picture, style, workspace


def test_the_formula_gives_the_known_ratios_of_black_and_of_wcags_grey():
    assert contrast_on_white("black") == pytest.approx(21.0)
    assert contrast_on_white("#767676") == pytest.approx(4.54, abs=0.01)
    assert contrast_on_white("black", alpha=0.0) == pytest.approx(1.0)


@pytest.mark.parametrize(
    "color",
    [
        *dict.fromkeys(look.color for look in style.looks(20)),
        style.REFERENCE_COLOR,
        corrected_path.WANTED_COLOR,
        robot_picture.ARM_COLOR,
        workspace.ARM_COLOR,
    ],
)
def test_every_line_colour_has_a_contrast_of_three_to_one_on_white(color):
    assert contrast_on_white(color) >= LEAST_CONTRAST


def test_eight_looks_have_different_colours_and_the_next_eight_other_markers():
    looks = style.looks(16)
    assert len({look.color for look in looks[:8]}) == 8
    assert len({(look.color, look.marker) for look in looks}) == 16
