"""What lies outside of the samples that a model learned from."""

from __future__ import annotations

import numpy as np
import pytest

from quick_models import twin_data
from stiff_protocols.contract.training_range import TrainingRange


@pytest.fixture(scope="module")
def samples():
    return twin_data().samples


def test_training_samples_and_what_is_a_little_beyond_them_are_inside(samples):
    known = TrainingRange.of(samples)
    assert not any(known.outside(samples.q, 1.05 * samples.wrench))


def test_each_joint_and_load_far_beyond_is_named(samples):
    known = TrainingRange.of(samples)
    wrench = samples.wrench[:1]
    for joint in range(6):
        q = samples.q[:1].copy()
        q[0, joint] = known.upper[joint] + 0.1 + 0.2 * (known.upper - known.lower)[joint]
        assert known.outside(q, wrench) == [f"q{joint + 1}"]
    heavy = np.tile(wrench, (2, 1))
    heavy[0, :3] *= 3.0
    heavy[1, 3:] *= 30.0
    assert known.outside(np.tile(samples.q[:1], (2, 1)), heavy) == ["force", "torque"]
