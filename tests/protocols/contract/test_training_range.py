"""What lies beyond the samples that a model learned from."""

from __future__ import annotations

import numpy as np
import pytest

from helpers.quick_models import twin_data
from stiff_protocols.contract.errors import DataError
from stiff_protocols.contract.training_range import TrainingRange
from stiff_protocols.contract.types import Interval


@pytest.fixture(scope="module")
def samples():
    return twin_data().samples


def test_training_samples_and_what_is_a_little_beyond_them_are_inside(samples):
    known = TrainingRange.of(samples)
    assert not any(known.extrapolates(samples.q, 1.05 * samples.wrench))
    tenth = 0.09 * (known.upper - known.lower)
    ends = np.array([known.lower - tenth, known.upper + tenth])
    assert not any(known.extrapolates(ends, samples.wrench[:2]))
    unturned = TrainingRange(known.lower, known.upper, force=100.0, torque=0.0)
    wrench = np.array([[0.0, 0.0, -80.0, rounding, 0.0, 0.0] for rounding in (1e-9, 1.0)])
    assert unturned.extrapolates(samples.q[:2], wrench) == ["", "load"]


def test_each_joint_and_load_far_beyond_is_marked(samples):
    known = TrainingRange.of(samples)
    q, wrench = np.tile(samples.q[:1], (6, 1)), np.tile(samples.wrench[:1], (6, 1))
    for end, turn in ((known.lower, -1.0), (known.upper, 1.0)):
        off = np.where(np.eye(6, dtype=bool), end + turn * np.deg2rad(60.0), q)
        np.testing.assert_array_equal(known.beyond(off, wrench)[:, :6], np.eye(6, dtype=bool))
        assert known.extrapolates(off, wrench) == ["joints"] * 6
        assert known.extrapolates(off, 5.0 * wrench) == ["joints load"] * 6
    heavy = wrench[:3].copy()
    heavy[0, :3] *= 5.0
    heavy[1, 3:] *= 30.0
    assert known.extrapolates(q[:3], heavy) == ["load", "load", ""]


def steady(q, wrench):
    """+-1 mm about a deflection of 1 mm an N up to 10 N, where the model stops growing."""
    middle = 1e-3 * np.minimum(wrench[:, :3], 10.0)
    return Interval(middle - 1e-3, middle + 1e-3, 0.9)


@pytest.mark.parametrize(
    ("joint", "force", "half"),
    [
        (0.5, 10.0, 1e-3),  # inside
        (1.5, 10.0, 1.5e-3),  # half a radian beyond
        (-1.0, 10.0, 2e-3),
        (0.5, 30.0, 3e-3 + 20e-3),  # three times 1 mm, and to where three times 10 N would lead
        (1.5, 30.0, 1.5 * (3e-3 + 20e-3)),
    ],
)
def test_an_interval_grows_with_the_load_and_the_way_beyond_the_range(joint, force, half):
    known = TrainingRange(np.zeros(2), np.ones(2), force=10.0, torque=0.0)
    q, wrench = np.array([[joint, 0.5]] * 2), np.zeros((2, 6))
    wrench[:, 0] = force
    q[1], wrench[1, 0] = 0.5, 10.0  # a row inside stays as it is
    found = known.widened(steady, q, wrench)
    middle = steady(q, wrench).lower[:, 0] + 1e-3
    np.testing.assert_allclose(found.upper[:, 0] - middle, [half, 1e-3])
    np.testing.assert_allclose(middle - found.lower[:, 0], [half, 1e-3])


def test_of_an_unusual_torque_the_mark_is_of_the_torque_and_the_width_of_force_and_torque():
    known = TrainingRange(np.zeros(2), np.ones(2), force=140.0, torque=0.0)  # the FANUC's
    inside = np.full((2, 2), 0.5)
    wrench = np.array([[60.0, 0, 0, 0, 0, 40.0], [120.0, 0, 0, 0, 0, 40.0]])
    assert known.extrapolates(inside, wrench) == ["load", "load"]
    found, usual = known.widened(steady, inside, wrench), steady(inside, wrench)
    # 60 N + 40 N m / 1 m is no larger a load than 140 N; 120 N + 40 N m is 8 / 7 of it
    reached = (found.upper - found.lower)[:, 0] / (usual.upper - usual.lower)[:, 0]
    np.testing.assert_allclose(reached, [1.0, (8 / 7 * 1.0 + 8 / 7 * 10.0 - 10.0)], rtol=1e-12)


@pytest.mark.parametrize(
    ("changed", "named"),
    [
        ({"lower": [0.0, np.nan]}, "nan"),
        ({"lower": [0.0, 0.0, 0.0]}, "ends"),
        ({"lower": [0.0, 9.0]}, "ends"),
        ({"force": np.inf}, "inf"),
        ({"torque": -1.0}, "-1"),
    ],
)
def test_a_range_that_is_none_is_refused(changed, named):
    usual = {"lower": [0.0, 0.0], "upper": [1.0, 1.0], "force": 1.0, "torque": 1.0}
    with pytest.raises(DataError, match=named):
        TrainingRange(**usual | changed)
    with pytest.raises(DataError, match="2 joints"):
        TrainingRange(**usual).beyond(np.zeros((1, 6)), np.zeros((1, 6)))
