"""Check that pages with measured numbers are of today's code."""

from __future__ import annotations

import pytest

from helpers.measured_pages import TOP, changed_modules, code_hash, pages

PAGES = pages()


@pytest.mark.slow
@pytest.mark.parametrize("name", PAGES)
def test_the_modules_that_a_page_measures_have_not_changed_since(name):
    page = PAGES[name]
    assert (TOP / name).is_file() and page["modules"]
    if changed := changed_modules(page):
        pytest.fail(
            f"{name} has numbers of older code of {', '.join(changed)}: measure again with "
            f"`{page['command']}`. Then, or if no number can have moved, "
            f"`python tests/helpers/measured_pages.py {name}`",
            pytrace=False,
        )


def test_a_hash_is_of_what_the_code_does():
    code = "import os\n\ndef area(side):\n    '''Square.'''\n    return side * side\n"
    same = "def area(side):\n    return side * side  # m2\n"
    assert code_hash(code) == code_hash(same) != code_hash(same.replace("*", "+"))
