"""The fused deflection of joint springs against the product of Jacobians."""

from __future__ import annotations

import numpy as np
import pytest

from made_robots import random_chain
from stiff_models.physics.kinematics import compliance_matrix, jacobian, joint_deflection
from stiff_protocols.contract.errors import DataError

KINDS = [
    ("revolute",) * 6,
    ("prismatic", "revolute", "prismatic", "revolute", "revolute"),
    ("revolute", "revolute", "prismatic"),
    ("prismatic",),
    ("prismatic", "prismatic"),
    ("revolute",) * 7,
]


@pytest.fixture(params=KINDS, ids=lambda kinds: "".join(kind[0] for kind in kinds))
def case(request, rng):
    """Robot, compliances (one joint rigid where there are several), poses and wrenches."""
    robot = random_chain(rng, request.param)
    compliance = rng.uniform(0.1, 1.0, size=robot.n_joints)
    compliance[1:2] = 0.0
    return (
        robot,
        compliance,
        rng.uniform(-3, 3, size=(60, robot.n_joints)),
        rng.normal(size=(60, 6)),
    )


def test_deflection_and_compliance_matrix_are_the_product_of_the_jacobians(case):
    robot, compliance, q, wrench = case
    rows = jacobian(robot, q)
    matrices = (rows[:, :3] * compliance) @ rows.transpose(0, 2, 1)
    for found, truth in (
        (compliance_matrix(robot, compliance, q), matrices),
        (joint_deflection(robot, compliance, q, wrench), (matrices @ wrench[..., None])[..., 0]),
    ):
        np.testing.assert_allclose(found, truth, rtol=0, atol=1e-13 * np.abs(truth).max())


@pytest.mark.parametrize("function", [joint_deflection, compliance_matrix])
def test_springs_of_another_number_than_the_joints_are_refused(function, kr10):
    wrench = (np.zeros((2, 6)),) if function is joint_deflection else ()
    with pytest.raises(DataError, match=r"compliance has shape \(5,\), expected \(6,\)"):
        function(kr10, np.ones(5), np.zeros((2, 6)), *wrench)


def test_wrenches_of_another_number_than_the_poses_are_refused(kr10):
    with pytest.raises(DataError, match=r"wrench has shape \(3, 6\), expected \(2, 6\)"):
        joint_deflection(kr10, np.ones(6), np.zeros((2, 6)), np.zeros((3, 6)))
