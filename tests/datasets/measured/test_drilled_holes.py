"""Check the drilled holes: their file, their card, and the drill's positions."""

from __future__ import annotations

from hashlib import sha256
from importlib.resources import files
from pathlib import Path

import numpy as np
import pandas as pd
import pytest

from stiff_datasets.dataset_catalog import DATASETS, DRILLED_HOLES
from stiff_datasets.measured.drilled_holes import DRILL_AXIS, drilled_holes
from stiff_datasets.robots.shipped_robots import named_robot

SHARED = Path(__file__).parents[4] / "shared" / "data" / "fanuc_r2000ic_sjtu"
JOINTS = [f"q{i}_deg" for i in range(1, 7)]


def test_twenty_holes_in_four_sites_and_eight_further_tests():
    holes = drilled_holes()
    assert holes.groupby("site").size().to_dict() == {"A": 5, "B": 5, "C": 5, "D": 5, "V": 8}
    assert holes["diameter_mm"].isna().sum() == 8
    assert not holes.drop(columns="diameter_mm").isna().any(axis=None)


def test_the_five_postures_of_a_site_drill_at_one_point_along_one_axis():
    holes, robot = drilled_holes(), named_robot("fanuc-r2000ic").robot()
    for _, site in holes[holes.site != "V"].groupby("site"):
        q = np.radians(site[JOINTS].to_numpy())
        tips = robot.tcp_position(q)
        axes = robot.forward(q).rotation @ (robot.flange[:3, :3] @ DRILL_AXIS)
        assert np.linalg.norm(tips - tips.mean(axis=0), axis=1).max() < 0.010
        assert (axes @ axes[0]).min() > np.cos(np.radians(0.1))


def test_the_card_names_source_licence_and_checksum():
    folder = files("stiff_datasets") / "data"
    card = (folder / "fanuc_drilling.md").read_text("utf-8")
    checksum = sha256((folder / "fanuc_drilling.csv").read_bytes()).hexdigest()
    for fact in (checksum, "e5c2f795", "MIT", "(c) 2026 longton2001-pixel"):
        assert fact in card


def test_no_model_is_fitted_to_them():
    assert DRILLED_HOLES.key not in [info.key for info in DATASETS]


@pytest.mark.skipif(not SHARED.is_dir(), reason="needs the original files")
def test_the_shipped_file_holds_the_original_numbers():
    sources = [SHARED / f"fanuc_drilling_{name}.csv" for name in ("postures", "validation")]
    source = pd.concat([pd.read_csv(path) for path in sources], ignore_index=True)
    holes = drilled_holes()
    r1, r2, r3, r4, r5, r6 = source.filter(like="theta").to_numpy().T
    expected = np.stack([r1, r2, -(r2 + r3), -r4, -r5, -r6], axis=1)
    np.testing.assert_allclose(holes[JOINTS], expected, atol=1e-9)
    np.testing.assert_array_equal(holes["feed_mm_s"], source["vfeed_mm_s"])
    np.testing.assert_array_equal(holes["surge_mm_s"], source["vsurge_mm_s"])
