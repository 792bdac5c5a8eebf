"""Check the multi-segment VJM: its law in closed form, gravity, and given breakpoints."""

from __future__ import annotations

import numpy as np
import pytest

from helpers.made_robots import planar_arm
from helpers.made_samples import samples_with
from stiff_models.physics.multi_segment_vjm import MultiSegmentVjm
from stiff_models.physics.vjm import VirtualJointModel
from stiff_protocols.contract.errors import ConfigError, StiffBenchWarning
from stiff_protocols.kinematics.serial_chain import joint_torque

SOFT, STIFF = 1e-4, 4e-5  # rad/(N m): a gear below and above its breakpoint
DOWN = (0.0, 1.0, 0.0)  # about y: an arm along x turns downwards


def downward_loads(forces):
    """Return poses and wrenches of a level arm; each force is the torque about y."""
    forces = np.asarray(forces, dtype=float)
    wrench = np.zeros((len(forces), 6))
    wrench[:, 2] = -forces
    return np.zeros((len(forces), 1)), wrench


def phi(torque, slopes, breakpoint):
    size = np.abs(torque)
    return np.sign(torque) * (
        slopes[0] * np.minimum(size, breakpoint) + slopes[1] * np.maximum(size - breakpoint, 0.0)
    )


def test_one_joint_bends_by_the_closed_form_and_its_slopes_are_found():
    torque = np.array([-30.0, -10.0, 2.0, 8.0, 10.0, 15.0, 40.0])
    q, wrench = downward_loads(torque)
    deflection = np.zeros((7, 3))
    deflection[:, 2] = -phi(torque, (SOFT, STIFF), 10.0)  # 1 m from the joint
    model = MultiSegmentVjm(breakpoints="given", given_breakpoints="10", gravity=False)
    model.fit(samples_with(q, wrench, deflection), robot=planar_arm(1, DOWN))
    np.testing.assert_allclose(model.slopes_, [[SOFT, STIFF]], rtol=1e-12)
    assert model.diagnostics_["stiffness j1 segment 1 [Nm/rad]"] == pytest.approx(1 / SOFT)
    assert model.diagnostics_["stiffness j1 segment 2 [Nm/rad]"] == pytest.approx(1 / STIFF)
    assert model.diagnostics_["breakpoint j1 1 [Nm]"] == 10.0
    assert model.diagnostics_["rank"] == 2.0
    new = np.array([-100.0, 0.0, 5.0, 60.0])
    expected = -phi(new, (SOFT, STIFF), 10.0)
    np.testing.assert_allclose(model.predict(*downward_loads(new))[:, 2], expected, atol=1e-15)


def preloaded_samples():
    """Return samples of an arm whose weight (29 N m, level) exceeds the breakpoint."""
    robot, rng = planar_arm(1, DOWN, mass=3.0), np.random.default_rng(3)
    q = rng.uniform(-1.5, 1.5, size=(80, 1))
    wrench = np.zeros((80, 6))
    wrench[:, :3] = rng.normal(size=(80, 3)) * 20.0
    rows, weight = robot.jacobian(q), robot.gravity_torque(q)
    load = joint_torque(rows, wrench)
    turn = phi(weight + load, (SOFT, STIFF), 12.0) - phi(weight, (SOFT, STIFF), 12.0)
    return robot, samples_with(q, wrench, rows[:, :3, 0] * turn)


def test_with_gravity_a_preloaded_gear_is_found_and_without_it_is_not():
    robot, samples = preloaded_samples()
    models = [
        MultiSegmentVjm(breakpoints="given", given_breakpoints="12", gravity=gravity).fit(
            samples, robot=robot
        )
        for gravity in (True, False)
    ]
    np.testing.assert_allclose(models[0].slopes_, [[SOFT, STIFF]], rtol=1e-10)
    assert models[1].slopes_[0, 0] < 0.8 * SOFT  # phi(J^T w) takes the preloaded slope for it
    error = [
        np.abs(m.predict(samples.q, samples.wrench) - samples.deflection).max() for m in models
    ]
    assert error[0] < 1e-15 and error[1] > 1e-4


