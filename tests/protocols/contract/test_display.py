"""Check short views of objects: a screen of text, and HTML that escapes hostile names."""

from __future__ import annotations

import re
from dataclasses import dataclass

import numpy as np
import pytest

from stiff_protocols.contract.display import MOST_ROWS, WIDTH, BriefFields, Screen

HOSTILE = "<img src=x onerror=alert(1)>$x^2$\x1b[2J\n[red]&"


@pytest.fixture()
def long() -> Screen:
    facts = [("name", "word " * 60), ("a much longer name", "short")]
    rows = [[str(number), "a cell " * 20] for number in range(MOST_ROWS + 3)]
    return Screen("title " * 40, facts, ("number", "cell"), rows, ("note " * 50,))


def test_no_line_of_text_is_wider_than_a_screen(long):
    assert max(map(len, long.text().splitlines())) <= WIDTH


def test_rows_that_are_left_out_are_counted_in_text_and_html(long):
    for view in (long.text(), long.html()):
        assert "... and 3 more" in view
        assert view.count("a cell ") >= MOST_ROWS
        assert str(MOST_ROWS + 2) not in re.findall(r"\d+", view)


def test_a_hostile_name_is_text_in_every_place():
    screen = Screen(HOSTILE, [(HOSTILE, HOSTILE)], (HOSTILE,), [[HOSTILE]], (HOSTILE,))
    page = screen.html()
    assert "<img" not in page and page.count("&lt;img") == 6
    assert 'class="tex2jax_ignore mathjax_ignore"' in page  # $ begins no formula
    for view in (page, screen.text()):
        assert "\x1b" not in view and "[red]" in view


def test_a_table_of_a_notebook_only_is_not_in_the_text():
    screen = Screen("title", columns=("a",), rows=[["cell"]], in_text=False)
    assert "cell" in screen.html() and screen.text() == "title"


def test_a_table_without_rows_has_its_headings():
    screen = Screen("title", columns=("first", "second"))
    for view in (screen.text(), screen.html()):
        assert "first" in view and "second" in view


@dataclass(frozen=True, eq=False, repr=False)
class Fields(BriefFields):
    values: object
    name: str = "n"


def test_arrays_are_their_shape_and_long_values_are_shortened():
    assert repr(Fields(np.zeros((151, 3)))) == "Fields(values=<array 151x3>, name='n')"
    many = Fields([Fields(np.zeros(1000))] * 1000, "x" * 1000)
    assert "<array" in repr(many) and len(repr(many)) < 400
    assert "\n" not in repr(Fields(type("Lines", (), {"__repr__": lambda _: "a\nb"})()))
