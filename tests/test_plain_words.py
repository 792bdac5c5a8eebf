"""The check of names and words that `make lint` runs."""

import pytest
from plain_words import PLAIN_WORDS, problems_of

HARD = next(iter(PLAIN_WORDS))


@pytest.mark.parametrize(
    ("name", "text", "problems"),
    [
        ("a.py", "found = 1\nfound_rows = 2\n", ["1: found: add a noun"]),
        ("a.py", "def f(other):\n    ...\n", ["1: other: add a noun"]),
        ("a.py", "class Other:\n    found: int = 1\n", ["2: found: add a noun"]),
        ("a.py", f"x = 'plain'\ny = 'fitted {HARD}'\n", ["2: 'anew': write 'again'"]),
        ("a.md", f"A sentence.\nIt {HARD.title()} a robot.\n", ["2: 'Anew': write 'again'"]),
    ],
)
def test_a_bare_name_and_a_hard_word_are_refused_by_line(name, text, problems, tmp_path):
    path = tmp_path / name
    path.write_text(text, encoding="utf-8")
    assert list(problems_of(path)) == problems
