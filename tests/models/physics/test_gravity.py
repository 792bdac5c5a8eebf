"""The torque of the links' weights against Pinocchio and a closed form."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pinocchio as pin
import pytest

from stiff_models.physics.kinematics import gravity_torque
from stiff_protocols.contract.errors import DataError


def test_gravity_torque_of_the_kr10_opposes_pinocchios_generalised_gravity(kr10, kr10_chain, rng):
    model, data = kr10_chain.model, kr10_chain.model.createData()
    q = rng.uniform(kr10.lower, kr10.upper, size=(100, 6))
    truth = [-pin.computeGeneralizedGravity(model, data, pose) for pose in q]
    np.testing.assert_allclose(gravity_torque(kr10, q), truth, atol=1e-10)


def test_a_robot_on_a_wall_bears_its_weight_in_the_direction_of_its_gravity(kr10, kr10_chain, rng):
    sideways = replace(kr10, gravity=np.array([9.81, 0.0, 0.0]))
    model = kr10_chain.model.copy()
    model.gravity.linear = np.array([9.81, 0.0, 0.0])
    q = rng.uniform(kr10.lower, kr10.upper, size=(5, 6))
    truth = [-pin.computeGeneralizedGravity(model, model.createData(), pose) for pose in q]
    np.testing.assert_allclose(gravity_torque(sideways, q), truth, atol=1e-10)
    assert np.abs(gravity_torque(sideways, q)[:, 0]).max() > 10.0  # A1 is no longer vertical


def test_a_robot_without_masses_feels_nothing(kr10, rng):
    weightless = replace(kr10, masses=np.zeros(6))
    assert not gravity_torque(weightless, rng.normal(size=(3, 6))).any()


def test_wrong_number_of_joint_angles_is_refused(kr10):
    with pytest.raises(DataError, match=r"\(2, 7\), expected \(n, 6\)"):
        gravity_torque(kr10, np.zeros((2, 7)))
