"""The check of names and words that `make lint` runs."""

import pytest
from plain_words import PLAIN_WORDS, problems_of

HARD, PLAIN = next(iter(PLAIN_WORDS.items()))
BARE = "{}: {}: add a noun"


@pytest.mark.parametrize(
    ("name", "text", "problems"),
    [
        ("a.py", "found = 1\nfound_rows = 2\n", ["1: found: add a noun"]),
        ("a.py", "def f(other):\n    ...\n", ["1: other: add a noun"]),
        (
            "a.py",
            "class Other:\n    found: int = 1\n",
            [BARE.format(1, "Other"), "2: found: add a noun"],
        ),
        ("a.py", f"x = 'plain'\ny = 'fitted {HARD}'\n", [f"2: {HARD!r}: write {PLAIN!r}"]),
        ("a.py", f"x = 1\ny = 2  # {HARD}\n", [f"2: {HARD!r}: write {PLAIN!r}"]),
        (
            "a.py",
            "def f(self, Whole):\n    self.found = 1\n",
            [BARE.format(1, "Whole"), BARE.format(2, "found")],
        ),
        (
            "a.md",
            f"A sentence.\nIt {HARD.title()} a robot.\n",
            [f"2: {HARD.title()!r}: write {PLAIN!r}"],
        ),
    ],
)
def test_a_bare_name_and_a_hard_word_are_refused_by_line(name, text, problems, tmp_path):
    path = tmp_path / name
    path.write_text(text, encoding="utf-8")
    assert list(problems_of(path)) == problems
