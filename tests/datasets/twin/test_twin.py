"""Check the digital twin against Pinocchio, closed forms and the axioms of a spring."""

from __future__ import annotations

import itertools
from dataclasses import replace

import numpy as np
import pytest

from helpers.made_robots import planar_arm, track_lines, tree_urdf
from helpers.pinocchio_twin import pinocchio_torque
from stiff_datasets.planning.poses import Poses, paper_poses
from stiff_datasets.robots.urdf_reader import read_chain
from stiff_datasets.twin.constants import Noise, shipped_constants, specimen_springs
from stiff_datasets.twin.spring_law import Gear, JointSprings, SlideSprings, SpringLaw
from stiff_datasets.twin.twin import (
    DigitalTwin,
    TwinExperiment,
    recorded_deflection,
    recorded_wrench,
)
from stiff_protocols.contract.errors import DataError

STIFF = 1e15
POSE = np.deg2rad([20.0, -70.0, 80.0, 10.0, 40.0, 15.0])
LOAD = np.array([60.0, 20.0, -60.0, 3.0, -4.0, 2.0])
KR10 = shipped_constants("kr10_r1100_2")
SPRINGS = KR10.springs


def geared_springs(slopes, breakpoints, lost_motion=0.0):
    gear = Gear(slopes_Nm_per_rad=slopes, breakpoints_Nm=breakpoints, rated_Nm=100.0)
    return JointSprings(gear, STIFF, (STIFF, STIFF), lost_motion)


def linear_springs(stiffness):
    return geared_springs((stiffness,) * 3, (1.0, 2.0))


@pytest.fixture()
def arm():
    """Return a 1 m arm with one joint about y and 2 kg in its middle."""
    middle = np.array([[0.5, 0.0, 0.0]])
    return replace(planar_arm(1, (0.0, 1.0, 0.0), mass=2.0), centres_of_mass=middle)


@pytest.fixture()
def twin(kr10):
    return DigitalTwin(kr10, SPRINGS)


def row_of(values):
    return np.asarray(values, dtype=np.float64)[None]


def assert_balanced_as_in_pinocchio(chain, balance, q, wrench):
    for i in range(len(q)):
        torque, tcp, _ = pinocchio_torque(chain, q[i], balance.theta[i], wrench[i])
        np.testing.assert_allclose(balance.torque[i], torque, atol=1e-10)
        np.testing.assert_allclose(balance.tcp[i], tcp, atol=1e-14)


def draw_samples(rng, n_joints):
    """Draw twenty poses and loads."""
    wrench = rng.normal(size=(20, 6)) * np.repeat([60.0, 6.0], 3)
    return rng.uniform(-1.5, 1.5, size=(20, n_joints)), wrench


def test_torques_and_tcp_are_those_of_pinocchios_elastic_model(kr10_chain, twin, rng):
    q, wrench = draw_samples(rng, 6)
    assert_balanced_as_in_pinocchio(kr10_chain, twin.equilibrium(q, wrench), q, wrench)


@pytest.fixture()
def track(tmp_path):
    """Return a robot of seven joints, the first a track along x."""
    return read_chain(tree_urdf(tmp_path / "track.urdf", track_lines()), tcp=(0.1, 0.0, 0.2))


def test_a_robot_on_a_track_deforms_as_in_pinocchio(track, rng):
    twin = DigitalTwin(track.robot, [SlideSprings(2e6, (3e5, 3e5)), *SPRINGS])
    q, wrench = draw_samples(rng, 7)
    balance = twin.equilibrium(q, wrench)
    assert_balanced_as_in_pinocchio(track, balance, q, wrench)
    np.testing.assert_allclose(balance.theta[:, 0], wrench[:, 0] / 2e6, atol=1e-15)


