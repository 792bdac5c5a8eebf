"""The digital twin against Pinocchio, closed forms and the axioms of a spring."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from helpers.made_robots import track_lines, tree_urdf
from helpers.pinocchio_twin import pinocchio_torque
from stiff_datasets.planning.poses import paper_poses
from stiff_datasets.robots.urdf_reader import read_chain, read_robot
from stiff_datasets.twin.constants import shipped_constants, specimen_springs
from stiff_datasets.twin.spring_law import Gear, JointSprings, SlideSprings, SpringLaw
from stiff_datasets.twin.twin import DigitalTwin, TwinExperiment
from stiff_protocols.contract.errors import DataError

STIFF = 1e15
POSE = np.deg2rad([20.0, -70.0, 80.0, 10.0, 40.0, 15.0])
LOAD = np.array([60.0, 20.0, -60.0, 3.0, -4.0, 2.0])
SPRINGS = shipped_constants("kr10_r1100_2").springs


def geared(slopes, breakpoints, lost_motion=0.0):
    gear = Gear(slopes_Nm_per_rad=slopes, breakpoints_Nm=breakpoints, rated_Nm=100.0)
    return JointSprings(gear, STIFF, (STIFF, STIFF), lost_motion)


def linear(stiffness):
    return geared((stiffness,) * 3, (1.0, 2.0))


@pytest.fixture()
def arm(tmp_path):
    """One joint about y at the origin, 1 m long, 2 kg in its middle."""
    path = tmp_path / "arm.urdf"
    path.write_text(
        '<robot name="arm"><link name="base"/><joint name="j" type="revolute">'
        '<parent link="base"/><child link="l"/><axis xyz="0 1 0"/>'
        '<limit lower="-3" upper="3" effort="1" velocity="1"/></joint><link name="l"><inertial>'
        '<origin xyz="0.5 0 0"/><mass value="2"/>'
        '<inertia ixx="1" iyy="1" izz="1" ixy="0" ixz="0" iyz="0"/></inertial></link></robot>'
    )
    return read_robot(path, tcp=(1.0, 0.0, 0.0))


@pytest.fixture()
def twin(kr10):
    return DigitalTwin(kr10, SPRINGS)


def one(values):
    return np.asarray(values, dtype=np.float64)[None]


def test_torques_and_tcp_are_those_of_pinocchios_elastic_model(kr10_chain, twin, rng):
    q = rng.uniform(-1.5, 1.5, size=(20, 6))
    wrench = rng.normal(size=(20, 6)) * np.repeat([60.0, 6.0], 3)
    found = twin.equilibrium(q, wrench)
    for i in range(len(q)):
        torque, tcp, _ = pinocchio_torque(kr10_chain, q[i], found.theta[i], wrench[i])
        np.testing.assert_allclose(found.torque[i], torque, atol=1e-10)
        np.testing.assert_allclose(found.tcp[i], tcp, atol=1e-14)


@pytest.fixture()
def track(tmp_path):
    """A robot of seven joints, the first a track along x."""
    return read_chain(tree_urdf(tmp_path / "track.urdf", track_lines()), tcp=(0.1, 0.0, 0.2))


def test_a_robot_on_a_track_deforms_as_in_pinocchio(track, rng):
    twin = DigitalTwin(track.robot, [SlideSprings(2e6, (3e5, 3e5)), *SPRINGS])
    q = rng.uniform(-1.5, 1.5, size=(20, 7))
    wrench = rng.normal(size=(20, 6)) * np.repeat([60.0, 6.0], 3)
    found = twin.equilibrium(q, wrench)
    for i in range(len(q)):
        torque, tcp, _ = pinocchio_torque(track, q[i], found.theta[i], wrench[i])
        np.testing.assert_allclose(found.torque[i], torque, atol=1e-10)
        np.testing.assert_allclose(found.tcp[i], tcp, atol=1e-14)
    np.testing.assert_allclose(found.theta[:, 0], wrench[:, 0] / 2e6, atol=1e-15)


def test_a_drive_alone_gives_force_over_stiffness_along_the_track(track):
    twin = DigitalTwin(track.robot, [SlideSprings(1e5, (STIFF, STIFF)), *[linear(1e10)] * 6])
    moved = twin.readings(np.full((1, 7), 0.3), one(LOAD))
    np.testing.assert_allclose(moved, one([LOAD[0] / 1e5, 0.0, 0.0]), atol=1e-6)
    with pytest.raises(DataError, match="prismatic"):
        DigitalTwin(track.robot, [linear(1e10)] * 7)


@pytest.mark.parametrize(
    ("loads", "specimen"), [("line", 0), ("line-hook", 0), ("omni", 0), ("line", 7)]
)
def test_every_samples_springs_carry_load_and_weight_to_a_nanonewton_metre(
    kr10, kr10_chain, loads, specimen
):
    constants, q = shipped_constants("kr10_r1100_2"), paper_poses(kr10).q
    experiment = TwinExperiment(constants, loads=loads, specimen=specimen, seed=0)
    wrench = experiment.wrenches(q)
    law = SpringLaw(specimen_springs(constants, specimen))
    for load in (wrench, np.zeros_like(wrench)):
        found = experiment.twin.equilibrium(q, load)
        for i in range(len(q)):
            # torque of Pinocchio at the angles that the springs have under the torque found
            theta = law.angle(found.torque[i][:, None])[:, 0]
            torque, _, _ = pinocchio_torque(kr10_chain, q[i], theta, load[i])
            assert np.abs(torque - found.torque[i]).max() < 1e-9


def test_a_joints_turn_is_that_of_its_spring_in_balance(twin, kr10, rng):
    q, wrench = rng.uniform(-1.0, 1.0, (6, 6)), rng.normal(size=(6, 6)) * 20.0
    balance = twin.equilibrium(q, wrench)
    turn = twin.joint_turn(balance.torque[:, ::3])
    np.testing.assert_allclose(turn, balance.theta[:, ::3], atol=1e-12)
    hysteresis = DigitalTwin(kr10, SPRINGS, hysteresis=True)
    torque = 1e3 * np.ones((1, 6))  # a load takes up the whole width, not half of it
    widths = [joint.lost_motion for joint in SPRINGS]
    more = hysteresis.joint_turn(torque) - twin.joint_turn(torque)
    np.testing.assert_allclose(more[0], np.array(widths) / 2.0, rtol=1e-6)


def test_a_linear_joint_bends_by_the_pendulum_equation(arm):
    twin = DigitalTwin(arm, [linear(1000.0)])
    theta = twin.equilibrium(np.zeros((1, 1)), one([0, 0, -50.0, 0, 0, 0])).theta[0, 0]
    # the load and the weight turn the arm down by theta: k theta = (F + m g / 2) cos theta
    assert 1000.0 * theta == pytest.approx((50.0 + 9.81) * np.cos(theta), abs=1e-9)


@pytest.mark.parametrize(
    ("springs", "torque", "angle"),
    [
        *(
            (geared((1e4, 2e4, 4e4), (2.0, 5.0)), torque, angle)  # the catalogue's curve
            for torque, angle in ((1.0, 1e-4), (3.0, 2e-4 + 0.5e-4), (9.0, 2e-4 + 1.5e-4 + 1e-4))
        ),
        *(  # rigid, and 4 N m are 4 % of the rated torque: half the lost motion's width
            (geared((1e9,) * 3, (1.0, 2.0), 2e-4), torque, angle)
            for torque, angle in ((40.0, 1e-4), (-40.0, -1e-4))
        ),
    ],
)
def test_an_upright_joint_follows_its_gears_slopes_and_lost_motion(arm, springs, torque, angle):
    upright = one([-np.pi / 2])  # no gravity torque, a force along x has the full lever
    found = DigitalTwin(arm, [springs]).equilibrium(upright, one([torque, 0, 0, 0, 0, 0]))
    assert found.theta[0, 0] == pytest.approx(angle, rel=2e-3)  # a little gravity as it leans


def test_without_tilts_slopes_and_lost_motion_it_is_the_linear_vjm_to_first_order(kr10):
    stiffness = np.array([5.1e4, 6.3e4, 5.0e4, 2.3e3, 8.9e3, 1.4e3])
    weightless = replace(kr10, gravity=np.zeros(3))  # it bends the robot with the load at nil
    twin = DigitalTwin(weightless, [linear(k) for k in stiffness])
    rows = kr10.jacobian(POSE[None])[0]
    loads = LOAD * np.array([1.0, 0.5, 0.25, 0.125])[:, None]
    expected = ((loads @ rows) / stiffness) @ rows[:3].T
    error = np.linalg.norm(twin.readings(np.stack([POSE] * 4), loads) - expected, axis=1)
    # the error is of second order: half the load, a quarter of the error
    np.testing.assert_allclose(error[:-1] / error[1:], 4.0, rtol=0.02)
    assert error[-1] < 1e-2 * np.linalg.norm(expected[-1])


def test_samples_do_not_depend_on_those_beside_them_and_no_load_moves_nothing(twin, rng):
    q = rng.uniform(-1.5, 1.5, size=(5000, 6))
    wrench = rng.normal(size=(5000, 6)) * 30
    together = twin.readings(q, wrench)
    alone = np.concatenate([twin.readings(q[i : i + 1], wrench[i : i + 1]) for i in (0, 2500)])
    np.testing.assert_allclose(together[[0, 2500]], alone, rtol=0, atol=1e-13)
    assert not twin.readings(q[:50], np.zeros((50, 6))).any()


def test_a_load_that_no_spring_can_carry_and_a_joint_without_spring_are_refused(kr10):
    soft = DigitalTwin(kr10, [linear(20.0)] * 6)
    with pytest.raises(DataError, match=r"no elastic equilibrium at q = .* the load is too large"):
        soft.readings(one(POSE), one(LOAD))
    with pytest.raises(DataError, match="5 joint springs for 6 joints"):
        DigitalTwin(kr10, SPRINGS[:5])
