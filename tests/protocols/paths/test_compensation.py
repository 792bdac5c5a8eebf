"""Check corrected commands against robots with known compliance."""

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
def path_and_positions(kr10):
    """Return a circle and the joint positions along it."""
    frames = kr10.forward(READY[None])
    path = shaped(
        "circle", frames.points[0, -1], 0.3, 101, rotation=frames.rotation[0], wrench=LOAD
    )
    return path, follow(kr10, path.position, path.rotation, READY).q


def truth(robot):
    """Return the deflection function of elastic joints."""

    def deflection(q, wrench):
        jacobian = robot.jacobian(q)
        torque = np.einsum("nij,ni->nj", jacobian, wrench)
        return np.einsum("nij,nj->ni", jacobian[:, :3], COMPLIANCE * torque)

    return deflection


def test_loaded_tool_lands_on_the_wanted_points_with_its_orientation(kr10, path_and_positions):
    path, q = path_and_positions
    result = compensate(truth(kr10), kr10, path, q, tolerance_m=TOLERANCE)
    assert result.converged.all()
    command = kr10.forward(result.q)
    np.testing.assert_allclose(command.points[:, -1], result.position, atol=2e-8)
    np.testing.assert_allclose(command.rotation, path.rotation, atol=2e-8)
    under_load = command.points[:, -1] + truth(kr10)(result.q, path.wrench)
    assert np.linalg.norm(under_load - path.position, axis=1).max() < 1.2 * TOLERANCE
    assert np.linalg.norm(result.before, axis=1).min() > 1e-4
    np.testing.assert_allclose(result.before, truth(kr10)(q, path.wrench), atol=1e-12)
    np.testing.assert_allclose(result.deflection, truth(kr10)(result.q, path.wrench), atol=1e-12)
    assert (result.contraction < 0.1).all()
    assert result.iterations.max() <= 4


def test_zero_load_changes_nothing(kr10, path_and_positions):
    path, q = path_and_positions
    result = compensate(truth(kr10), kr10, replace(path, wrench=0.0 * path.wrench), q)
    np.testing.assert_array_equal(result.position, path.position)
    np.testing.assert_array_equal(result.q, q)
    assert (result.iterations == 1).all()
    assert np.isnan(result.contraction).all()


def test_only_rows_whose_steps_grow_are_left_uncorrected(kr10, path_and_positions):
    path, q = path_and_positions
    is_heavy = np.arange(len(path)) % 10 == 3
    heavy_path = replace(path, wrench=np.where(is_heavy[:, None], 2.0 * path.wrench, path.wrench))
    centre = path.position.mean(axis=0)

    def predict(q, wrench):
        away = kr10.tcp_position(q) - centre
        runs = (np.linalg.norm(wrench, axis=1) > 100.0)[:, None]
        return np.where(runs, 0.003 + 1.5 * away, truth(kr10)(q, wrench))

    result = compensate(predict, kr10, heavy_path, q)
    np.testing.assert_array_equal(result.converged, ~is_heavy)
    assert set(result.problem[is_heavy]) <= {NOT_CONVERGED, OUT_OF_REACH}
    np.testing.assert_array_equal(result.position[is_heavy], path.position[is_heavy])
    np.testing.assert_array_equal(result.q[is_heavy], q[is_heavy])
    np.testing.assert_array_equal(result.deflection[is_heavy], result.before[is_heavy])


def test_prediction_that_alternates_stops_as_not_converged(kr10, path_and_positions):
    path, q = path_and_positions
    calls = []

    def predict(q, wrench):
        calls.append(len(q))
        return np.full((len(q), 3), 1e-3 * (len(calls) % 2))

    result = compensate(predict, kr10, path, q)
    assert set(result.problem) == {NOT_CONVERGED}
    assert len(calls) == 2
    assert (result.contraction >= 1.0).all()


def test_commands_beyond_limits_or_reach_are_left_uncorrected_with_the_reason(
    kr10, path_and_positions
):
    path, q = path_and_positions
    unlimited_result = compensate(truth(kr10), kr10, path, q)
    joint = int(np.argmax(unlimited_result.q.max(axis=0) - q.max(axis=0)))
    upper = kr10.upper.copy()
    upper[joint] = q[:, joint].max()
    limited_result = compensate(truth(kr10), replace(kr10, upper=upper), path, q)
    np.testing.assert_array_equal(
        limited_result.problem == BEYOND_LIMITS, unlimited_result.q[:, joint] > upper[joint]
    )
    assert (limited_result.problem == BEYOND_LIMITS).any()
    unreachable_result = compensate(lambda q, wrench: np.full((len(q), 3), -3.0), kr10, path, q)
    assert set(unreachable_result.problem) == {OUT_OF_REACH}


@pytest.mark.parametrize(("row", "message"), [((0.0, 0.0), "prediction"), ([np.nan] * 3, "nan")])
def test_prediction_of_another_shape_or_with_nan_is_refused(row, message, kr10, path_and_positions):
    with pytest.raises(DataError, match=message):
        compensate(lambda q, wrench: np.tile(row, (len(q), 1)), kr10, *path_and_positions)