def test_a_drive_alone_gives_force_over_stiffness_along_the_track(track):
    twin = DigitalTwin(
        track.robot, [SlideSprings(1e5, (STIFF, STIFF)), *[linear_springs(1e10)] * 6]
    )
    moved = twin.readings(np.full((1, 7), 0.3), row_of(LOAD))
    np.testing.assert_allclose(moved, row_of([LOAD[0] / 1e5, 0.0, 0.0]), atol=1e-6)


@pytest.mark.parametrize(
    ("loads", "specimen"), [("line", 0), ("line-hook", 0), ("omni", 0), ("line", 7)]
)
def test_every_samples_springs_carry_load_and_weight_to_a_nanonewton_metre(
    kr10, kr10_chain, loads, specimen
):
    q = paper_poses(kr10).q[::5]
    experiment = TwinExperiment(KR10, loads=loads, specimen=specimen, seed=0)
    wrench = experiment.wrenches(q)
    law = SpringLaw(specimen_springs(KR10, specimen))
    for load in (wrench, np.zeros_like(wrench)):
        balance = experiment.twin.equilibrium(q, load)
        for i in range(len(q)):
            # torque of Pinocchio at the angles that the springs have under the balance's torque
            theta = law.angle(balance.torque[i][:, None])[:, 0]
            torque, _, _ = pinocchio_torque(kr10_chain, q[i], theta, load[i])
            assert np.abs(torque - balance.torque[i]).max() < 1e-9


def test_a_joints_turn_is_that_of_its_spring_in_balance(twin, kr10, rng):
    q, wrench = rng.uniform(-1.0, 1.0, (6, 6)), rng.normal(size=(6, 6)) * 20.0
    balance = twin.equilibrium(q, wrench)
    turn = twin.joint_turn(balance.torque[:, ::3])
    np.testing.assert_allclose(turn, balance.theta[:, ::3], atol=1e-12)
    hysteresis = DigitalTwin(kr10, SPRINGS, hysteresis=True)
    torque = 1e3 * np.ones((1, 6))  # a load takes up the whole width, not half of it
    widths = [joint.lost_motion for joint in SPRINGS]
    width_difference = hysteresis.joint_turn(torque) - twin.joint_turn(torque)
    np.testing.assert_allclose(width_difference[0], np.array(widths) / 2.0, rtol=1e-6)


def test_a_linear_joint_bends_by_the_pendulum_equation(arm):
    twin = DigitalTwin(arm, [linear_springs(1000.0)])
    theta = twin.equilibrium(np.zeros((1, 1)), row_of([0, 0, -50.0, 0, 0, 0])).theta[0, 0]
    # the load and the weight turn the arm down by theta: k theta = (F + m g / 2) cos theta
    assert 1000.0 * theta == pytest.approx((50.0 + 9.81) * np.cos(theta), abs=1e-9)


@pytest.mark.parametrize(
    ("springs", "torque", "angle"),
    [
        *(
            (geared_springs((1e4, 2e4, 4e4), (2.0, 5.0)), torque, angle)  # the catalogue's curve
            for torque, angle in ((1.0, 1e-4), (3.0, 2e-4 + 0.5e-4), (9.0, 2e-4 + 1.5e-4 + 1e-4))
        ),
        *(  # rigid, and 4 N m are 4 % of the rated torque: half the lost motion's width
            (geared_springs((1e9,) * 3, (1.0, 2.0), 2e-4), torque, angle)
            for torque, angle in ((40.0, 1e-4), (-40.0, -1e-4))
        ),
    ],
)
def test_an_upright_joint_follows_its_gears_slopes_and_lost_motion(arm, springs, torque, angle):
    upright = row_of([-np.pi / 2])  # no gravity torque, a force along x has the full lever
    balance = DigitalTwin(arm, [springs]).equilibrium(upright, row_of([torque, 0, 0, 0, 0, 0]))
    assert balance.theta[0, 0] == pytest.approx(angle, rel=2e-3)  # a little gravity as it leans


