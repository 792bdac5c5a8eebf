"""Check plans of a gauge's readings: forces of a workshop, their sizes, and the file to fill in."""

from __future__ import annotations

import numpy as np
import pandas as pd
import pytest

import stiffbench as sb
from stiff_datasets.planning.plan import FORCE_SHARE, LEAST_SHARE
from stiff_datasets.planning.reachable import LIMIT_MARGINS
from stiff_protocols.contract.errors import ConfigError, DataError
from stiff_protocols.contract.robot import STANDARD_GRAVITY

PAYLOAD = 10.0


def planned(tmp_path, **options):
    """Return the report and the table of a plan of 12 readings of the KR10."""
    file = tmp_path / "plan.csv"
    report = sb.plan_poses(file, readings=12, candidates=15, **options)
    return str(report), pd.read_csv(file, dtype={"pose_id": str})


def test_readings_are_forces_of_weight_and_rope_in_drawn_sizes(tmp_path, kr10):
    _, table = planned(tmp_path)
    hangs = table["mass_kg"].notna()
    assert 0 < hangs.sum() < len(table) == 12
    force = table["mass_kg"].fillna(0.0) * STANDARD_GRAVITY + table["pull_N"].fillna(0.0)
    largest = FORCE_SHARE * PAYLOAD * STANDARD_GRAVITY
    assert (force > 0.99 * LEAST_SHARE * largest).all() and (force < 1.01 * largest).all()
    assert force.nunique() > 6
    pulls = table.loc[~hangs, ["pull_x", "pull_y", "pull_z"]].to_numpy()
    np.testing.assert_array_equal(pulls, np.tile([0.0, 1.0, 0.0], (len(pulls), 1)))
    directions = table[["reading_x", "reading_y", "reading_z"]].to_numpy()
    assert {tuple(row) for row in directions} <= {(0.0, 1.0, 0.0), (0.0, 0.0, 1.0)}
    q = np.deg2rad(table[[f"q{i}_deg" for i in range(1, 7)]].to_numpy())
    margin = LIMIT_MARGINS[0] - 1e-5
    assert (q > kr10.lower + margin).all() and (q < kr10.upper - margin).all()


def test_weights_never_turn_a_vertical_joint_and_the_plan_says_so(tmp_path):
    report, table = planned(tmp_path, forces="weight")
    assert "o load turns A1: add a horizontal pull" in report
    assert "pull_N" not in table
    (tmp_path / "plan.csv").unlink()
    report, _ = planned(tmp_path, forces="weight,pull:0,2,0")
    assert "A1" not in report


def test_a_filled_plan_is_read_with_its_loads_at_the_hook(tmp_path, kr10):
    hook = (0.1, 0.0, 0.08)
    planned(tmp_path, hook=hook)
    file = tmp_path / "plan.csv"
    with pytest.raises(DataError, match="not filled in"):
        sb.read_samples(file, robot=kr10, hook=hook)
    table = pd.read_csv(file).assign(reading0_mm=1.0, reading1_mm=np.linspace(1.2, 1.5, 12))
    table.to_csv(file, index=False)
    samples = sb.read_samples(file, robot=kr10, hook=hook).samples
    assert samples.directions.shape == (12, 1, 3) and samples.wrench[:, 3:].any()
    np.testing.assert_allclose(np.sort(samples.values[:, 0]), np.linspace(2e-4, 5e-4, 12))


def test_weights_of_a_plan_of_poses_hang(tmp_path):
    file = tmp_path / "plan.csv"
    report = str(sb.plan_poses(file, poses=12, candidates=60, loads="weights"))
    table = pd.read_csv(file)
    assert not table[["fx_N", "fy_N"]].to_numpy().any() and (table["fz_N"] < 0.0).all()
    assert "o load turns A1" in report


@pytest.mark.parametrize(
    ("options", "word"),
    [
        ({"forces": "rope"}, "forces"),
        ({"forces": "pull:0,0,0"}, "forces"),
        ({"axes": "z,w"}, "axes"),
        ({"axes": "z,z"}, "axes"),
        ({"poses": 5}, "readings"),
        ({"loads": "weights"}, "readings"),
    ],
)
def test_an_option_that_a_plan_of_readings_does_not_have_is_named(tmp_path, options, word):
    with pytest.raises(ConfigError) as error:
        planned(tmp_path, **options)
    assert word in str(error.value)
