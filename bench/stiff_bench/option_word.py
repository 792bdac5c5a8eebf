"""A key with options in one word of the command line.

``KEY@OPTION=VALUE@OPTION=VALUE``: `kr10-twin@specimen=3`. An @ in a value, which may be such a word
itself, is doubled: `cross-robot@source=ur5-twin@@seed=1`.
"""

from __future__ import annotations

from collections.abc import Iterable

OPTION_MARK = "@"
"""Parts the options from the key and from each other in a word; doubled, it is part of a value."""
_HELD = "\0"  # stands for a doubled mark; no command line holds it


def split_word(word: str) -> tuple[str, list[str]]:
    """Return the key and the ``OPTION=VALUE`` words of a word."""
    key, *settings = (
        part.replace(_HELD, OPTION_MARK)
        for part in word.replace(2 * OPTION_MARK, _HELD).split(OPTION_MARK)
    )
    return key, settings


def join_word(key: str, settings: Iterable[str]) -> str:
    """Return the word that `split_word` takes apart."""
    held = (setting.replace(OPTION_MARK, 2 * OPTION_MARK) for setting in settings)
    return OPTION_MARK.join([key, *held])
