"""Check that the shipped constants match the record and give its figures."""

from __future__ import annotations

import json
import re
from importlib.resources import files
from pathlib import Path

import numpy as np
import pytest

from calibrate import (
    SEARCHES,
    figures_text,
    line_figures,
    paper_figures,
    specimen_figures,
)
from stiff_datasets.twin.kr10_twin import CALIBRATIONS

RECORDS = Path(__file__).parents[3] / "results" / "calibration"


def record(number):
    return json.loads((RECORDS / f"{CALIBRATIONS[number].name}.json").read_text("utf-8"))


def assert_figures(figures, stated):
    for name in ("mae", "stde", "me"):
        np.testing.assert_allclose(
            getattr(figures, name) * 1000, stated[f"{name}_mm"], atol=0.00011
        )
    np.testing.assert_allclose(figures.stiffness, stated["stiffness_Nm_per_rad"], rtol=1e-4)


NUMBER = r"[-+]?\d+(?:\.\d+)?"


@pytest.mark.parametrize("number", CALIBRATIONS)
def test_the_shipped_constants_are_those_that_were_found(number):
    constants = CALIBRATIONS[number].constants().model_dump(mode="json", exclude_none=True)
    for name in ("name", "urdf", "tcp_m", "payload_kg", "hook_m", "joint", "noise"):
        assert constants[name] == record(number)["constants"][name]


@pytest.mark.parametrize("number", CALIBRATIONS)
def test_the_shipped_constants_give_the_figures_of_the_record(number):
    twin, search, stated = CALIBRATIONS[number], SEARCHES[number], record(number)
    figures = line_figures(twin.constants(), seeds=search.seeds[1], poses=twin.poses())
    assert_figures(figures, stated["specimens"][0])
    assert [stated["search_seeds"], stated["figure_seeds"]] == [[*seeds] for seeds in search.seeds]
    assert not set(stated["search_seeds"]) & set(stated["figure_seeds"])
    assert np.abs(figures.stiffness / paper_figures().stiffness - 1).max() < 0.25


@pytest.mark.slow
def test_the_card_shows_the_figures_of_every_specimen_of_the_records():
    figures_by_number = {number: specimen_figures(number) for number in CALIBRATIONS}
    for number, specimens in figures_by_number.items():
        for figures, stated in zip(specimens, record(number)["specimens"], strict=True):
            assert_figures(figures, stated)
    card = (files("stiff_datasets") / "data" / "kr10_twin.md").read_text(encoding="utf-8")
    assert_alike(figures_text(figures_by_number, paper_figures()), card)


def assert_alike(table, card):
    """Check that the card has the table; a last digit may be rounded differently."""
    start = card.index(table.splitlines()[0])
    card_table = card[start : card.index("\n\n", start)]
    assert re.sub(NUMBER, "#", table).split() == re.sub(NUMBER, "#", card_table).split()
    for number, stated in zip(
        re.findall(NUMBER, table), re.findall(NUMBER, card_table), strict=True
    ):
        last_digit = 10.0 ** -len(stated.partition(".")[2])
        assert abs(float(number) - float(stated)) < 1.5 * last_digit
