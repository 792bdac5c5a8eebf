"""Check the source domain's size, grid and physics, and its ranges from training samples."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from helpers.made_robots import planar_arm, random_chain
from helpers.made_samples import samples_with
from stiff_datasets.measured.fanuc_r2000ic import FanucR2000iC
from stiff_models.transfer.pretrained_mlp import MlpPretrained
from stiff_models.transfer.source_domain import (
    SourceDesign,
    joint_ranges,
    load_ranges,
    simulate,
    source_design,
)
from stiff_protocols.contract.errors import ConfigError

COMPLIANCE = 1 / np.array([50.9e3, 63.4e3, 50.3e3, 2.27e3, 8.89e3, 1.39e3])


def test_the_papers_source_has_21280_poses_and_106400_samples(twin):
    design = source_design("paper", "paper", twin.robot, twin.samples, 0)
    assert len(np.unique(design.q, axis=0)) == 21_280
    assert len(simulate(twin.robot, COMPLIANCE, design)) == 106_400
    values = [len(np.unique(design.q[:, joint])) for joint in range(6)]
    assert values == [7, 19, 16, 1, 10, 1]
    assert (design.q >= twin.robot.lower).all() and (design.q <= twin.robot.upper).all()


@pytest.mark.parametrize("kinds", [("revolute",) * 6, ("prismatic", "revolute", "prismatic")])
def test_each_springs_part_is_its_deflection_with_all_others_rigid(kinds, rng):
    robot, compliance = random_chain(rng, kinds), rng.uniform(size=len(kinds))
    design = SourceDesign(rng.uniform(-3, 3, size=(20, len(kinds))), rng.normal(size=(20, 3, 6)))
    domain = simulate(robot, compliance, design)
    for joint, joint_compliance in enumerate(np.diag(compliance)):
        truth = robot.joint_deflection(joint_compliance, domain.q, domain.wrench)
        np.testing.assert_allclose(domain.parts[:, :, joint], truth, rtol=0, atol=1e-12)
    truth = robot.joint_deflection(compliance, domain.q, domain.wrench)
    np.testing.assert_allclose(domain.deflection, truth, rtol=0, atol=1e-12)


def test_another_robots_source_spans_its_own_poses_and_loads_rounded_outwards():
    data = FanucR2000iC().load()
    design = source_design("sobol", "uniform", data.robot, data.samples, 0)
    lower, upper = joint_ranges(data.robot, data.samples.q)
    assert (lower <= design.q).all() and (design.q <= upper).all()
    assert (np.ptp(design.q, axis=0) > 0.99 * (upper - lower)).all()
    loads, measured_loads = design.wrench.reshape(-1, 6), data.samples.wrench
    assert not loads[:, 3:].any()  # no torque was recorded
    assert (
        loads.min(axis=0)[:3]
        < measured_loads.min(axis=0)[:3] + 0.01 * np.ptp(measured_loads[:, :3], axis=0)
    ).all()


@pytest.mark.usefixtures("small_source")
def test_the_source_of_an_endless_joint_spans_the_smallest_arc_of_its_angles(rng):
    robot = replace(planar_arm(2, (0.0, 0.0, 1.0)), lower=[-np.inf] * 2, upper=[np.inf] * 2)
    q = np.deg2rad(np.column_stack([rng.uniform(170.0, 190.0, 40), rng.uniform(0.0, 40.0, 40)]))
    wrapped = (q + np.pi) % (2.0 * np.pi) - np.pi
    samples = samples_with(wrapped, rng.normal(size=(40, 6)), np.zeros((40, 3)))
    spans = np.ptp(source_design("sobol", "uniform", robot, samples, 0).q, axis=0)
    assert (np.rad2deg(spans) <= [30.0, 45.0]).all()


def test_ranges_hold_all_samples_in_steps_of_15_degrees_and_of_1_2_5(rng):
    robot = random_chain(rng, ("revolute", "prismatic", "revolute"))
    for scale in (0.01, 1.0, 300.0):
        q = rng.uniform(-2, 3, size=(9, 3)) * [1.0, 0.1 * scale, 1.0]
        lower, upper = joint_ranges(robot, q)
        assert (lower <= q.min(axis=0)).all() and (q.max(axis=0) <= upper).all()
        steps = np.rad2deg([lower, upper])[:, [0, 2]] / 15
        np.testing.assert_allclose(steps, steps.round(), atol=1e-9)
        wrench = scale * rng.normal(size=(9, 6))
        low, high = load_ranges(wrench)
        assert (low <= wrench.min(axis=0)).all() and (wrench.max(axis=0) <= high).all()
        digits = {f"{bound:e}"[0] for bound in np.abs([*low, *high, lower[1], upper[1]])}
        assert digits <= {"0", "1", "2", "5"}


@pytest.mark.parametrize("wrenches", ["uniform", "sobol"])
def test_drawn_wrenches_fill_the_range_of_the_training_samples_components(twin, wrenches):
    design = source_design("paper", wrenches, twin.robot, twin.samples, 0)
    loads, measured_loads = design.wrench.reshape(-1, 6), twin.samples.wrench
    assert loads.shape == (106_400, 6)
    lower, upper = load_ranges(measured_loads)
    assert (loads >= lower).all() and (loads <= upper).all()
    np.testing.assert_allclose(loads.mean(axis=0), (lower + upper) / 2, atol=0.5)
    assert np.linalg.matrix_rank(loads) == 6


def model_with(**options):
    return MlpPretrained(**options, device="cpu", width=8, pretrain_steps=0)


@pytest.mark.parametrize(
    ("text", "message"),
    [
        (None, r"nominal_stiffness to 6 values in N m/rad"),
        *((text, "6 positive numbers") for text in ("1,2", "1,2,3,4,5,0", "1,2,3,4,5,x")),
        ("1,2,3,4,5,inf", "6 positive numbers"),
    ],
)
def test_nominal_stiffnesses_of_another_robot_must_be_given_per_joint(text, message):
    robot = FanucR2000iC().load().robot
    with pytest.raises(ConfigError, match=message):
        model_with(source_stiffness="nominal", nominal_stiffness=text).check_robot(robot)
    complete_model = model_with(
        source_stiffness="nominal", nominal_stiffness="1e6,2e6,2e6,3e5,4e5,2e5"
    )
    complete_model.check_robot(robot)
    with pytest.raises(ConfigError, match="would be ignored: source_stiffness is 'identified'"):
        model_with(nominal_stiffness="1,2,3,4,5,6").check_robot(robot)


def test_the_papers_source_is_refused_for_a_robot_without_six_joints(rng):
    one_joint_robot = random_chain(rng, ("revolute",))
    with pytest.raises(ConfigError, match=r"Table 4 has 6 joints, robot 'chain' has 1"):
        model_with(source_poses="paper").check_robot(one_joint_robot)
