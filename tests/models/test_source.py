"""The source domain: its size, its grid, its physics, and that only training samples shape it."""

from __future__ import annotations

import numpy as np
import pytest

from stiff_datasets.fanuc_r2000ic import FanucR2000iC
from stiff_datasets.kr10_twin import Kr10Twin
from stiff_models.source import PAPER_WRENCHES, simulate, source_design
from stiff_models.vjm import joint_deflection
from stiff_protocols.errors import ConfigError

COMPLIANCE = 1 / np.array([50.9e3, 63.4e3, 50.3e3, 2.27e3, 8.89e3, 1.39e3])


@pytest.fixture(scope="module")
def twin():
    return Kr10Twin().load()


def test_the_papers_source_has_21280_poses_and_106400_samples(twin):
    design = source_design("auto", twin.robot, twin.samples, 0)
    assert len(np.unique(design.q, axis=0)) == 21_280
    assert len(simulate(twin.robot, COMPLIANCE, design)) == 106_400
    values = [len(np.unique(design.q[:, joint])) for joint in range(6)]
    assert values == [7, 19, 16, 1, 10, 1]
    assert (design.q >= twin.robot.lower).all() and (design.q <= twin.robot.upper).all()


def test_table_5_has_rank_3_and_lies_almost_on_a_line():
    singular = np.linalg.svd(PAPER_WRENCHES, compute_uv=False)
    np.testing.assert_allclose(singular[:3], [196.6, 93.9, 2.9], atol=0.06)
    assert (singular[3:] < 1e-10).all()


def test_source_deflections_are_those_of_each_sample_alone(twin, rng):
    domain = simulate(twin.robot, COMPLIANCE, source_design("paper", twin.robot, twin.samples, 0))
    rows = rng.integers(len(domain), size=200)
    np.testing.assert_allclose(
        domain.deflection[rows],
        joint_deflection(twin.robot, COMPLIANCE, domain.q[rows], domain.wrench[rows]),
        rtol=1e-12,
        atol=1e-18,
    )


def test_another_robots_source_spans_its_own_poses_and_loads():
    data = FanucR2000iC().load()
    design = source_design("auto", data.robot, data.samples, 0)
    assert len(design.q) == 5**6
    np.testing.assert_allclose(design.q.min(axis=0), data.samples.q.min(axis=0))
    np.testing.assert_allclose(design.q.max(axis=0), data.samples.q.max(axis=0))
    loads, own = design.wrench.reshape(-1, 6), data.samples.wrench
    assert not loads[:, 3:].any()  # no torque was recorded
    spread = loads[:, :3].std(axis=0) / own[:, :3].std(axis=0)
    assert ((spread > 0.9) & (spread < 1.6)).all()
    np.testing.assert_allclose(loads.mean(axis=0), own.mean(axis=0), atol=0.1 * np.abs(own).max())


def test_the_papers_source_is_refused_for_a_robot_without_six_joints(tmp_path):
    from stiff_datasets.robots.robot import load_robot

    path = tmp_path / "one.urdf"
    path.write_text(
        '<robot name="one"><link name="a"/><joint name="j" type="continuous"><parent link="a"/>'
        '<child link="b"/><axis xyz="0 0 1"/></joint><link name="b"/></robot>'
    )
    with pytest.raises(ConfigError, match=r"Table 4 has 6 joints, robot 'one' has 1"):
        source_design("paper", load_robot(path), FanucR2000iC().load().samples, 0)
