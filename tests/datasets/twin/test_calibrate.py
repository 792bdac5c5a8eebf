"""The shipped constants are those of the record, and give the figures that it states."""

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


def assert_figures(found, stated):
    for name in ("mae", "stde", "me"):
        np.testing.assert_allclose(getattr(found, name) * 1000, stated[f"{name}_mm"], atol=0.00011)
    np.testing.assert_allclose(found.stiffness, stated["stiffness_Nm_per_rad"], rtol=1e-4)


NUMBER = r"[-+]?\d+(?:\.\d+)?"


@pytest.mark.parametrize("number", CALIBRATIONS)
def test_the_shipped_constants_are_those_that_were_found(number):
    constants = CALIBRATIONS[number].constants().model_dump(mode="json", exclude_none=True)
    for name in ("name", "urdf", "tcp_m", "payload_kg", "hook_m", "joint", "noise"):
        assert constants[name] == record(number)["constants"][name]


@pytest.mark.parametrize("number", CALIBRATIONS)
def test_the_shipped_constants_give_the_figures_of_the_record(number):
    twin, search, stated = CALIBRATIONS[number], SEARCHES[number], record(number)
    found = line_figures(twin.constants(), seeds=search.seeds[1], poses=twin.poses())
    assert_figures(found, stated["specimens"][0])
    assert [stated["search_seeds"], stated["figure_seeds"]] == [[*one] for one in search.seeds]
    assert not set(stated["search_seeds"]) & set(stated["figure_seeds"])
    assert np.abs(found.stiffness / paper_figures().stiffness - 1).max() < 0.25


@pytest.mark.slow
def test_the_card_shows_the_figures_of_every_specimen_of_the_records():
    found = {number: specimen_figures(number) for number in CALIBRATIONS}
    for number, specimens in found.items():
        for figures, stated in zip(specimens, record(number)["specimens"], strict=True):
            assert_figures(figures, stated)
    card = (files("stiff_datasets") / "data" / "kr10_twin.md").read_text(encoding="utf-8")
    assert_alike(figures_text(found, paper_figures()), card)


def assert_alike(table, card):
    """The card has the table; another machine may round a last digit the other way."""
    start = card.index(table.splitlines()[0])
    shown = card[start : card.index("\n\n", start)]
    assert re.sub(NUMBER, "#", table).split() == re.sub(NUMBER, "#", shown).split()
    for found, stated in zip(re.findall(NUMBER, table), re.findall(NUMBER, shown), strict=True):
        last_digit = 10.0 ** -len(stated.partition(".")[2])
        assert abs(float(found) - float(stated)) < 1.5 * last_digit
