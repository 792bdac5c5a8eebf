"""Samples made for tests."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import replace

import numpy as np

from stiff_protocols.contract.types import FloatArray, IntArray, Samples, Split, TextArray

CSV_HEADER = (
    "pose_id,load_id,group,q1_deg,q2_deg,q3_deg,q4_deg,q5_deg,q6_deg,"
    "fx_N,fy_N,fz_N,tx_Nm,ty_Nm,tz_Nm,dx_mm,dy_mm,dz_mm"
)
CSV_ROW = "P1,1,all,10,-60,70,0,40,0,50,10,-80,1,2,0,0.5,0.1,-0.9"
"""A measurement of a robot with six joints as a user's file, invented."""


def samples_with(
    q: FloatArray, wrench: FloatArray, deflection: FloatArray, **names: TextArray
) -> Samples:
    """Return samples with one load per pose and one group, unless `names` has others."""
    n = len(q)
    usual = {
        "pose_id": np.arange(n).astype(str),
        "load_id": np.full(n, "1"),
        "group": np.full(n, "all"),
    }
    return Samples(q=q, wrench=wrench, deflection=deflection, **(usual | names))


def with_other_labels(samples: Samples) -> Samples:
    """Return the same poses and loads with twice the deflections of the opposite rows."""
    return replace(samples, deflection=2.0 * samples.deflection[::-1])


def unloaded(n_poses: int, loads: int = 1) -> Samples:
    """Return poses p0, p1, ... of one group, several rows each, all numbers zero."""
    n = n_poses * loads
    samples = samples_with(np.zeros((n, 6)), np.zeros((n, 6)), np.zeros((n, 3)))
    return replace(samples, pose_id=np.repeat([f"p{i}" for i in range(n_poses)], loads))


def learned(split: Split) -> IntArray:
    """Return the row numbers of the training side."""
    return np.concatenate([split.train, split.validation])


def assert_no_pose_is_parted(samples: Samples, splits: Iterable[Split]) -> None:
    for split in splits:
        parts = [set(samples.pose_id[rows]) for rows in (split.train, split.validation, split.test)]
        assert sum(map(len, parts)) == len(set.union(*parts))
