"""The README's numbers are what its commands and the committed results give."""

from __future__ import annotations

import re
from pathlib import Path

import numpy as np
import pytest

import stiffbench as sb
from stiff_bench.results.scores import complete_logs

TOP = Path(__file__).parents[1]
README = (TOP / "README.md").read_text(encoding="utf-8")
MOST_LINES, MOST_CHARACTERS = 110, 100
ROBOTS = {"KR10": "kr10_r1100_2", "UR5": "ur5", "GP180": "gp180"}
POSES = ("5 poses", "20 poses", "60 poses")


def table_after(heading: str) -> list[dict[str, str]]:
    """The first table behind a heading, a dictionary per row; cells without their marks."""
    lines = README.split(f"## {heading}\n")[1].splitlines()
    start = next(number for number, line in enumerate(lines) if line.startswith("|"))
    rows = []
    for line in lines[start:]:
        if not line.startswith("|"):
            break
        rows.append([cell.strip(" *") for cell in line.strip("|").split("|")])
    header, _, *body = rows
    return [dict(zip(header, row, strict=True)) for row in body]


def model_of(row: dict[str, str]) -> str:
    (name,) = re.findall(r"`([^`]+)`", row["model"])
    return name


def test_it_is_short_and_fits_a_terminal():
    lines = README.splitlines()
    assert len(lines) <= MOST_LINES
    assert max(map(len, lines)) <= MOST_CHARACTERS


@pytest.mark.slow
def test_the_first_table_is_what_its_command_gives():
    rows = {model_of(row): row for row in table_after("Try it")}
    results = sb.evaluate([*rows], "kr10-twin", protocol="holdout", splits=5)
    errors = results.frame().groupby("model")["norm_mm"].mean()
    for model, row in rows.items():
        assert float(row["3-D error, mm"]) == pytest.approx(errors[model], abs=0.0006)
        if row["against the VJM"]:
            change = 100.0 * (errors[model] / errors["vjm"] - 1.0)
            assert float(row["against the VJM"].rstrip(" %")) == pytest.approx(change, abs=0.6)


@pytest.fixture(scope="module")
def models(written_leaderboard):
    """Return the rows of the committed leaderboard by model."""
    return {row["model"]: row for row in written_leaderboard.board.board_frame.to_dict("records")}


@pytest.mark.slow
@pytest.mark.xdist_group("leaderboard")  # written once
def test_the_matrix_of_robots_is_that_of_the_committed_leaderboard(written_leaderboard, models):
    ratios = np.exp(complete_logs(written_leaderboard.board.scores))
    measured = "fanuc-r2000ic"
    for row in table_after("Which model"):
        name = model_of(row)
        for heading, robot in ROBOTS.items():
            assert row[heading] == f"{ratios.loc[robot, name]:.2f}"
        numbers = models[name]
        assert row["FANUC, measured"] == f"{numbers['measured', measured]:.2f}"
        text = f"{numbers['ratio']:.2f} ({numbers['low']:.2f} to {numbers['high']:.2f})"
        assert row[f"{len(ratios)} simulated robots"] == text


@pytest.mark.slow
@pytest.mark.xdist_group("leaderboard")
def test_the_ratios_by_number_of_poses_are_those_of_the_committed_leaderboard(models):
    (advice,) = re.findall(r"With 5, 20, 60 and 120 poses.*?\. ", README, re.DOTALL)
    ratios = re.findall(r"0\.\d\d", advice)
    names = ("bayes-springs", "vjm-full")
    keys = [*(("few", poses) for poses in POSES), "ratio"]
    assert ratios == [f"{models[name][key]:.2f}" for name in names for key in keys]
