"""The digital twin against closed forms, finite differences and the balance of torques."""

from __future__ import annotations

import numpy as np
import pytest

from stiff_datasets.kr10_twin import SPRINGS
from stiff_datasets.robots.robot import read_chain
from stiff_datasets.twin import DigitalTwin, GearSize, JointSprings
from stiff_protocols.errors import DataError

STIFF = 1e15


def linear(stiffness):
    gear = GearSize((stiffness,) * 3, (1.0, 2.0), 100.0)
    return JointSprings(gear, STIFF, (STIFF, STIFF), 0.0)


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
    return read_chain(path, tcp=(1.0, 0.0, 0.0))


@pytest.fixture()
def kr10_twin(kr10_chain):
    return DigitalTwin(kr10_chain, SPRINGS)


POSE = np.deg2rad([20.0, -70.0, 80.0, 10.0, 40.0, 15.0])
LOAD = np.array([60.0, 20.0, -60.0, 3.0, -4.0, 2.0])


def test_a_linear_joint_bends_by_the_pendulum_equation(arm):
    twin = DigitalTwin(arm, [linear(1000.0)])
    theta = twin.equilibrium(np.zeros(1), np.array([0, 0, -50.0, 0, 0, 0]))[0]
    # the load and the weight turn the arm down by theta: k theta = (F + m g / 2) cos theta
    assert 1000.0 * theta == pytest.approx((50.0 + 9.81) * np.cos(theta), rel=1e-12)


def test_gravity_puts_a_stiffening_joint_on_its_later_slope(arm):
    gear = GearSize((1e3, 2e3, 4e3), (2.0, 5.0), 100.0)  # preload 9.81 N m: third slope
    springs = [JointSprings(gear, STIFF, (STIFF, STIFF), 0.0)]
    down = DigitalTwin(arm, springs).reading(np.zeros(1), np.array([0, 0, -0.01, 0, 0, 0]))
    assert -down[2] == pytest.approx(0.01 / 4e3, rel=0.02)


def test_three_slopes_follow_the_catalogue_curve(arm):
    gear = GearSize((1e4, 2e4, 4e4), (2.0, 5.0), 100.0)
    twin = DigitalTwin(arm, [JointSprings(gear, STIFF, (STIFF, STIFF), 0.0)])
    upright = np.array([-np.pi / 2])  # no gravity torque, a force along x has the full lever
    for torque, angle in ((1.0, 1e-4), (3.0, 2e-4 + 0.5e-4), (9.0, 2e-4 + 1.5e-4 + 1e-4)):
        theta = twin.equilibrium(upright, np.array([torque, 0, 0, 0, 0, 0]))[0]
        assert theta == pytest.approx(angle, rel=2e-3)  # a little gravity as it leans


def test_lost_motion_saturates_at_half_its_width_either_way(arm):
    gear = GearSize((1e9,) * 3, (1.0, 2.0), 100.0)  # rigid: 4 N m are 4 % of the rated torque
    twin = DigitalTwin(arm, [JointSprings(gear, STIFF, (STIFF, STIFF), 2e-4)])
    upright = np.array([-np.pi / 2])
    forward, back = (
        twin.equilibrium(upright, np.array([force, 0, 0, 0, 0, 0]))[0] for force in (40.0, -40.0)
    )
    assert forward == pytest.approx(1e-4, rel=1e-3)
    assert back == pytest.approx(-1e-4, rel=1e-3)


def test_the_derivative_of_the_torques_is_their_central_difference(kr10_twin, rng):
    theta, step = rng.normal(scale=1e-2, size=18), 1e-6
    difference = np.stack(
        [
            kr10_twin.torque(POSE, theta + step * e, LOAD)
            - kr10_twin.torque(POSE, theta - step * e, LOAD)
            for e in np.eye(18)
        ],
        axis=1,
    ) / (2 * step)
    derivative = kr10_twin.torque_derivative(POSE, theta, LOAD)
    np.testing.assert_allclose(derivative, difference, atol=1e-6)


def test_no_load_moves_nothing(kr10_twin):
    np.testing.assert_array_equal(kr10_twin.reading(POSE, np.zeros(6)), np.zeros(3))


def test_stiff_linear_springs_give_the_virtual_joint_formula(kr10, kr10_chain):
    from stiff_models.kinematics import jacobian

    stiffness = np.array([5e9, 6e9, 5e9, 2e8, 9e8, 1e8])  # so stiff that nothing else matters
    twin = DigitalTwin(kr10_chain, [linear(k) for k in stiffness])
    rows = jacobian(kr10, POSE[None])[0]
    expected = rows[:3] @ ((rows.T @ LOAD) / stiffness)
    np.testing.assert_allclose(twin.reading(POSE, LOAD), expected, rtol=1e-3, atol=1e-12)


def test_each_joint_needs_a_spring(kr10_chain):
    with pytest.raises(DataError, match="5 joint springs for 6 joints"):
        DigitalTwin(kr10_chain, SPRINGS[:5])


def test_the_twin_imports_nothing_of_the_models():
    import ast
    import inspect

    from stiff_datasets import kr10_twin, twin

    for module in (twin, kr10_twin):
        names = {
            node.module if isinstance(node, ast.ImportFrom) else alias.name
            for node in ast.walk(ast.parse(inspect.getsource(module)))
            if isinstance(node, ast.Import | ast.ImportFrom)
            for alias in node.names
        }
        assert not [name for name in names if name and name.startswith("stiff_models")]
