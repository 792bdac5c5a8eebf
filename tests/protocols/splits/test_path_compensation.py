"""Check `path-compensation`: its paths, the deflection under its commands, and errors."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from helpers.made_robots import planar_arm
from helpers.made_samples import samples_with
from stiff_protocols.contract.errors import ConfigError, StiffBenchWarning
from stiff_protocols.contract.types import PATH_GROUP, BenchmarkData
from stiff_protocols.paths.compensation import TOLERANCE_M
from stiff_protocols.splits.path_compensation import LOADS, MARGIN_RAD, PARTS, PathCompensation
from stiff_protocols.splits.random_splits import Holdout

PROTOCOL = PathCompensation()
ROUNDED_M = 1e-8
"""Rounding of the data's deflections."""


@pytest.fixture(scope="module")
def data(twin):
    return PROTOCOL.prepared(twin)


@pytest.fixture(scope="module")
def rows(data):
    return np.flatnonzero(data.samples.group == PATH_GROUP)


def no_prediction(q, wrench):
    return np.zeros((len(q), 3))


def remaining_error(data, rows, q):
    """Return path errors [m] of commands from the loaded robot's position."""
    samples = data.samples.take(rows)
    loaded_position = data.robot.tcp_position(q) + data.under_load(q, samples.wrench)
    return loaded_position - data.robot.tcp_position(samples.q)


def test_whole_paths_stand_behind_the_measured_samples(data, twin, rows):
    n = len(twin.samples)
    measured = data.samples.take(np.arange(n))
    assert BenchmarkData(measured, data.robot).sha256 == twin.sha256
    np.testing.assert_array_equal(rows, np.arange(n, len(data.samples)))
    paths, first, count = np.unique(
        data.samples.pose_id[rows], return_index=True, return_counts=True
    )
    assert len(paths) == 3 * len(PARTS) * len(LOADS) and len(set(count)) == 1
    for path, start, length in zip(paths, first, count, strict=True):
        assert (data.samples.pose_id[rows][start : start + length] == path).all()
    assert not set(paths) & set(twin.samples.pose_id)


def test_paths_keep_from_the_joints_limits_and_the_loads_inside_the_measured_ones(data, twin, rows):
    points, robot = data.samples.take(rows), data.robot
    limit_distance = np.minimum(points.q - robot.lower, robot.upper - points.q)
    assert limit_distance.min() > MARGIN_RAD - 1e-5
    force, measured = (
        np.linalg.norm(samples.wrench[:, :3], axis=1) for samples in (points, twin.samples)
    )
    assert 0.0 < force.max() < measured.max()
    distances = data.samples.q[rows][:, None] - twin.samples.q
    assert np.abs(distances).max(axis=2).min() > 1e-3  # no point is a measured pose


def test_models_learn_from_the_rows_that_holdout_gives_them_and_all_paths_are_tested(
    data, twin, rows
):
    path_splits = PROTOCOL.splits(data.samples, n_splits=3, seed=4)
    holdout_splits = Holdout().splits(twin.samples, n_splits=3, seed=4)
    for path_split, holdout_split in zip(path_splits, holdout_splits, strict=True):
        np.testing.assert_array_equal(path_split.train, holdout_split.train)
        np.testing.assert_array_equal(path_split.validation, holdout_split.validation)
        np.testing.assert_array_equal(path_split.test, rows)


def command_positions(predict, data, rows):
    points = data.samples.take(rows)
    return PROTOCOL.commanded(predict, data.robot, points.q, points.wrench)


def test_no_correction_leaves_the_deflection_and_removes_nothing(data, rows):
    q = command_positions(no_prediction, data, rows)
    np.testing.assert_array_equal(q, data.samples.q[rows])
    np.testing.assert_allclose(
        remaining_error(data, rows, q), data.samples.deflection[rows], atol=ROUNDED_M
    )
    np.testing.assert_allclose(PROTOCOL.scored(q, q, data, rows), 0.0, atol=ROUNDED_M)
    assert (data.bound_deflections["uncorrected"] == 0.0).all()


def test_the_twins_own_truth_leaves_the_tolerance(data, rows):
    error = (data.bound_deflections["oracle"] - data.samples.deflection)[rows]
    assert 0.0 < np.linalg.norm(error, axis=1).max() <= TOLERANCE_M + ROUNDED_M


