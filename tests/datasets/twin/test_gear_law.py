"""The law of a gear: it makes no energy, sticks after a reversal and follows measured loops."""

from itertools import pairwise

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from measured_gears import LOOPS, loop_residuals

from stiff_datasets.twin.gear_law import THRESHOLDS, GearLaw
from stiff_protocols.contract.errors import DataError

RATED = 67.0  # N m, a strain-wave gear of size 25
COMPLIANCE = 1.0 / np.array([3.1e4, 5.0e4, 5.7e4])
BREAKPOINTS = np.array([14.0, 48.0])
ARCMIN = np.deg2rad(1.0 / 60.0)
LOST_MOTION = 0.3 * ARCMIN
TORQUES = st.lists(st.floats(-RATED, RATED), min_size=2, max_size=12)
STEPS = 150


def law(width_arcmin: float) -> GearLaw:
    return GearLaw.of_width(width_arcmin * ARCMIN, RATED, COMPLIANCE, BREAKPOINTS, LOST_MOTION)


def straight(corners: list[float]) -> np.ndarray:
    """Return torques along straight lines through the corners and back to the first."""
    points = [*corners, corners[0]]
    lines = [np.linspace(a, b, STEPS) for a, b in pairwise(points)]
    return np.concatenate(lines)


def work(torque: np.ndarray, theta: np.ndarray) -> float:
    """Return the integral of tau d(theta) [J] by the trapezoidal rule."""
    return float(np.sum((torque[1:] + torque[:-1]) / 2.0 * np.diff(theta)))


@pytest.mark.slow
@settings(max_examples=40, deadline=None)
@given(TORQUES, st.floats(0.0, 0.9))
def test_no_closed_cycle_of_torque_makes_energy(corners: list[float], width: float) -> None:
    torque = straight(corners)
    gear = law(width)
    n = len(torque)
    theta = gear.loop(np.concatenate([torque, torque]))[n - 1 :]  # the second, closed cycle
    closed = np.concatenate([torque[-1:], torque])
    error = 1e-4 * RATED * np.abs(theta).max()  # of the trapezoidal rule, at the breakpoints
    assert work(closed, theta) >= -error


@pytest.mark.slow
@settings(max_examples=40, deadline=None)
@given(TORQUES)
def test_without_plays_a_closed_cycle_needs_no_work(corners: list[float]) -> None:
    torque = straight(corners)
    theta = GearLaw(COMPLIANCE, BREAKPOINTS, LOST_MOTION, 0.03 * RATED).loop(torque)
    assert abs(work(torque, theta)) <= 1e-3 * RATED * np.abs(theta).max()


@pytest.mark.slow
@settings(max_examples=40, deadline=None)
@given(TORQUES, st.floats(0.0, 0.9))
def test_the_angle_rises_and_falls_with_the_torque(corners: list[float], width: float) -> None:
    torque = straight(corners)
    theta = law(width).loop(torque)
    assert (np.diff(torque) * np.diff(theta) >= -1e-18).all()  # rounding


def test_the_work_of_a_cycle_is_that_of_the_plays() -> None:
    gear = law(0.6)
    cycle = straight([RATED, -RATED])
    theta = gear.loop(np.concatenate([cycle, cycle]))[len(cycle) - 1 :]
    slip = gear.weights * gear.thresholds * 4.0 * (RATED - gear.thresholds)
    closed = np.concatenate([cycle[-1:], cycle])
    assert work(closed, theta) == pytest.approx(slip.sum(), rel=1e-3)


def test_a_gear_is_stiffest_just_after_a_reversal_and_its_slopes_are_the_catalogues_after_it() -> (
    None
):
    gear = law(0.6)
    down = np.linspace(RATED, -RATED, 4_001)
    theta = gear.loop(np.concatenate([np.linspace(0.0, RATED, 400), down]))[400:]
    compliance = np.diff(theta) / np.diff(down)
    without = np.diff(GearLaw(COMPLIANCE, BREAKPOINTS, LOST_MOTION, 2.01).loop(down))
    assert compliance[0] == pytest.approx(COMPLIANCE[2] - gear.weights.sum(), rel=1e-6)
    slipped = RATED - down[1:] > 2.0 * gear.thresholds.max() + 0.1
    assert compliance[slipped] == pytest.approx((without / np.diff(down))[slipped], rel=1e-6)
    assert compliance[0] < compliance[down[1:] > BREAKPOINTS[1]].max()


@pytest.mark.parametrize("width", [0.2, 0.6])
def test_the_width_at_zero_torque_after_the_rated_torque_is_the_given_one(width: float) -> None:
    gear = law(width)
    ends = [gear.loop(np.linspace(sign * RATED, 0.0, 500), None)[-1] for sign in (1.0, -1.0)]
    assert ends[0] - ends[1] == pytest.approx(width * ARCMIN, rel=1e-9)


def test_a_width_that_leaves_no_elastic_part_is_refused() -> None:
    with pytest.raises(DataError, match="softer than the gear"):
        law(3.0)


def test_plays_after_a_motion_are_where_its_direction_left_them() -> None:
    gear = law(0.4)
    for direction in (1.0, -1.0):
        plays = np.zeros(len(THRESHOLDS))
        for torque in np.linspace(-direction * RATED, direction * 5.0, 300):
            plays = gear.slipped(plays, torque)
        at_end = gear.plays_after_motion(np.float64(direction * 5.0), np.float64(direction))
        assert plays == pytest.approx(at_end)


def test_arrays_of_gears_follow_the_law_of_each() -> None:
    rng = np.random.default_rng(0)
    rated, torque = np.array([[7.8], [67.0]]), rng.uniform(-5.0, 5.0, (2, 50))
    compliance = np.stack([1.0 / np.array([4.7e3, 6.1e3, 7.1e3]), COMPLIANCE], axis=1)[..., None]
    breakpoints = np.array([[2.0, 14.0], [6.9, 48.0]])[..., None]
    every = GearLaw.of_width(0.3 * ARCMIN, rated, compliance, breakpoints)
    plays = every.slipped(np.zeros((len(THRESHOLDS), 2, 50)), torque)
    theta = every.angle(torque, plays)
    for number in range(2):
        gear = GearLaw.of_width(
            0.3 * ARCMIN, rated[number, 0], compliance[:, number, 0], breakpoints[:, number, 0]
        )
        alone = [gear.loop(torque[number, [n]])[0] for n in range(50)]
        assert theta[number] == pytest.approx(alone)


@pytest.mark.slow
def test_the_law_follows_every_measured_loop() -> None:
    residuals = loop_residuals(LOOPS)
    stiff, play = (residuals[residuals["test"] == test] for test in ("stiff", "play"))
    assert len(stiff) == len(play) == 14
    assert stiff["plays"].max() <= 0.06
    assert play["plays"].max() <= 0.20
    assert (residuals["plays"] < 0.5 * residuals["old law"]).all()
