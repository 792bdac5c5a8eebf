"""Check the digital twin against Pinocchio and closed forms, and the random numbers of its data."""

from __future__ import annotations

import itertools

import numpy as np
import pytest

from helpers.made_robots import track_lines, tree_urdf
from helpers.pinocchio_twin import pinocchio_torque
from stiff_datasets.planning.poses import Poses
from stiff_datasets.robots.urdf_reader import read_chain
from stiff_datasets.twin.effects import Friction
from stiff_datasets.twin.elastic_chain import ElasticChain
from stiff_datasets.twin.experiment import TwinExperiment, recorded_deflection, recorded_wrench
from stiff_datasets.twin.gears import StrainWaveGear
from stiff_datasets.twin.twin import DigitalTwin
from stiff_datasets.twin.twin_file import JointTable, Noise, shipped_constants, specimen_law
from stiff_protocols.contract.errors import DataError

KR10, UR5 = (shipped_constants(name) for name in ("kr10_r1100_2", "ur5"))
POSE = np.deg2rad([[20.0, -70.0, 80.0, 10.0, 40.0, 15.0]])
LOAD = np.array([[60.0, 20.0, -60.0, 3.0, -4.0, 2.0]])
STIFFNESS = np.array([5.1e4, 6.3e4, 5.0e4, 2.3e3, 8.9e3, 1.4e3])


def linear_twin(stiffness):
    """Return the KR10 with one straight spring per joint, N m/rad."""
    gears = (
        StrainWaveGear(slopes_Nm_per_rad=(k,) * 3, breakpoints_Nm=(1.0, 2.0), rated_Nm=100.0)
        for k in stiffness
    )
    rigid = {"structure_Nm_per_rad": np.inf, "tilting_ratio": np.inf}
    joints = tuple(JointTable(gear=gear, **rigid) for gear in gears)
    return DigitalTwin.in_world(KR10.model_copy(update={"joint": joints}), 0, "clean")


@pytest.mark.parametrize("is_on_track", [False, True])
def test_torques_and_tcp_are_those_of_pinocchios_elastic_model(
    is_on_track, kr10_chain, tmp_path, rng
):
    chain = kr10_chain
    if is_on_track:
        chain = read_chain(tree_urdf(tmp_path / "track.urdf", track_lines()), tcp=(0.1, 0.0, 0.2))
    n = chain.robot.n_joints
    q, theta = rng.uniform(-1.5, 1.5, (n, 20)), 0.01 * rng.normal(size=(3 * n, 20))
    wrench = rng.normal(size=(6, 20)) * np.repeat([60.0, 6.0], 3)[:, None]
    torques, points = ElasticChain(chain.robot).statics(q, theta, wrench)
    for i in range(20):
        torque, tcp, _ = pinocchio_torque(chain, q[:, i], theta[:, i], wrench[:, i])
        np.testing.assert_allclose(torques[:, i], torque, atol=1e-10)
        np.testing.assert_allclose(points[:, i], tcp, atol=1e-14)


def test_straight_springs_about_the_axes_are_the_linear_vjm_to_first_order(kr10):
    errors = []
    for factor in (1.0, 2.0, 4.0, 8.0):
        expected = factor * kr10.joint_deflection(1.0 / (factor * STIFFNESS), POSE, LOAD)
        difference = factor * linear_twin(factor * STIFFNESS).truth(POSE, LOAD) - expected
        errors.append(np.linalg.norm(difference) / np.linalg.norm(expected))
    # the error is of second order: twice the stiffness, half the error
    np.testing.assert_allclose(np.divide(errors[:-1], errors[1:]), 2.0, rtol=0.03)
    assert errors[-1] < 1e-2


def test_a_joint_turns_by_its_gears_slopes_and_its_structure_and_by_less_with_friction():
    joint, torque = UR5.joint[0], 60.0
    (k1, k2, k3), (t1, t2) = joint.gear_figures.slopes_Nm_per_rad, joint.gear_figures.breakpoints_Nm
    turn = t1 / k1 + (t2 - t1) / k2 + (torque - t2) / k3 + torque / joint.structure_Nm_per_rad
    clean, rough = (DigitalTwin.in_world(UR5, 0, world) for world in ("clean", "friction"))
    torques = np.array([[torque, 0.0, 0.0, 0.0, 0.0, 0.0]])
    assert clean.joint_turn(torques)[0] == pytest.approx([turn, 0.0, 0.0, 0.0, 0.0, 0.0])
    # half of the loop, whichever direction the joint came from
    turn -= Friction.drawn(UR5, 0).width[0] / 2.0
    assert rough.joint_turn(torques)[0] == pytest.approx([turn, 0.0, 0.0, 0.0, 0.0, 0.0])


def test_rows_do_not_depend_on_their_neighbours_and_no_load_moves_nothing(rng):
    twin = DigitalTwin.in_world(UR5, 1, "all")
    q, wrench = rng.uniform(-1.5, 1.5, (20, 6)), 20.0 * rng.normal(size=(20, 6))
    every, alone = twin.truth(q, wrench), twin.truth(q[7:8], wrench[7:8])
    np.testing.assert_allclose(every[7:8], alone, rtol=0, atol=1e-12)
    assert np.abs(twin.truth(q, 0.0 * wrench)).max() < 1e-12


def test_a_load_that_no_spring_can_carry_is_refused():
    with pytest.raises(DataError, match=r"no elastic equilibrium at q = .* the load is too large"):
        linear_twin([20.0] * 6).truth(POSE, LOAD)


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
    names = np.arange(50).astype(str)
    poses = Poses(np.zeros((50, 6)), names, names)
    draws = []
    for constants, specimen, loads in ((KR10, 0, 1), (KR10, 1, 1), (KR10, 0, 5), (UR5, 0, 1)):
        experiment = TwinExperiment(constants, specimen=specimen, seed=0, loads_per_pose=loads)
        force = experiment.wrenches(np.zeros((50, 6)))[:, :3]
        measurement = experiment.measurement(poses)
        noise = (measurement.samples.deflection - measurement.noiseless)[:50]
        draws.append((force / np.linalg.norm(force, axis=1, keepdims=True), noise))
    for pair in itertools.combinations(draws, 2):
        for first, second in zip(*pair, strict=True):
            assert np.abs(np.corrcoef(first.ravel(), second.ravel())[0, 1]) < 0.3
    factors = [
        (specimen_law(constants, 3).compliance / specimen_law(constants, 0).compliance)[0, 1::3]
        for constants in (KR10, UR5)
    ]
    assert not np.isclose(*factors).any()  # specimens of two robots
