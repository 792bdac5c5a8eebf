"""Check which facts of data cards are read and which values are refused."""

from __future__ import annotations

import pytest

from helpers.made_samples import CSV_HEADER, CSV_ROW
from stiff_datasets.measured.data_card import DataCard, read_card
from stiff_datasets.measured.sample_file import read_samples
from stiff_datasets.measured.validation_report import validate
from stiff_protocols.contract.errors import DataError


@pytest.fixture()
def file(tmp_path):
    path = tmp_path / "my.csv"
    path.write_text(f"{CSV_HEADER}\n{CSV_ROW}\n")
    return path


def write_and_read_card(file, *lines):
    file.with_suffix(".md").write_text("\n".join(["# Data card", "", *lines, ""]))
    return read_card(file)


@pytest.mark.parametrize(
    ("line", "noise"),
    [
        ("Instrument noise: 0.02 mm a reading", 0.02e-3 * 2**0.5),
        ("Instrument noise: 0.02 mm a deflection", 0.02e-3),
        ("| Instrument noise | 15 µm per deflection (laser tracker) |", 15e-6),
        ("- **Instrument noise:** 15 um per reading, one sigma", 15e-6 * 2**0.5),
        ("The instrument's noise is not known.", 0.0),
    ],
)
def test_the_noise_of_a_deflection_is_that_of_two_readings(file, line, noise, kr10):
    assert write_and_read_card(file, line).instrument_noise == pytest.approx(noise)
    assert read_samples(file, kr10).instrument_noise == pytest.approx(noise)


def test_a_file_without_a_card_has_an_empty_one(file):
    assert read_card(file) == DataCard() == write_and_read_card(file, "Measured in 2026.")
    assert read_card(file.with_suffix(".md")) == DataCard()  # a file of samples named so


@pytest.mark.parametrize(
    "value",
    ["unknown", "0.02", "0 mm a reading", "-1 mm a reading", "1 cm a reading", "11 mm a reading"],
)
def test_a_noise_that_cannot_be_read_is_refused_with_its_line(file, value, kr10):
    with pytest.raises(DataError) as caught_error:
        write_and_read_card(file, f"| Instrument noise | {value} |")
    message = str(caught_error.value)
    assert f"my.md: line 3, instrument noise: {value!r}, expected a number" in message
    with pytest.raises(DataError, match=r"my\.md: line 3"):
        read_samples(file, kr10)
    (error,) = validate(file, kr10).errors
    assert "line 3, instrument noise" in error.message
