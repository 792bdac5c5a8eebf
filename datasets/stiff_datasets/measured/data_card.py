"""Read the facts of a data card FILE.md next to FILE.csv.

The rest of a card is not evaluated. These are read:

- "torques were not measured" (or recorded), anywhere in a line;
- the instrument's noise, ``Instrument noise: 0.02 mm per reading``, as a line or a row of a table;
- the rows of the card's first table, such as ``| Licence | CC-BY-4.0 |``: see `TOPICS`;
- the meanings of columns, in a table with the header ``| column | meaning |``.
"""

from __future__ import annotations

import re
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np

from stiff_datasets.measured.sample_columns import MM_PER_M, UNITS
from stiff_protocols.contract.errors import DataError

TORQUE = re.compile(r"\btorques?\b", re.IGNORECASE)
NOT_MEASURED = re.compile(r"\bnot (measured|recorded)\b", re.IGNORECASE)
NOISE_LINE = re.compile(r"^[\s|*_-]*instrument noise[\s*_]*[:|](.*)$", re.IGNORECASE)
NOISE = re.compile(
    r"[\s*_]*(?P<number>\d+(\.\d*)?|\.\d+) ?(?P<unit>mm|µm|μm|um) (a|per) "
    r"(?P<of>reading|deflection)\b",
    re.IGNORECASE,
)
MAX_NOISE_MM = 10.0
NOISE_VALID = (
    "a number, mm or µm, then 'per reading' or 'per deflection', e.g. '0.02 mm per reading'"
)
MAX_SHOWN = 60
READINGS = {"reading": np.sqrt(2.0), "deflection": 1.0}
"""Factor to the noise of a deflection, which is the difference of two readings."""
TOPICS = {
    "what": ("what",),
    "robot": ("robot",),
    "licence": ("licence", "license"),
    "citation": ("citation", "cite as", "paper"),
    "source": ("source",),
    "version": ("version",),
    "published": ("published",),
}
"""Fact -> names of its row, in lower case; the first row counts."""
TO_DO = "TODO"
"""Start of a value that is not filled in yet: the fact is missing."""
_TITLE = re.compile(r"^# data card: *(\S.*)$", re.IGNORECASE | re.MULTILINE)
_LINK = re.compile(r"!?\[([^\[\]\n]{0,300})\]\(([^()\s]{0,300})\)")
_URL = re.compile(r"https?://[^\s)>`|,]+")
_RANGE = re.compile(r"`(\D{0,9})(\d)(\D{0,9})` *\.\. *`\1(\d)\3`")


@dataclass(frozen=True)
class DataCard:
    """The facts of a data card.

    Attributes:
        no_torque: true if torques were not measured.
        instrument_noise: standard deviation of a measured deflection's error, m, of each axis; 0
            if the card does not state it.
        facts: fact of `TOPICS` -> its text in Markdown, without facts that are missing.
        meanings: column -> its meaning, for the columns that the card describes.
        name: name of the data set, from the heading "# Data card: NAME"; "" if there is none.
    """

    no_torque: bool = False
    instrument_noise: float = 0.0
    facts: Mapping[str, str] = field(default_factory=dict)
    meanings: Mapping[str, str] = field(default_factory=dict)
    name: str = ""

    @property
    def kind(self) -> str:
        """Return "simulated", "measured" or "unknown", by the capital word in the row "What"."""
        what = self.facts.get("what", "")
        return next((k for k in ("simulated", "measured") if k.upper() in what), "unknown")

    def text(self, fact: str) -> str:
        """Return a fact as plain text; "" if it is missing."""
        return plain(self.facts.get(fact, ""))

    def url(self, fact: str) -> str:
        """Return the first URL in a fact; "" if there is none."""
        match = _URL.search(self.facts.get(fact, ""))
        return match[0].rstrip(".;") if match else ""


def card_file(path: Path) -> Path:
    """Return the path of the card that belongs to a file of samples; it need not exist."""
    return path.with_suffix(".md")


