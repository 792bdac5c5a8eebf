"""The source domain: its size, its grid, its physics, and that only training samples shape it."""

from __future__ import annotations

import itertools
from dataclasses import replace

import numpy as np
import pytest

from made_robots import random_chain
from stiff_datasets.measured.fanuc_r2000ic import FanucR2000iC
from stiff_models.physics.vjm import joint_deflection
from stiff_models.transfer.mlp_pretrained import MlpPretrained
from stiff_models.transfer.source import (
    PAPER_WRENCHES,
    SourceDesign,
    design_deflection,
    simulate,
    source_design,
)
from stiff_protocols.contract.errors import ConfigError

COMPLIANCE = 1 / np.array([50.9e3, 63.4e3, 50.3e3, 2.27e3, 8.89e3, 1.39e3])


def test_the_papers_source_has_21280_poses_and_106400_samples(twin):
    design = source_design("auto", "auto", twin.robot, twin.samples, 0)
    assert len(np.unique(design.q, axis=0)) == 21_280
    assert len(simulate(twin.robot, COMPLIANCE, design)) == 106_400
    values = [len(np.unique(design.q[:, joint])) for joint in range(6)]
    assert values == [7, 19, 16, 1, 10, 1]
    assert (design.q >= twin.robot.lower).all() and (design.q <= twin.robot.upper).all()


def test_table_5_has_rank_3_and_lies_almost_on_a_line():
    singular = np.linalg.svd(PAPER_WRENCHES, compute_uv=False)
    np.testing.assert_allclose(singular[:3], [196.6, 93.9, 2.9], atol=0.06)
    assert (singular[3:] < 1e-10).all()


@pytest.mark.parametrize(
    ("kinds", "values"),
    [
        (("revolute",) * 6, (7, 3, 2, 1, 2, 1)),
        (("prismatic", "revolute", "revolute"), (4, 3, 5)),
        (("revolute", "prismatic", "revolute", "prismatic"), (1, 3, 2, 4)),
        (("revolute",), (5,)),
        (("prismatic",), (3,)),
    ],
)
def test_a_grid_of_any_robot_gives_what_its_samples_give_alone(kinds, values, rng):
    for _ in range(5):
        robot = random_chain(rng, kinds)
        compliance = rng.uniform(size=len(kinds))
        axes = [rng.uniform(-3, 3, size=n) for n in values]
        q = np.array(list(itertools.product(*axes)))
        design = SourceDesign(q, rng.normal(size=(1, 3, 6)), axes[0])
        whole = simulate(robot, compliance, design)
        truth = joint_deflection(robot, compliance, whole.q, whole.wrench)
        largest = np.abs(truth).max()
        np.testing.assert_allclose(whole.deflection, truth, rtol=0, atol=1e-13 * largest)
        plain = design_deflection(robot, compliance, replace(design, first_values=None))
        np.testing.assert_allclose(
            whole.deflection, plain.reshape(-1, 3), rtol=0, atol=1e-13 * largest
        )


def test_another_robots_source_spans_its_own_poses_and_loads():
    data = FanucR2000iC().load()
    design = source_design("auto", "auto", data.robot, data.samples, 0)
    assert len(design.q) == 5**6
    np.testing.assert_allclose(design.q.min(axis=0), data.samples.q.min(axis=0))
    np.testing.assert_allclose(design.q.max(axis=0), data.samples.q.max(axis=0))
    loads, own = design.wrench.reshape(-1, 6), data.samples.wrench
    assert not loads[:, 3:].any()  # no torque was recorded
    spread = loads[:, :3].std(axis=0) / own[:, :3].std(axis=0)
    assert ((spread > 0.9) & (spread < 1.6)).all()
    np.testing.assert_allclose(loads.mean(axis=0), own.mean(axis=0), atol=0.1 * np.abs(own).max())


@pytest.mark.parametrize("wrenches", ["uniform", "sobol"])
def test_drawn_wrenches_fill_the_range_of_the_training_samples_components(twin, wrenches):
    design = source_design("paper", wrenches, twin.robot, twin.samples, 0)
    loads, own = design.wrench.reshape(-1, 6), twin.samples.wrench
    assert loads.shape == (106_400, 6)
    lower, upper = own.min(axis=0), own.max(axis=0)
    assert (loads >= lower).all() and (loads <= upper).all()
    np.testing.assert_allclose(loads.mean(axis=0), (lower + upper) / 2, atol=0.5)
    assert np.linalg.matrix_rank(loads) == 6


def model_with(**options):
    return MlpPretrained(**options, device="cpu", width=8, pretrain_steps=0)


def test_nominal_stiffnesses_of_the_papers_robot_are_its_table_3(twin):
    model = model_with(source_stiffness="nominal", source_poses="data").fit(
        twin.samples, robot=twin.robot
    )
    domain = model._simulated(twin.samples, twin.robot, 0)
    stiffness = 1000 * np.array([50.90, 63.36, 50.34, 2.27, 8.89, 1.39])
    np.testing.assert_allclose(
        domain.deflection[:50],
        joint_deflection(twin.robot, 1 / stiffness, domain.q[:50], domain.wrench[:50]),
    )


def test_sobol_poses_and_sobol_wrenches_are_independent(twin):
    design = source_design("sobol", "sobol", twin.robot, twin.samples, 0)
    for joint in (0, 1, 2, 4):
        for component in range(6):
            counts, _, _ = np.histogram2d(
                np.repeat(design.q[:, joint], 5), design.wrench[:, :, component].ravel(), bins=32
            )
            assert (
                counts == 0
            ).mean() < 0.01  # side by side, 81 % of the cells of A1, Fx are empty


@pytest.mark.parametrize(
    ("text", "refused"),
    [
        (None, r"nominal_stiffness=6 values in N m/rad"),
        *((text, "6 positive numbers") for text in ("1,2", "1,2,3,4,5,0", "1,2,3,4,5,x")),
        ("1,2,3,4,5,inf", "6 positive numbers"),
    ],
)
def test_nominal_stiffnesses_of_another_robot_must_be_given_one_a_joint(text, refused):
    robot = FanucR2000iC().load().robot
    with pytest.raises(ConfigError, match=refused):
        model_with(source_stiffness="nominal", nominal_stiffness=text).check_robot(robot)
    given = model_with(source_stiffness="nominal", nominal_stiffness="1e6,2e6,2e6,3e5,4e5,2e5")
    given.check_robot(robot)
    with pytest.raises(ConfigError, match="would not be used: source_stiffness is 'identified'"):
        model_with(nominal_stiffness="1,2,3,4,5,6").check_robot(robot)


def test_the_papers_source_is_refused_for_a_robot_without_six_joints(rng):
    one = random_chain(rng, ("revolute",))
    with pytest.raises(ConfigError, match=r"Table 4 has 6 joints, robot 'chain' has 1"):
        model_with(source_poses="paper").check_robot(one)
