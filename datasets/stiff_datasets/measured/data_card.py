"""Read the facts of a data card FILE.md next to FILE.csv, and write new cards.

The rest of a card is not evaluated. These are read:

- "torques were not measured" (or recorded), anywhere in a line;
- the instrument's noise, ``Instrument noise: 0.02 mm per reading``, as a line or a row of a table;
- the rows of the card's first table, such as ``| Licence | CC-BY-4.0 |``: see `TOPICS`;
- the meanings of columns, in a table with the header ``| column | meaning |``.
"""

from __future__ import annotations

import re
from collections.abc import Iterable, Iterator, Mapping
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np

from stiff_datasets.measured.sample_columns import (
    MM_PER_M,
    SIMULATED_GROUP,
    UNITS,
    counted,
    in_file_units,
)
from stiff_protocols.contract.display import one_line, printable
from stiff_protocols.contract.errors import DataError
from stiff_protocols.contract.types import BenchmarkData

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
FILL_IN = {
    "Licence": "an SPDX identifier such as CC-BY-4.0, or the URL of the licence",
    "Citation": "authors, title and year, or the DOI of the paper",
    "Source": "URL where the data are published",
    "Version": "MAJOR.MINOR.PATCH",
    "Published": "YYYY-MM-DD",
}
"""Row that published data should state -> hint what to enter, in the order of the card."""
TOPICS = {
    **{row.lower(): (row.lower(),) for row in ("What", "Robot", *FILL_IN)},
    "licence": ("licence", "license"),
    "citation": ("citation", "cite as", "paper"),
}
"""Fact -> names of its row, in lower case; the first row counts."""
FIRST_VERSION = "1.0.0"
UNKNOWNS = """## How it was measured

TODO: instruments, dates, temperature, procedure, who measured.
State the noise of the instrument in a row of the table above, such as `| Instrument noise | 0.02 mm per reading |`.

## What is unknown

TODO"""  # noqa: E501
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
    return parse_card(earlier_card(path), card_file(path))


def earlier_card(path: Path) -> str:
    """Return the text of the card next to a file of samples; "" if there is none."""
    card = card_file(path)
    if card == path or not card.is_file():
        return ""
    return card.read_text(encoding="utf-8", errors="replace")


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


def new_card(
    name: str, data: BenchmarkData, rows: Mapping[str, str], origin: str = "", earlier: str = ""
) -> str:
    """Return the card of a user's file or an exported data set in Markdown.

    Missing rows of `FILL_IN` get a hint what to enter.

    Args:
        name: name of the data set.
        data: its samples and their robot.
        rows: rows of the card's table, besides the usual ones or in place of them.
        origin: name of the data set or file that an earlier card describes.
        earlier: text of that card, which is inserted below; "" if there is none.
    """
    usual = {"What": what_text(data), "Robot": robot_text(data), "Version": FIRST_VERSION}
    rows = {**usual, **rows}
    noise_mm = in_file_units(np.array([data.samples.instrument_noise]), MM_PER_M)[0]
    if noise_mm and not any(map(NOISE_LINE.match, earlier.splitlines())):
        number = np.format_float_positional(noise_mm, trim="-")
        rows["Instrument noise"] = f"{number} mm per deflection"
    if rows.pop("Torques", "") and not states_no_torque(earlier):
        rows["Torques"] = "not measured"
    needed = {row: f"{TO_DO}: {hint}" for row, hint in FILL_IN.items() if not rows.get(row)}
    lines = [f"| {row} | {value} |" for row, value in {**rows, **needed}.items() if value]
    body = f"## The data card of {origin}\n\n{_below(earlier)}" if earlier.strip() else UNKNOWNS
    return "\n".join(
        [f"# Data card: {one_line(name)}", "", "| | |", "|---|---|", *lines, "", body, ""]
    )


def what_text(data: BenchmarkData) -> str:
    """Return the row "What" of a user's card: the content, and SIMULATED if it is."""
    samples = data.samples
    count = counted(len(samples), "sample")
    poses = counted(len(np.unique(samples.pose_id)), "pose")
    origin = "SIMULATED: " if SIMULATED_GROUP in samples.group else ""
    return f"{origin}{count} of loads and TCP deflections at {poses}"


def robot_text(data: BenchmarkData) -> str:
    """Return robot, number of joints and TCP for a card's row."""
    robot = data.robot
    return one_row(f"{robot.joints_text}, TCP {tcp_text(robot.tcp_on_flange)} m")


def tcp_text(tcp: Iterable[float]) -> str:
    """Return a (3,) TCP, m, as text with all digits: "0.06,0,0.08"."""
    return ",".join(np.format_float_positional(length, trim="-") for length in tcp)


def tcp_option(tcp: Iterable[float]) -> str:
    """Return the option `--tcp` for a (3,) TCP, m in the frame of the robot's last link."""
    text = tcp_text(tcp)
    return f"--tcp={text}" if text.startswith("-") else f"--tcp {text}"


def one_row(text: str) -> str:
    """Return a text as a cell of a Markdown table."""
    return printable(" ".join(text.split())).replace("|", r"\|")


def fact_rows(card: DataCard) -> dict[str, str]:
    """Return the rows of `FILL_IN` that a card states."""
    rows = {row: card.facts.get(row.lower(), "") for row in FILL_IN}
    return {row: without_relative_links(value) for row, value in rows.items() if value}


def _below(card: str) -> str:
    """Return a card to insert below a heading: its headings move one level down."""
    lines: list[str] = []
    in_code = False
    for line in without_relative_links(card).strip().splitlines():
        in_code ^= line.startswith("```")
        if line.startswith("# ") and not in_code and not lines:
            continue
        lines.append(f"#{line}" if line.startswith("#") and not in_code else line)
    return "\n".join(lines).strip()
