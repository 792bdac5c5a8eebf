"""Arms that a seed draws: plausible, different, and the same everywhere."""

from __future__ import annotations

import numpy as np
import pinocchio as pin
import pytest

from helpers.command_line import bench_here
from stiff_datasets.measured.sample_file import read_samples
from stiff_datasets.robots.urdf_reader import read_chain
from stiff_datasets.robots.urdf_writer import robot_urdf
from stiff_datasets.twin.effects import UNSEEN, WORLDS
from stiff_datasets.twin.fresh_arms import FreshArms, fresh_arm

SEEDS = range(200, 212)


@pytest.fixture(scope="module")
def arms():
    return [fresh_arm(seed) for seed in SEEDS]


def test_a_seed_draws_one_arm_and_another_seed_another(arms):
    again = fresh_arm(SEEDS[3])
    np.testing.assert_array_equal(again.robot().placements, arms[3].robot().placements)
    assert again.model_dump() == arms[3].model_dump()
    reaches = {arm.robot().placements[2, 2, 3] for arm in arms}
    assert len(reaches) == len({arm.payload_kg for arm in arms}) == len(arms)


def test_its_urdf_is_the_same_robot(arms, tmp_path):
    for arm in arms[:4]:
        robot, file = arm.robot(), tmp_path / f"{arm.name}.urdf"
        file.write_text(robot_urdf(robot))
        chain = read_chain(file, tcp=robot.tcp_on_flange)
        q = np.random.default_rng(1).uniform(chain.robot.lower, chain.robot.upper, (20, 6))
        np.testing.assert_allclose(chain.robot.tcp_position(q), robot.tcp_position(q), atol=1e-12)
        data = chain.model.createData()
        for angles in q[:5]:
            gravity = pin.computeGeneralizedGravity(chain.model, data, angles)
            np.testing.assert_allclose(robot.gravity_torque(angles[None])[0], -gravity, atol=1e-9)


def test_arms_are_like_those_that_are_built(arms):
    for arm in arms:
        robot = arm.robot()
        assert 3.0 <= arm.payload_kg <= 300.0 and not robot.mass_doubt and not robot.limit_doubt
        assert (robot.lower < 0.0).all() and (robot.upper > 0.0).all()
        assert 1.0 < robot.masses.sum() / arm.payload_kg < 30.0
        joints = [joint.gear_figures for joint in arm.joint]
        assert joints[1].rated_Nm >= joints[4].rated_Nm >= joints[5].rated_Nm
        kinds = {joint.kind for joint in joints[:3]}
        assert kinds == {"RV" if arm.payload_kg >= 10.0 else "strain wave"}


@pytest.mark.slow
def test_their_deflections_are_of_the_size_of_named_arms():
    medians = []
    for seed in SEEDS:
        data = FreshArms(seed=seed, world="structure").load()
        medians.append(np.median(np.linalg.norm(data.samples.deflection, axis=1)) * 1000.0)
        assert len(data.samples) == len(set(data.samples.pose_id)) == 151
    assert 0.2 < min(medians) and max(medians) < 5.0  # mm


def test_no_effect_of_the_unseen_world_is_in_another_world():
    worlds = {name: {*effects} for name, effects in WORLDS.items() if name != "unseen"}
    assert len(UNSEEN) >= 4 and not set.union(*worlds.values()) & {*UNSEEN}


@pytest.mark.slow
def test_a_fresh_arm_is_simulated_with_its_urdf(tmp_path):
    words = ("data", "simulate", "--twin", "fresh-arm-17", "--samples", "30", "--world", "unseen")
    assert not bench_here(*words, "--output", "a.csv", cwd=tmp_path).returncode
    robot = fresh_arm(17).robot()
    chain = read_chain(tmp_path / "a.urdf", tcp=robot.tcp_on_flange)
    assert len(read_samples(tmp_path / "a.csv", chain.robot)) == 30
    (tmp_path / "a.csv").unlink()
    again = bench_here(*words, "--output", "a.csv", cwd=tmp_path)
    assert again.returncode == 2 and "a.urdf" in again.stderr
