"""Check which rows lie beyond a model's training samples, and how intervals widen there."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from helpers.made_robots import planar_arm
from helpers.made_samples import samples_with
from helpers.quick_models import twin_data
from stiff_protocols.contract.errors import DataError
from stiff_protocols.contract.training_range import (
    LOAD_RATE,
    MOST_NEIGHBOURS,
    POSE_RATE,
    TrainingRange,
)
from stiff_protocols.contract.types import Interval, Samples

Z = (0.0, 0.0, 1.0)


@pytest.fixture(scope="module")
def samples():
    return twin_data().samples


def test_training_samples_and_what_is_a_little_beyond_them_are_inside(samples):
    training_range = TrainingRange.of(samples, twin_data().robot)
    assert not any(training_range.extrapolates(samples.q, 1.05 * samples.wrench))
    tenth = 0.09 * (training_range.upper - training_range.lower)
    ends = np.array([training_range.lower - tenth, training_range.upper + tenth])
    assert not training_range.are_beyond(training_range.quantities(ends, samples.wrench[:2])).any()
    force_only_range = replace(training_range, force=100.0, torque=0.0)
    wrench = np.array([[0.0, 0.0, -80.0, rounding, 0.0, 0.0] for rounding in (1e-9, 1.0)])
    assert force_only_range.extrapolates(samples.q[:2], wrench) == ["", "load"]


def test_each_joint_and_load_far_beyond_is_marked(samples):
    training_range = TrainingRange.of(samples, twin_data().robot)
    q, wrench = np.tile(samples.q[:1], (6, 1)), np.tile(samples.wrench[:1], (6, 1))
    for end, turn in ((training_range.lower, -1.0), (training_range.upper, 1.0)):
        far_q = np.where(np.eye(6, dtype=bool), end + turn * np.deg2rad(60.0), q)
        beyond = training_range.are_beyond(training_range.quantities(far_q, wrench))
        np.testing.assert_array_equal(beyond[:, :6], np.eye(6, dtype=bool))
        assert training_range.extrapolates(far_q, wrench) == ["joints"] * 6
        assert training_range.extrapolates(far_q, 5.0 * wrench) == ["joints load"] * 6
    heavy = wrench[:3].copy()
    heavy[0, :3] *= 5.0
    heavy[1, 3:] *= 30.0
    assert training_range.extrapolates(q[:3], heavy) == ["load", "load", ""]


def test_a_pose_between_the_training_poses_and_a_load_between_their_directions_are_marked():
    """Use two clusters of poses, 90 degrees apart in joint 1, and loads along x and z."""
    near = np.deg2rad([0.0, 3.0, 6.0, 90.0, 93.0, 96.0])
    q = np.column_stack([near, np.zeros(6)])
    wrench = np.zeros((6, 6))
    wrench[[0, 1, 3], 0] = wrench[[2, 4, 5], 2] = 50.0
    training_range = TrainingRange.of(samples_with(q, wrench, np.zeros((6, 3))), planar_arm(2, Z))
    np.testing.assert_allclose(training_range.usual_distances, [np.deg2rad(3.0), 0.0], atol=1e-9)
    positions = np.deg2rad([[4.0, 0.0], [45.0, 0.0], [110.0, 0.0], [4.0, 0.0]])
    loads = np.zeros((4, 6))
    loads[:, 0] = 10.0, 30.0, 30.0, 50.0
    loads[1:, 2] = 0.0, 0.0, 50.0
    loads[3] *= 0.5
    assert training_range.extrapolates(positions, loads) == ["", "pose-gap", "joints", "load-gap"]
    np.testing.assert_allclose(
        training_range.pose_distance(positions), np.deg2rad([1.0, 39.0, 14.0, 1.0])
    )
    chord = 2.0 * np.sin(np.deg2rad(45.0) / 2.0)
    share = np.sqrt(0.5)  # 25 N along both axes, of 50 N
    np.testing.assert_allclose(
        training_range.load_distance(loads), [0, 0, 0, chord * share], atol=1e-12
    )
    stretch = training_range.stretch(positions, loads)
    beyond = np.deg2rad([0.0, 36.0, 14.0, 0.0])  # 14 beyond the range, 11 more than is usual
    expected = (1 + POSE_RATE * beyond) * (1 + LOAD_RATE * np.array([0, 0, 0, chord * share]))
    np.testing.assert_allclose(stretch, expected)


def test_the_distances_do_not_depend_on_the_number_of_loads_at_a_pose(samples):
    single_range, doubled_range = (
        TrainingRange.of(samples, twin_data().robot),
        TrainingRange.of(Samples.together(samples, samples), twin_data().robot),
    )
    np.testing.assert_allclose(doubled_range.usual_distances[0], single_range.usual_distances[0])
    repeated_samples = samples.take(np.tile(np.arange(len(samples)), 20))
    repeated_samples = replace(
        repeated_samples, pose_id=np.arange(len(repeated_samples)).astype(str)
    )
    assert len(TrainingRange.of(repeated_samples, twin_data().robot).poses) == MOST_NEIGHBOURS


def endless_range(angles_deg):
    """Return the range of poses of joint 1, deg, which has no limits; joint 2 stands at 179 deg."""
    q = np.deg2rad([[angle, 179.0] for angle in angles_deg])
    robot = replace(planar_arm(2, Z), lower=[-np.inf, -np.pi], upper=[np.inf, np.pi])
    wrench = np.tile([0.0, 0.0, -50.0, 0.0, 0.0, 0.0], (len(q), 1))
    return TrainingRange.of(samples_with(q, wrench, np.zeros((len(q), 3))), robot), wrench[:1]


@pytest.mark.parametrize(
    ("angles_deg", "ends_deg"),
    [
        ([179.0, -179.0, 175.0, -175.0], [175.0, 185.0]),
        ([-541.0, 175.0, 181.0, 185.0], [-185.0, -175.0]),
        ([10.0, 20.0, 350.0], [-10.0, 20.0]),
        ([730.0, 740.0], [730.0, 740.0]),
        ([-170.0], [-170.0, -170.0]),
    ],
)
def test_the_range_of_an_endless_joint_is_the_smallest_arc_with_all_angles(angles_deg, ends_deg):
    training_range, load = endless_range(angles_deg)
    ends = np.array([training_range.lower, training_range.upper])
    np.testing.assert_allclose(np.rad2deg(ends), [[ends_deg[0], 179.0], [ends_deg[1], 179.0]])
    middle = 0.5 * (ends_deg[0] + ends_deg[1])
    for turns in (-2, 0, 1):
        q = np.deg2rad([[middle + 360.0 * turns, 179.0]])
        assert training_range.extrapolates(q, load) == [""]
        np.testing.assert_allclose(training_range.stretch(q, load), 1.0)


def test_a_whole_turn_of_an_endless_joint_changes_no_distance_and_one_of_another_joint_does():
    training_range, load = endless_range([175.0, 178.0, -179.0, -176.0])
    np.testing.assert_allclose(np.rad2deg(training_range.usual_distances[0]), 3.0)
    away = np.array([[-177.0, 179.0], [183.0, 179.0], [-165.0, 179.0], [178.0, -179.0]])
    q, loads = np.deg2rad(away), np.tile(load, (4, 1))
    np.testing.assert_allclose(np.rad2deg(training_range.pose_distance(q)), [1.0, 1.0, 11.0, 358.0])
    stretch = 1.0 + POSE_RATE * np.deg2rad([0.0, 0.0, 11.0, 358.0])
    np.testing.assert_allclose(training_range.stretch(q, loads), stretch)
    assert training_range.extrapolates(q, loads) == ["", "", "joints", "joints"]


def test_no_load_in_training_makes_every_load_unlike_it():
    training_range = TrainingRange.of(
        samples_with(np.zeros((2, 2)), np.zeros((2, 6)), np.zeros((2, 3))), planar_arm(2, Z)
    )
    loads = np.zeros((2, 6))
    loads[1, 2] = 10.0
    assert training_range.extrapolates(np.zeros((2, 2)), loads) == ["", "load"]
    assert training_range.stretch(np.zeros((2, 2)), loads)[0] == 1.0


def unit_range(force):
    """Return a range of two joints, poses 0.5 rad apart, and forces along x."""
    steps = np.linspace(0.0, 1.0, 3)
    poses = np.stack(np.meshgrid(steps, steps), axis=-1).reshape(-1, 2)
    return TrainingRange(np.zeros(2), np.ones(2), force, 0.0, poses, np.eye(6)[:1])


def steady(q, wrench):
    """Return +-1 mm about a deflection that grows by 1 mm/N up to 10 N."""
    middle = 1e-3 * np.minimum(wrench[:, :3], 10.0)
    return Interval(middle - 1e-3, middle + 1e-3, 0.9)


@pytest.mark.parametrize(
    ("joint", "force", "half"),
    [
        (0.5, 10.0, 1e-3),  # inside
        (1.5, 10.0, 2e-3),  # half a radian beyond
        (-1.0, 10.0, 3e-3),
        (0.5, 30.0, 3e-3 + 20e-3),  # three times 1 mm, and to where three times 10 N would lead
        (1.5, 30.0, 2.0 * (3e-3 + 20e-3)),
    ],
)
def test_an_interval_grows_with_the_load_and_the_way_beyond_the_range(joint, force, half):
    training_range = unit_range(force=10.0)
    q, wrench = np.array([[joint, 0.5]] * 2), np.zeros((2, 6))
    wrench[:, 0] = force
    q[1], wrench[1, 0] = 0.5, 10.0  # a row inside stays as it is
    interval = training_range.widened(steady, q, wrench)
    middle = steady(q, wrench).lower[:, 0] + 1e-3
    np.testing.assert_allclose(interval.upper[:, 0] - middle, [half, 1e-3])
    np.testing.assert_allclose(middle - interval.lower[:, 0], [half, 1e-3])


def test_of_an_unusual_torque_the_mark_is_of_the_torque_and_the_width_of_force_and_torque():
    training_range = replace(unit_range(force=140.0), directions=np.eye(6))  # the FANUC's force
    inside = np.full((2, 2), 0.5)
    wrench = np.array([[60.0, 0, 0, 0, 0, 40.0], [120.0, 0, 0, 0, 0, 40.0]])
    assert training_range.extrapolates(inside, wrench) == ["load", "load"]
    torque_stretch = training_range.stretch(inside, wrench)
    interval = training_range.widened(steady, inside, wrench)
    usual_interval = steady(inside, wrench)
    # 60 N + 40 N m / 1 m is below 140 N; 120 N + 40 N m is 8 / 7 of it
    load_stretch = (
        (interval.upper - interval.lower)[:, 0]
        / (usual_interval.upper - usual_interval.lower)[:, 0]
        / torque_stretch
    )
    np.testing.assert_allclose(load_stretch, [1.0, (8 / 7 * 1.0 + 8 / 7 * 10.0 - 10.0)], rtol=1e-12)


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"lower": [0.0, np.nan]}, "nan"),
        ({"lower": [0.0, 0.0, 0.0]}, "ends"),
        ({"lower": [0.0, 9.0]}, "ends"),
        ({"force": np.inf}, "inf"),
        ({"torque": -1.0}, "-1"),
        ({"poses": np.zeros((3, 3))}, "poses"),
        ({"poses": np.zeros((0, 2))}, "no poses"),
        ({"directions": np.zeros((3, 2))}, "directions"),
        ({"endless": (2,)}, "endless"),
    ],
)
def test_an_invalid_range_is_refused(changes, message):
    valid_fields = vars(unit_range(force=1.0))
    with pytest.raises(DataError, match=message):
        TrainingRange(**valid_fields | changes)
    with pytest.raises(DataError, match="2 joints"):
        TrainingRange(**valid_fields).extrapolates(np.zeros((1, 6)), np.zeros((1, 6)))