def test_equal_slopes_give_the_linear_models_springs(kr10, rng):
    q = rng.uniform(-1.5, 1.5, size=(100, 6))
    wrench = rng.normal(size=(100, 6)) * np.repeat([60.0, 5.0], 3)
    compliance = 1 / np.array([50.9e3, 63.4e3, 50.3e3, 2.27e3, 8.89e3, 1.39e3])
    samples = samples_with(q, wrench, kr10.joint_deflection(compliance, q, wrench))
    linear = VirtualJointModel().fit(samples, robot=kr10)
    for segments in (2, 3, 4):
        model = MultiSegmentVjm(segments=segments).fit(samples, robot=kr10)
        np.testing.assert_allclose(
            model.slopes_, np.repeat(compliance[:, None], segments, axis=1), rtol=1e-9
        )
        np.testing.assert_allclose(
            model.predict(q[:5], wrench[:5]), linear.predict(q[:5], wrench[:5]), rtol=1e-9
        )


def test_a_segment_that_no_training_torque_reaches_has_no_stiffness_and_is_like_the_others():
    q, wrench = downward_loads([1.0, 2.0, 3.0])
    deflection = np.outer([1.0, 2.0, 3.0], [0.0, 0.0, -SOFT])
    model = MultiSegmentVjm(breakpoints="given", given_breakpoints="5", gravity=False)
    with pytest.warns(StiffBenchWarning, match=r"not identifiable.*: j1 segment 2 \(.*rank 1 of 2"):
        model.fit(samples_with(q, wrench, deflection), robot=planar_arm(1, DOWN))
    assert model.springs_.names == ("j1 segment 1",)
    assert not any("segment 2" in name for name in model.diagnostics_)
    assert model.diagnostics_["stiffness j1 segment 1 [Nm/rad]"] == pytest.approx(1 / SOFT)
    assert model.predict(*downward_loads([9.0]))[0, 2] == pytest.approx(-9.0 * SOFT)


@pytest.mark.parametrize(
    ("text", "segments"),
    [
        *((text, 2) for text in ("", "ten", "10,20", "-5", "nan", "10;", "10;10,20")),
        *((text, 3) for text in ("20,10", "10,10", "0,10", "10,inf")),
    ],
)
def test_given_breakpoints_that_are_none_are_refused(text, segments):
    model = MultiSegmentVjm(breakpoints="given", given_breakpoints=text, segments=segments)
    with pytest.raises(
        ConfigError, match=rf"given_breakpoints.*(expected {segments - 1} positive|in N m)"
    ):
        model.check_params()


@pytest.mark.filterwarnings("ignore:joint stiffness not identifiable")  # from noise
def test_given_breakpoints_are_for_all_joints_or_one_list_per_joint(kr10, rng):
    q, wrench = rng.uniform(-1.0, 1.0, size=(90, 6)), rng.normal(size=(90, 6)) * 20.0
    samples = samples_with(q, wrench, rng.normal(size=(90, 3)) * 1e-3)
    breakpoints_by_text = {
        "1,2": [[1, 2]] * 6,
        "1,2;3,4;5,6;1,2;1,2;1,3": [[1, 2], [3, 4], [5, 6], [1, 2], [1, 2], [1, 3]],
    }
    for text, expected in breakpoints_by_text.items():
        model = MultiSegmentVjm(
            breakpoints="given", given_breakpoints=text, segments=3, gravity=False
        )
        np.testing.assert_array_equal(model.fit(samples, robot=kr10).breakpoints_, expected)
    two_lists = MultiSegmentVjm(breakpoints="given", given_breakpoints="1;2")
    with pytest.raises(ConfigError, match="holds 2 lists, expected 1 for all joints or 6"):
        two_lists.check_robot(kr10)
