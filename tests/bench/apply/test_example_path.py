"""Check example paths inside the training range of a model."""

from __future__ import annotations

import numpy as np
import pytest

import stiffbench as sb
from stiff_apply import example_path
from stiff_apply.example_path import path_near_training, training_load
from stiff_protocols.contract.errors import DataError
from stiff_protocols.contract.training_range import TrainingRange
from stiff_protocols.paths.inverse import follow

SIZE = 0.15


@pytest.fixture()
def few_centres(monkeypatch):
    """Try fewer training poses, for tests that do not need the best one."""
    monkeypatch.setattr(example_path, "CENTRES", 12)
    monkeypatch.setattr(example_path, "FOLLOWED", 2)


@pytest.mark.parametrize(
    "name",
    [
        *(pytest.param(n, marks=pytest.mark.slow) for n in ("kr10-twin", "ur5-twin")),
        "fanuc-r2000ic",
    ],
)
def test_path_and_load_lie_inside_the_training_range_and_can_be_driven(name):
    data = sb.load_dataset(name)
    training_range = TrainingRange.of(data.samples, data.robot)
    load = training_load(training_range)
    path, words = path_near_training(data.robot, training_range, "square", SIZE, 40, wrench=load)
    middle = 0.5 * (training_range.lower + training_range.upper)
    driven = follow(data.robot, path.position, path.rotation, near=middle)
    assert driven.ok.all()
    assert not any(training_range.extrapolates(driven.q, path.wrench)) and not any(words)
    np.testing.assert_allclose(np.ptp(path.position, axis=0), [SIZE, SIZE, 0.0], atol=1e-8)
    assert path.wrench[0, 2] < 0.0


@pytest.mark.usefixtures("few_centres")
def test_joints_that_training_never_moved_are_held(twin):
    training_range = TrainingRange.of(twin.samples, twin.robot)
    still = training_range.upper == training_range.lower
    assert still.any()
    near, _ = path_near_training(
        twin.robot, training_range, "circle", SIZE, 12, wrench=training_load(training_range)
    )
    driven = follow(
        twin.robot,
        near.position,
        near.rotation,
        near=0.5 * (training_range.lower + training_range.upper),
    )
    np.testing.assert_allclose(driven.q[:, still] - training_range.lower[still], 0.0, atol=1e-6)


@pytest.mark.slow
@pytest.mark.usefixtures("few_centres")
def test_a_load_beyond_training_is_counted_and_a_path_that_is_too_large_is_refused(twin):
    training_range = TrainingRange.of(twin.samples, twin.robot)
    load = 10.0 * training_load(training_range)
    _, words = path_near_training(twin.robot, training_range, "line", SIZE, 10, wrench=load)
    assert words == ["load"] * 10
    with pytest.raises(DataError, match="5000 mm about its training poses"):
        path_near_training(twin.robot, training_range, "line", 5.0, 10, wrench=load)
