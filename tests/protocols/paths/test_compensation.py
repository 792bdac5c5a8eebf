"""Corrected commands against robots whose compliance is known."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from stiff_protocols.contract.errors import DataError
from stiff_protocols.paths.compensation import (
    BEYOND_LIMITS,
    NOT_CONVERGED,
    OUT_OF_REACH,
    compensate,
)
from stiff_protocols.paths.inverse import follow
from stiff_protocols.paths.path import shaped

COMPLIANCE = 1 / np.array([50.9e3, 63.4e3, 50.3e3, 2.27e3, 8.89e3, 1.39e3])
LOAD = (0.0, 40.0, -75.0, 1.0, 2.0, 3.0)
READY = np.radians([0.0, -90.0, 90.0, 0.0, 60.0, 0.0])
TOLERANCE = 1e-7


@pytest.fixture(scope="module")
def driven(kr10):
    """A circle, and the joint positions on it."""
    stands = kr10.forward(READY[None])
    path = shaped(
        "circle", stands.points[0, -1], 0.3, 101, rotation=stands.rotation[0], wrench=LOAD
    )
    return path, follow(kr10, path.position, path.rotation, READY).q


def truth(robot):
    """Deflections of elastic joints."""

    def deflection(q, wrench):
        jacobian = robot.jacobian(q)
        torque = np.einsum("nij,ni->nj", jacobian, wrench)
        return np.einsum("nij,nj->ni", jacobian[:, :3], COMPLIANCE * torque)

    return deflection


def test_loaded_tool_lands_on_the_wanted_points_with_its_orientation(kr10, driven):
    path, q = driven
    found = compensate(truth(kr10), kr10, path, q, tolerance_m=TOLERANCE)
    assert found.converged.all()
    command = kr10.forward(found.q)
    np.testing.assert_allclose(command.points[:, -1], found.position, atol=2e-8)
    np.testing.assert_allclose(command.rotation, path.rotation, atol=2e-8)
    under_load = command.points[:, -1] + truth(kr10)(found.q, path.wrench)
    assert np.linalg.norm(under_load - path.position, axis=1).max() < 1.2 * TOLERANCE
    assert np.linalg.norm(found.before, axis=1).min() > 1e-4
    np.testing.assert_allclose(found.before, truth(kr10)(q, path.wrench), atol=1e-12)
    np.testing.assert_allclose(found.deflection, truth(kr10)(found.q, path.wrench), atol=1e-12)
    assert (found.contraction < 0.1).all()
    assert found.iterations.max() <= 4


def test_zero_load_changes_nothing(kr10, driven):
    path, q = driven
    found = compensate(truth(kr10), kr10, replace(path, wrench=0.0 * path.wrench), q)
    np.testing.assert_array_equal(found.position, path.position)
    np.testing.assert_array_equal(found.q, q)
    assert (found.iterations == 1).all()
    assert np.isnan(found.contraction).all()


def test_rows_whose_steps_grow_are_left_uncorrected_alone(kr10, driven):
    path, q = driven
    wild = np.arange(len(path)) % 10 == 3
    marked = replace(path, wrench=np.where(wild[:, None], 2.0 * path.wrench, path.wrench))
    centre = path.position.mean(axis=0)

    def predict(q, wrench):
        away = kr10.tcp_position(q) - centre
        runs = (np.linalg.norm(wrench, axis=1) > 100.0)[:, None]
        return np.where(runs, 0.003 + 1.5 * away, truth(kr10)(q, wrench))

    found = compensate(predict, kr10, marked, q)
    np.testing.assert_array_equal(found.converged, ~wild)
    assert set(found.problem[wild]) <= {NOT_CONVERGED, OUT_OF_REACH}
    np.testing.assert_array_equal(found.position[wild], path.position[wild])
    np.testing.assert_array_equal(found.q[wild], q[wild])
    np.testing.assert_array_equal(found.deflection[wild], found.before[wild])


def test_prediction_that_alternates_stops_as_not_converged(kr10, driven):
    path, q = driven
    calls = []

    def predict(q, wrench):
        calls.append(len(q))
        return np.full((len(q), 3), 1e-3 * (len(calls) % 2))

    found = compensate(predict, kr10, path, q)
    assert set(found.problem) == {NOT_CONVERGED}
    assert len(calls) == 2
    assert (found.contraction >= 1.0).all()


def test_commands_beyond_limits_or_reach_are_left_uncorrected_with_the_reason(kr10, driven):
    path, q = driven
    free = compensate(truth(kr10), kr10, path, q)
    joint = int(np.argmax(free.q.max(axis=0) - q.max(axis=0)))
    upper = kr10.upper.copy()
    upper[joint] = q[:, joint].max()
    tight = compensate(truth(kr10), replace(kr10, upper=upper), path, q)
    np.testing.assert_array_equal(tight.problem == BEYOND_LIMITS, free.q[:, joint] > upper[joint])
    assert (tight.problem == BEYOND_LIMITS).any()
    far = compensate(lambda q, wrench: np.full((len(q), 3), -3.0), kr10, path, q)
    assert set(far.problem) == {OUT_OF_REACH}


@pytest.mark.parametrize(("row", "named"), [((0.0, 0.0), "prediction"), ([np.nan] * 3, "nan")])
def test_prediction_of_another_shape_or_with_nan_is_refused(row, named, kr10, driven):
    with pytest.raises(DataError, match=named):
        compensate(lambda q, wrench: np.tile(row, (len(q), 1)), kr10, *driven)