def read_card(path: Path) -> DataCard:
    """Read the card next to a file of samples; a file without a card has an empty one.

    Args:
        path: the file of samples.

    Raises:
        DataError: the noise cannot be read; the message names the card, its line and the value.
    """
    card = card_file(path)
    if card == path or not card.is_file():
        return DataCard()
    text = card.read_text(encoding="utf-8", errors="replace")
    return parse_card(text, card)


def parse_card(text: str, card: Path) -> DataCard:
    """Return the facts in a card's text; errors are as in `read_card` and name `card`."""
    noise = _instrument_noise(card, text)
    tables = [*_tables(text)]
    facts = _facts(tables[0]) if tables else {}
    meanings = {}
    for header, *rows in tables:
        if [cell.lower() for cell in header[:2]] == ["column", "meaning"]:
            meanings = {name: plain(row[1]) for row in rows for name in _column_names(row[0])}
    title = _TITLE.search(text)
    name = plain(title[1]) if title else ""
    return DataCard(states_no_torque(text), noise, facts, meanings, name)


def states_no_torque(text: str) -> bool:
    """Test if a line of a card states that torques were not measured."""
    for line in text.splitlines():
        torque = TORQUE.search(line)
        if torque and NOT_MEASURED.search(line, torque.end()):
            return True
    return False


def plain(markdown: str) -> str:
    """Return a line of Markdown without links, code marks and emphasis; URLs stay."""
    text = _LINK.sub(
        lambda link: f"{link[1]} {link[2]}" if _URL.match(link[2]) else link[1], markdown
    )
    return re.sub(r"\s+", " ", re.sub(r"[`*]|\\(?=\|)", "", text)).strip()


def without_relative_links(text: str) -> str:
    """Replace links to files next to the card by their text: a copy has no such files."""
    return _LINK.sub(lambda link: link[0] if _URL.match(link[2]) else link[1], text)


def _tables(text: str) -> Iterator[list[list[str]]]:
    """Yield the tables of a card as rows of cells, header first, without separator line."""
    rows: list[list[str]] = []
    for line in (*text.splitlines(), ""):
        cells = [cell.strip() for cell in re.split(r"(?<!\\)\|", line.strip())[1:-1]]
        if len(cells) > 1 and line.lstrip().startswith("|"):
            if not all(re.fullmatch(r":?-+:?", cell) for cell in cells):
                rows.append(cells)
        elif rows:
            yield rows
            rows = []


def _facts(rows: list[list[str]]) -> dict[str, str]:
    values: dict[str, str] = {}
    for name, value, *_ in rows:
        values.setdefault(plain(name).lower(), value)
    facts = {}
    for fact, names in TOPICS.items():
        value = next((values[name] for name in names if name in values), "")
        if value and not value.startswith(TO_DO):
            facts[fact] = value
    return facts


def _column_names(cell: str) -> list[str]:
    """Return the names in a cell such as "`q1_deg` .. `q6_deg`" or "`site`"."""
    if span := _RANGE.search(cell):
        return [f"{span[1]}{i}{span[3]}" for i in range(int(span[2]), int(span[4]) + 1)]
    return re.findall(r"`([^`]+)`", cell) or [cell]


def _instrument_noise(card: Path, text: str) -> float:
    for number, line in enumerate(text.splitlines(), start=1):
        if stated := NOISE_LINE.match(line):
            value = stated[1].strip(" |")
            match = NOISE.match(value)
            noise_mm = 0.0
            if match:
                noise_mm = float(match["number"]) * UNITS["mm"][match["unit"].lower()]
            if not match or not 0.0 < noise_mm <= MAX_NOISE_MM:
                raise DataError(
                    f"{card}: line {number}, instrument noise: {value[:MAX_SHOWN]!r}, expected "
                    f"{NOISE_VALID}, at most {MAX_NOISE_MM:g} mm; leave the line out if it is "
                    "not known"
                )
            return float(noise_mm / MM_PER_M * READINGS[match["of"].lower()])
    return 0.0