def test_what_is_removed_is_the_error_without_correction_less_the_one_with_it(data, rows):
    some_rows = rows[::7]
    q = command_positions(lambda q, w: 0.7 * data.under_load(q, w), data, some_rows)
    removed = PROTOCOL.scored(q, q, data, some_rows)
    uncorrected = data.samples.deflection[some_rows]
    np.testing.assert_allclose(
        uncorrected - removed, remaining_error(data, some_rows, q), atol=1e-12
    )
    assert 0.65 < np.linalg.norm(removed) / np.linalg.norm(uncorrected) < 0.75


def test_points_whose_correction_does_not_converge_keep_their_command_with_a_warning(data, rows):
    some_rows = rows[::50]

    def predict_jumps(q, wrench):
        return 0.05 * np.sign(np.sin(1e4 * q[:, :3]))

    with pytest.warns(StiffBenchWarning, match="path points are left uncorrected"):
        q = command_positions(predict_jumps, data, some_rows)
    is_unchanged = (q == data.samples.q[some_rows]).all(axis=1)
    assert is_unchanged.any()


def twin_on_a_track(twin):
    """Return the twin on a 4 m track, measured at the same poses."""
    arm, slide = twin.robot, np.eye(4)[None]
    track = replace(
        arm,
        controller=None,
        joint_names=("rail", *arm.joint_names),
        joint_types=("prismatic", *arm.joint_types),
        placements=np.concatenate([slide, arm.placements]),
        axes=np.concatenate([[[0.0, 1.0, 0.0]], arm.axes]),
        lower=np.append(0.0, arm.lower),
        upper=np.append(4.0, arm.upper),
        masses=np.append(0.0, arm.masses),
        centres_of_mass=np.concatenate([np.zeros((1, 3)), arm.centres_of_mass]),
    )
    q = np.column_stack([np.linspace(0.0, 4.0, len(twin.samples)), twin.samples.q])
    samples = samples_with(q, twin.samples.wrench, twin.samples.deflection)
    under_load = lambda q, wrench: twin.under_load(q[:, 1:], wrench)  # noqa: E731
    return BenchmarkData(samples, track, under_load=under_load)


def test_an_arm_on_a_track_is_corrected_with_its_cart_held_where_the_poses_have_it(twin):
    protocol = PathCompensation(hold="rail")
    data = protocol.prepared(twin_on_a_track(twin))
    rows = np.flatnonzero(data.samples.group == PATH_GROUP)
    carts = data.samples.q[rows, 0].reshape(36, -1)
    assert np.ptp(carts, axis=1).max() == 0.0 and np.ptp(carts) > 2.0
    some_rows = rows[::29]
    points = data.samples.take(some_rows)
    q = protocol.commanded(data.under_load, data.robot, points.q, points.wrench)
    np.testing.assert_array_equal(q[:, 0], data.samples.q[some_rows, 0])
    assert np.linalg.norm(remaining_error(data, some_rows, q), axis=1).max() <= 1.01 * TOLERANCE_M


@pytest.mark.parametrize("hold", ["", "rail,A1", "wagon"])
def test_other_than_six_moving_joints_are_refused(twin, hold):
    with pytest.raises(ConfigError, match=r"rail"):
        PathCompensation(hold=hold).prepared(twin_on_a_track(twin))


def test_a_robot_that_cannot_be_asked_or_turned_is_refused(twin, fanuc):
    with pytest.raises(ConfigError, match="measured robot cannot be moved"):
        PROTOCOL.prepared(fanuc)
    planar = planar_arm(2, (0.0, 0.0, 1.0))
    samples = samples_with(np.zeros((4, planar.n_joints)), np.ones((4, 6)), np.ones((4, 3)))
    with pytest.raises(ConfigError, match=f"has {planar.n_joints} joints .*valid: 6"):
        PROTOCOL.prepared(BenchmarkData(samples, planar, under_load=no_prediction))
    stiff = replace(twin.robot, lower=np.full(6, -1e-3), upper=np.full(6, 1e-3))
    with pytest.raises(ConfigError, match=r"cannot drive a square of .* mm .*near part"):
        PROTOCOL.prepared(replace(twin, robot=stiff))
