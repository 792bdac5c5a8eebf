"""Check the Cartesian stiffness of joint springs against closed forms and differences."""

from __future__ import annotations

import numpy as np
import pytest

import stiffbench as sb
from helpers.made_robots import planar_arm
from stiff_apply.cartesian_stiffness import (
    cartesian_compliance,
    cartesian_stiffness,
    largest_compliance,
)

STIFFNESS = np.array([5e4, 2e4])
"""Joint stiffnesses [N m/rad] of a planar arm with links of 1 m."""
ANGLES = np.array([[0.3, 0.9], [-1.0, 2.1], [2.0, -0.4]])


def closed_form(angles):
    """Return K_X = J^-T K J^-1 of the planar arm, N/m, with J^-1 by Cramer's rule."""
    matrices = []
    for q1, q2 in angles:
        sine, cosine = np.sin([q1, q1 + q2]), np.cos([q1, q1 + q2])
        inverse = np.array([[cosine[1], sine[1]], [-cosine[0] - cosine[1], -sine[0] - sine[1]]])
        inverse /= np.sin(q2)
        matrices.append(inverse.T @ np.diag(STIFFNESS) @ inverse)
    return np.array(matrices)


def translational_compliance(predict, q, wrench, step):
    """Return (n, 3, 3) derivatives of the deflection by the force, by central differences, m/N."""
    compliance = np.empty((len(q), 3, 3))
    for axis, shift in enumerate(step * np.eye(3, 6)):
        change = predict(q, wrench + shift) - predict(q, wrench - shift)
        compliance[:, :, axis] = change / (2.0 * step)
    return compliance


def test_the_stiffness_of_a_planar_arm_is_that_of_the_closed_form():
    rows = planar_arm(2, (0.0, 0.0, 1.0)).jacobian(ANGLES)[:, :2]
    computed = cartesian_stiffness(rows, 1.0 / STIFFNESS)
    np.testing.assert_allclose(computed, closed_form(ANGLES), rtol=1e-10)


def test_a_stretched_arm_and_a_rigid_spring_have_a_compliance_but_no_stiffness():
    rows = planar_arm(2, (0.0, 0.0, 1.0)).jacobian(np.array([[0.5, 0.0], [0.5, 1.0]]))[:, :2]
    assert np.isnan(cartesian_stiffness(rows, 1.0 / STIFFNESS)).all(axis=(1, 2)).tolist() == [
        True,
        False,
    ]
    rigid = np.array([0.0, 1.0 / STIFFNESS[1]])
    assert np.isnan(cartesian_stiffness(rows, rigid)).all()
    compliance = cartesian_compliance(rows, rigid)
    tip = np.array([-np.sin(0.5), np.cos(0.5)])  # the second link turns about its own joint
    np.testing.assert_allclose(compliance[0], np.outer(tip, tip) / STIFFNESS[1], atol=1e-18)
    np.testing.assert_allclose(
        largest_compliance(np.pad(compliance, ((0, 0), (0, 1), (0, 1)))), 1.0 / STIFFNESS[1]
    )


@pytest.fixture(scope="module")
def vjm(twin):
    return sb.make_model("vjm").fit(twin)


def test_the_compliance_of_vjm_is_the_derivative_of_its_prediction(vjm, twin):
    q, wrench = twin.samples.q[::20], twin.samples.wrench[::20]
    rows = twin.robot.jacobian(q)
    computed = cartesian_compliance(rows, vjm.fitted.springs_.compliance)
    derivative = translational_compliance(vjm.fitted.predict, q, wrench, 10.0)
    np.testing.assert_allclose(computed[:, :3, :3], derivative, rtol=0, atol=1e-9 * computed.max())
    stiffness = cartesian_stiffness(rows, vjm.fitted.springs_.compliance)
    regular = np.linalg.cond(rows) < 100.0
    identity = stiffness[regular] @ computed[regular]
    np.testing.assert_allclose(identity, np.tile(np.eye(6), (regular.sum(), 1, 1)), atol=1e-6)
