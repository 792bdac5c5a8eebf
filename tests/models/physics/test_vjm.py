"""Check the linear VJM's stiffnesses, standard errors and unidentifiable joints."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from helpers.made_samples import samples_with
from stiff_datasets.robots.shipped_robots import shipped_robot
from stiff_models.physics.vjm import (
    VirtualJointModel,
    identify_joints,
)
from stiff_protocols.contract.errors import StiffBenchWarning

STIFFNESS = np.array([50.9e3, 63.4e3, 50.3e3, 2.27e3, 8.89e3, 1.39e3])  # the paper's Table 3


def simulated_samples(robot, rng, n=150, noise=0.0, stiffness=STIFFNESS):
    q = rng.uniform(np.maximum(robot.lower, -2), np.minimum(robot.upper, 2), size=(n, 6))
    wrench = rng.normal(size=(n, 6)) * np.repeat([60.0, 5.0], 3)
    deflection = robot.joint_deflection(1 / stiffness, q, wrench)
    scatter = rng.normal(scale=noise, size=(n, 3)) if noise else 0.0
    return samples_with(q, wrench, deflection + scatter)


def test_it_recovers_known_stiffnesses_from_exact_samples(kr10, rng):
    joints = identify_joints(kr10, simulated_samples(kr10, rng))
    np.testing.assert_allclose(joints.stiffness, STIFFNESS, rtol=1e-9)
    assert joints.rank == 6 and joints.unidentifiable == ()


@pytest.mark.slow
def test_its_standard_errors_are_the_scatter_of_repeated_identifications(kr10, rng):
    repeats = [identify_joints(kr10, simulated_samples(kr10, rng, noise=2e-5)) for _ in range(200)]
    stiffness = np.array([joints.stiffness for joints in repeats])
    standard_error = np.array([joints.standard_error for joints in repeats]).mean(axis=0)
    np.testing.assert_allclose(standard_error, stiffness.std(axis=0), rtol=0.25)


def test_a6_cannot_be_identified_with_the_tcp_on_its_axis_and_is_named(rng):
    robot = shipped_robot("kr10_r1100_2", tcp=(0.0, 0.0, 0.08))
    samples = simulated_samples(robot, rng)
    with pytest.warns(StiffBenchWarning, match=r"not identifiable.*A6 \(regressor rank 5 of 6\)"):
        model = VirtualJointModel().fit(samples, robot=robot)
    assert model.springs_.unidentifiable == ("A6",)
    assert np.isnan(model.springs_.stiffness[5]) and np.isnan(model.springs_.standard_error[5])
    np.testing.assert_allclose(model.springs_.stiffness[:5], STIFFNESS[:5], rtol=1e-9)
    np.testing.assert_allclose(
        model.predict(samples.q, samples.wrench), samples.deflection, atol=1e-15
    )


def test_joints_that_cannot_be_told_apart_are_named_and_do_not_bias_the_others(kr10, rng):
    samples = simulated_samples(kr10, rng)
    q = samples.q.copy()
    q[:, 4] = 0.0  # A4 and A6 turn about one line
    deflection = kr10.joint_deflection(1 / STIFFNESS, q, samples.wrench)
    straight_samples = replace(samples, q=q, deflection=deflection)
    joints = identify_joints(kr10, straight_samples)
    assert joints.unidentifiable == ("A4", "A6")
    assert np.isnan(joints.stiffness[[3, 5]]).all() and (joints.compliance >= 0).all()
    identified = [0, 1, 2, 4]
    np.testing.assert_allclose(joints.stiffness[identified], STIFFNESS[identified], rtol=1e-3)
    predicted_deflection = kr10.joint_deflection(joints.compliance, q, samples.wrench)
    np.testing.assert_allclose(
        predicted_deflection, deflection, atol=1e-3 * np.abs(deflection).max()
    )
