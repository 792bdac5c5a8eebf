"""Load `fanuc-drilling`: 28 holes drilled by a FANUC R-2000iC (card: data/fanuc_drilling.md)."""

from __future__ import annotations

from importlib.resources import as_file, files
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from pandas import DataFrame

DRILL_AXIS = (0.0, 1.0, 0.0)
"""Direction of the drill in the frame of the flange."""
FURTHER_TESTS = "V"
"""Site of the eight tests at separate places and feeds."""


def drilled_holes() -> DataFrame:
    """Return the drilled holes: posture, feed and breakthrough surge, a row per hole.

    They have no deflections: models are checked on them, not trained.

    Returns:
        ``hole``, ``site`` (A to D with five postures each, V for eight further tests),
        ``q1_deg`` .. ``q6_deg`` (joint positions of the robot "fanuc-r2000ic"), ``feed_mm_s``,
        ``surge_mm_s`` (speed of the tool when the drill breaks through), ``diameter_mm`` of the
        hole (NaN for the further tests).
    """
    from pandas import read_csv

    with as_file(files("stiff_datasets") / "data" / "fanuc_drilling.csv") as path:
        return read_csv(path)
