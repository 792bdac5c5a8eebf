"""What a data card FILE.md beside FILE.csv tells the tool; the rest of it is for people.

Two lines are read, wherever they stand: one that says "torques were not measured" (or recorded),
and the instrument's noise, ``Instrument noise: 0.02 mm a reading``, as a line or a table's row.
"""

from __future__ import annotations

import re
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from stiff_datasets.measured.sample_columns import MM_PER_M, UNITS
from stiff_protocols.contract.errors import DataError

NO_TORQUE = re.compile(
    r"^.*\btorques?\b.*\bnot (measured|recorded)\b", re.IGNORECASE | re.MULTILINE
)
NOISE_LINE = re.compile(r"^[\s|*_-]*instrument noise[\s*_]*[:|](.*)$", re.IGNORECASE)
NOISE = re.compile(
    r"[\s*_]*(?P<number>\d+(\.\d*)?|\.\d+) ?(?P<unit>mm|µm|μm|um) (a|per) "
    r"(?P<of>reading|deflection)\b",
    re.IGNORECASE,
)
LARGEST_NOISE_MM = 10.0
NOISE_VALID = "a number, mm or µm, then 'a reading' or 'a deflection', e.g. '0.02 mm a reading'"
LONGEST_SHOWN = 60
READINGS = {"reading": np.sqrt(2.0), "deflection": 1.0}
"""A deflection is the difference of two readings: so many times their standard deviation."""


@dataclass(frozen=True)
class DataCard:
    """What a card states.

    Attributes:
        no_torque: torques were not measured.
        instrument_noise: standard deviation of a measured deflection's error, m, of each axis; 0
            where the card does not state it.
    """

    no_torque: bool = False
    instrument_noise: float = 0.0


def read_card(path: Path) -> DataCard:
    """Read the card beside a file of samples; a file without one has an empty card.

    Args:
        path: the file of samples.

    Raises:
        DataError: the noise cannot be read; the message names the card, its line and the value.
    """
    card = path.with_suffix(".md")
    if card == path or not card.is_file():
        return DataCard()
    text = card.read_text(encoding="utf-8", errors="replace")
    return DataCard(bool(NO_TORQUE.search(text)), _instrument_noise(card, text))


def _instrument_noise(card: Path, text: str) -> float:
    for number, line in enumerate(text.splitlines(), start=1):
        if said := NOISE_LINE.match(line):
            value = said[1].strip(" |")
            found = NOISE.match(value)
            noise_mm = 0.0
            if found:
                noise_mm = float(found["number"]) * UNITS["mm"][found["unit"].lower()]
            if not found or not 0.0 < noise_mm <= LARGEST_NOISE_MM:
                raise DataError(
                    f"{card}: line {number}, instrument noise: {value[:LONGEST_SHOWN]!r}, expected "
                    f"{NOISE_VALID}, at most {LARGEST_NOISE_MM:g} mm; leave the line out if it is "
                    "not known"
                )
            return float(noise_mm / MM_PER_M * READINGS[found["of"].lower()])
    return 0.0
