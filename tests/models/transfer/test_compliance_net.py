"""Check that `compliance-net` keeps to physics for any weights of its network."""

from __future__ import annotations

import numpy as np
import pytest

from stiff_models.physics.vjm import VirtualJointModel
from stiff_models.transfer.compliance_net import ComplianceNet

SMALL = {"width": 16, "device": "cpu"}


@pytest.fixture(scope="module")
def fitted(parts):
    robot, train, held_out, _ = parts
    return ComplianceNet(**SMALL, epochs=100, learning_rate=3e-3).fit(
        train, robot=robot, validation=held_out, seed=1
    )


@pytest.mark.slow
def test_no_load_gives_exactly_no_deflection(fitted, parts):
    test = parts[3]
    assert not fitted.predict(test.q, np.zeros_like(test.wrench)).any()


def test_before_fine_tuning_it_is_the_vjm(parts):
    robot, train, held_out, test = parts
    net = ComplianceNet(**SMALL, epochs=0).fit(train, robot=robot, validation=held_out)
    vjm = VirtualJointModel().fit(train, robot=robot)
    difference = net.predict(test.q, test.wrench) - vjm.predict(test.q, test.wrench)
    assert np.abs(difference).max() < 1e-6 * np.abs(test.deflection).max()
    np.testing.assert_allclose(
        net.compliance(test.q, test.wrench),
        np.broadcast_to(vjm.springs_.compliance, (len(test), 6)),
        rtol=1e-6,
    )


@pytest.mark.slow
def test_every_compliance_matrix_is_positive_semi_definite(fitted, parts):
    test = parts[3]
    move = fitted.robot_.jacobian(test.q)[:, :3]
    compliance = fitted.compliance(test.q, test.wrench)
    matrices = np.einsum("nij,nj,nkj->nik", move, compliance, move)
    assert (np.linalg.eigvalsh(matrices) >= -1e-18).all()
    assert np.ptp(compliance, axis=0).min() > 0.0  # it has learned something


@pytest.mark.slow
def test_its_prediction_is_the_equation_with_its_compliances(fitted, parts):
    test = parts[3]
    rows = fitted.robot_.jacobian(test.q)
    torque = np.einsum("nki,nk->ni", rows, test.wrench)
    bent = fitted.compliance(test.q, test.wrench) * torque
    np.testing.assert_allclose(
        fitted.predict(test.q, test.wrench),
        np.einsum("nij,nj->ni", rows[:, :3], bent),
        atol=1e-6 * np.abs(test.deflection).max(),
    )
