"""Check the full VJM: springs about all axes, their identification and intervals."""

from __future__ import annotations

import numpy as np
import pytest

from helpers.made_samples import samples_with
from stiff_datasets.twin.kr10_twin import Kr10Twin
from stiff_datasets.twin.twin_file import shipped_constants, specimen_law
from stiff_models.physics.full_vjm import FullVjm, ridge, spring_regressor, spring_units
from stiff_models.physics.vjm import compliance_regressor, identify_joints
from stiff_protocols.kinematics.serial_chain import joint_torque


def loads(rng, n=120):
    q = rng.uniform(-1.5, 1.5, size=(n, 6))
    return q, rng.normal(size=(n, 6)) * np.repeat([60.0, 5.0], 3)


def own_springs(robot, springs):
    names = [f"{name} rz" for name in robot.joint_names]
    return [spring_names(robot, springs).index(name) for name in names]


def spring_names(robot, springs):
    return list(spring_units(robot, springs))


@pytest.mark.parametrize("springs", [3, 6])
def test_with_only_the_springs_about_the_joints_axes_it_is_the_linear_vjm(springs, kr10, rng):
    q, wrench = loads(rng)
    regressor = spring_regressor(kr10, q, wrench, springs)
    assert regressor.shape == (120, 3, 6 * springs) == (120, 3, len(spring_names(kr10, springs)))
    np.testing.assert_allclose(
        regressor[..., own_springs(kr10, springs)],
        compliance_regressor(kr10, q, wrench),
        atol=1e-12,
    )


def test_a_joint_that_tilts_is_told_from_one_that_turns(kr10, rng):
    q, wrench = loads(rng)
    springs = spring_names(kr10, 3)
    compliance = np.zeros(18)
    compliance[springs.index("A1 rx")], compliance[springs.index("A2 rz")] = 2e-5, 3e-5
    deflection = spring_regressor(kr10, q, wrench, 3) @ compliance
    model = FullVjm().fit(samples_with(q, wrench, deflection), robot=kr10)
    names, stiffness = model.springs_.names, model.springs_.stiffness
    assert stiffness[names.index("A1 rx")] == pytest.approx(1 / 2e-5, rel=0.02)
    assert stiffness[names.index("A2 rz")] == pytest.approx(1 / 3e-5, rel=0.02)


def test_ridge_minimises_generalised_cross_validation_against_brute_force(rng):
    matrix = rng.normal(size=(40, 8)) @ np.diag(np.geomspace(1.0, 1e-2, 8))
    target = matrix @ rng.normal(size=8) + rng.normal(size=40) * 0.3

    def gcv(strength):
        hat = matrix @ np.linalg.solve(matrix.T @ matrix + strength * np.eye(8), matrix.T)
        residual = target - hat @ target
        return (residual @ residual) / np.trace(np.eye(40) - hat) ** 2

    best_strength = min(np.geomspace(1e-8, 1e1, 2000), key=gcv)
    truth = np.linalg.solve(matrix.T @ matrix + best_strength * np.eye(8), matrix.T @ target)
    np.testing.assert_allclose(ridge(matrix, target), truth, rtol=0.02, atol=1e-3)


@pytest.mark.slow
def test_more_intervals_of_its_torsion_springs_hold_the_twins_own_than_of_those_of_vjm():
    """Gears have three slopes, so a linear spring has no exact value."""
    of_full, of_vjm = list[bool](), list[bool]()
    for specimen in range(5):
        data = Kr10Twin(specimen=specimen).load()
        samples, robot = data.samples, data.robot
        gears = specimen_law(shipped_constants("kr10_r1100_2"), specimen)
        load = joint_torque(robot.jacobian(samples.q), samples.wrench)  # (n, 6) N m
        weight = robot.gravity_torque(samples.q)
        angles = [
            gears.angle(np.kron(torque.T, [[1.0], [0.0], [0.0]]))[::3].T  # no tilting
            for torque in (weight + load, weight)
        ]
        stiffness = (load**2).sum(axis=0) / (load * (angles[0] - angles[1])).sum(axis=0)
        springs = FullVjm().fit(samples, robot=robot).springs_
        of_full += intervals_hold(springs, " rz", stiffness)
        of_vjm += intervals_hold(identify_joints(robot, samples), "", stiffness)
    assert np.mean(of_full) >= 0.7 and len(of_full) >= 15
    assert np.mean(of_vjm) <= 0.5


def intervals_hold(springs, kind, stiffness):
    """Return if the 90 % interval of each identified joint spring holds its true stiffness."""
    indices = [springs.names.index(f"A{joint}{kind}") for joint in range(1, 7)]
    low, high = springs.interval(0.9)[indices].T
    return [*((low <= stiffness) & (stiffness <= high))[springs.is_identified[indices]]]
