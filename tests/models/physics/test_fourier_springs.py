"""Check fourier-springs: compliances that follow the posture, and samples that say little."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from helpers.made_robots import planar_arm, random_chain
from helpers.made_samples import samples_with
from stiff_models.physics.fourier_springs import FourierSprings
from stiff_models.physics.vjm import VirtualJointModel, compliance_regressor
from stiff_protocols.contract.errors import ModelError, StiffBenchWarning
from stiff_protocols.springs.identification import typical_joints

TURNS = ("revolute",) * 6


def made_samples(robot, rng, follows, n=160):
    """Return samples whose compliances are a factor `follows(a, b)` of a typical compliance."""
    q = rng.uniform(-3.0, 3.0, size=(n, robot.n_joints))
    wrench = rng.normal(size=(n, 6)) * np.repeat([60.0, 5.0], 3)
    compliance = 1e-5 * typical_joints(robot) * follows(*q[:, 1:3].T)[:, None]
    springs = compliance_regressor(robot, q, wrench)
    samples = samples_with(q, wrench, (springs @ compliance[..., None])[..., 0])
    return samples.take(np.arange(120)), samples.take(np.arange(120, n))


def error(model, samples):
    """Return the mean 3-D error over the mean deflection."""
    misses = model.predict(samples.q, samples.wrench) - samples.deflection
    sizes = np.linalg.norm([misses, samples.deflection], axis=2).mean(axis=1)
    return sizes[0] / sizes[1]


def test_compliances_that_follow_shoulder_and_elbow_are_found(rng):
    robot = random_chain(rng, TURNS)
    train, test = made_samples(robot, rng, lambda a, b: 1.0 + 0.5 * np.cos(a) * np.sin(b))
    model, linear = (cls().fit(train, robot=robot) for cls in (FourierSprings, VirtualJointModel))
    assert error(linear, test) > 0.1
    assert error(model, test) < 0.01


def test_a_series_with_the_angle_of_another_joint_is_not_found(rng):
    robot = random_chain(rng, TURNS)
    train, test = made_samples(robot, rng, lambda a, b: 1.0 + 0.5 * np.cos(3.0 * a + b))
    assert error(FourierSprings().fit(train, robot=robot), test) > 0.1


@pytest.mark.parametrize("kinds", [TURNS, ("prismatic", "revolute", "prismatic"), ("revolute",)])
def test_constant_springs_of_any_robot_are_found_and_no_compliance_is_negative(kinds, rng):
    robot = random_chain(rng, kinds)
    q, wrench = rng.uniform(-3.0, 3.0, size=(160, len(kinds))), rng.normal(size=(160, 6)) * 50.0
    springs = compliance_regressor(robot, q, wrench)
    samples = samples_with(q, wrench, springs @ (1e-5 * typical_joints(robot)))
    noise = rng.normal(size=(160, 3)) * 0.1 * np.abs(samples.deflection).mean()
    train = replace(samples, deflection=samples.deflection + noise).take(np.arange(120))
    model = FourierSprings().fit(train, robot=robot)
    assert error(model, samples.take(np.arange(120, 160))) < 0.05
    anywhere = model.compliance(rng.uniform(-np.pi, np.pi, size=(500, len(kinds))))
    assert anywhere.shape == (500, len(kinds))
    assert anywhere.min() >= 0.0
    assert not model.predict(q, np.zeros_like(wrench)).any()


def test_a_joint_that_no_load_turns_is_rigid(rng):
    robot, q = planar_arm(2, (0.0, 0.0, 1.0)), rng.uniform(-1.0, 1.0, size=(40, 2))
    wrench = np.zeros((40, 6))
    wrench[:, :3] = np.outer(rng.normal(size=40), robot.forward(q).rotation[0][:, 0])
    upwards = np.zeros((40, 6))
    upwards[:, 2] = 30.0
    springs = compliance_regressor(robot, q, wrench)
    model = FourierSprings().fit(samples_with(q, wrench, springs @ [1e-5, 1e-5]), robot=robot)
    assert not model.predict(q, upwards).any()


def test_samples_without_a_load_or_with_wrong_signs_are_named(rng):
    robot = random_chain(rng, TURNS)
    train, _ = made_samples(robot, rng, lambda a, b: np.ones_like(a))
    with pytest.raises(ModelError, match="no wrench turns any joint"):
        FourierSprings().fit(replace(train, wrench=np.zeros_like(train.wrench)), robot=robot)
    with pytest.warns(StiffBenchWarning, match="no joint spring explains"):
        model = FourierSprings().fit(replace(train, wrench=-train.wrench), robot=robot)
    assert not model.coefficients_.any()