def test_without_tilts_slopes_and_lost_motion_it_is_the_linear_vjm_to_first_order(kr10):
    stiffness = np.array([5.1e4, 6.3e4, 5.0e4, 2.3e3, 8.9e3, 1.4e3])
    weightless = replace(kr10, gravity=np.zeros(3))  # it bends the robot with the load at nil
    twin = DigitalTwin(weightless, [linear_springs(k) for k in stiffness])
    rows = kr10.jacobian(POSE[None])[0]
    loads = LOAD * np.array([1.0, 0.5, 0.25, 0.125])[:, None]
    expected = ((loads @ rows) / stiffness) @ rows[:3].T
    error = np.linalg.norm(twin.readings(np.stack([POSE] * 4), loads) - expected, axis=1)
    # the error is of second order: half the load, a quarter of the error
    np.testing.assert_allclose(error[:-1] / error[1:], 4.0, rtol=0.02)
    assert error[-1] < 1e-2 * np.linalg.norm(expected[-1])


def test_samples_do_not_depend_on_their_neighbours_and_no_load_moves_nothing(twin, rng):
    q = rng.uniform(-1.5, 1.5, size=(50, 6))
    wrench = rng.normal(size=(50, 6)) * 30
    readings = twin.readings(q, wrench)
    single_readings = np.concatenate(
        [twin.readings(q[i : i + 1], wrench[i : i + 1]) for i in (0, 25)]
    )
    np.testing.assert_allclose(readings[[0, 25]], single_readings, rtol=0, atol=1e-13)
    assert not twin.readings(q, np.zeros((50, 6))).any()


def test_a_load_that_no_spring_can_carry_is_refused(kr10):
    soft = DigitalTwin(kr10, [linear_springs(20.0)] * 6)
    with pytest.raises(DataError, match=r"no elastic equilibrium at q = .* the load is too large"):
        soft.readings(row_of(POSE), row_of(LOAD))


def test_noise_has_the_data_sheets_size_over_10000_repeats(rng):
    noise = Noise()
    wrench = recorded_wrench(np.zeros((10_000, 6)), noise, rng)
    np.testing.assert_allclose(wrench[:, :3].std(axis=0), 0.04, rtol=0.03)
    np.testing.assert_allclose(wrench[:, 3:].std(axis=0), 0.002, rtol=0.03)
    deflection = recorded_deflection(np.zeros((10_000, 3)), noise, rng)
    # one reading with the load, one without, 0.01 mm each
    np.testing.assert_allclose(deflection.std(axis=0), np.sqrt(2) * 1e-5, rtol=0.03)
    for readings in (wrench, deflection):
        assert np.abs(readings.mean(axis=0) / readings.std(axis=0)).max() < 0.04


def test_data_sets_that_share_a_seed_share_no_random_numbers():
    names, ur5 = np.arange(50).astype(str), shipped_constants("ur5")
    poses = Poses(np.zeros((50, 6)), names, names)
    draws = []
    for constants, specimen, loads in ((KR10, 0, 1), (KR10, 1, 1), (KR10, 0, 5), (ur5, 0, 1)):
        twin = TwinExperiment(
            constants, loads="omni", specimen=specimen, seed=0, loads_per_pose=loads
        )
        force = twin.wrenches(np.zeros((50, 6)))[:, :3]
        zero_deflection = np.zeros((50 * loads, 3))
        noise = twin.recorded(poses, np.zeros((50 * loads, 6)), zero_deflection).deflection[:50]
        draws.append((force / np.linalg.norm(force, axis=1, keepdims=True), noise))
    for pair in itertools.combinations(draws, 2):
        for first, second in zip(*pair, strict=True):
            assert np.abs(np.corrcoef(first.ravel(), second.ravel())[0, 1]) < 0.3
    factors = [
        [
            spring.structure / nominal.structure
            for spring, nominal in zip(
                specimen_springs(robot_type, 3), robot_type.springs, strict=True
            )
        ]
        for robot_type in (KR10, ur5)
    ]
    assert not np.isclose(*factors).any()  # specimens of two robots
