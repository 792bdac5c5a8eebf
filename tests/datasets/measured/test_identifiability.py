"""Check identifiability and choices of poses against closed forms, brute force and chance."""

from __future__ import annotations

import numpy as np
import pytest

from stiff_datasets.measured.identifiability import DEFLECTION_NOISE, identifiability, regressor
from stiff_datasets.planning.design import SpringDesign
from stiff_datasets.planning.plan_gain import plan_gain
from stiff_datasets.robots.shipped_robots import shipped_robot
from stiff_protocols.contract.errors import DataError

KR10_JOINTS = ("A1", "A2", "A3", "A4", "A5", "A6")


def random_samples(robot, n, rng, *, a5=None):
    """Draw poses inside the limits and forces of 80 N."""
    q = rng.uniform(robot.lower, robot.upper, size=(n, 6))
    if a5 is not None:
        q[:, 4] = a5
    force = rng.normal(size=(n, 3))
    force *= 80.0 / np.linalg.norm(force, axis=1, keepdims=True)
    return q, np.hstack([force, np.zeros((n, 3))])


@pytest.fixture()
def kr10_regressors(kr10, rng):
    return regressor(kr10, *random_samples(kr10, 60, rng))


# ---- identifiability -------------------------------------------------------------------------


def test_the_standard_error_is_the_scatter_of_least_squares(kr10_regressors, rng):
    compliance = 1.0 / np.array([5.1e4, 6.3e4, 5.0e4, 2.3e3, 8.9e3, 1.4e3])
    result = identifiability(kr10_regressors, KR10_JOINTS, reference_compliance=compliance)
    matrix = kr10_regressors.reshape(-1, 6)
    noise = rng.normal(scale=DEFLECTION_NOISE, size=(len(matrix), 4000))
    estimates = np.linalg.lstsq(matrix, (matrix @ compliance)[:, None] + noise, rcond=None)[0]
    scatter = estimates.std(axis=1) / compliance
    np.testing.assert_allclose(result.relative_standard_error, scatter, rtol=0.05)


def test_the_log_determinant_is_that_of_the_relative_compliances(kr10_regressors):
    result = identifiability(kr10_regressors, KR10_JOINTS, reference_compliance=3e-5)
    relative = kr10_regressors.reshape(-1, 6) * 3e-5 / DEFLECTION_NOISE
    assert result.log_det == pytest.approx(np.linalg.slogdet(relative.T @ relative)[1])
    size = np.linalg.norm(relative, axis=0)
    assert result.condition == pytest.approx(np.linalg.cond(relative / size))
    doubled_rows = np.concatenate([kr10_regressors] * 2)
    doubled_result = identifiability(doubled_rows, KR10_JOINTS, reference_compliance=3e-5)
    ratio = result.relative_standard_error / doubled_result.relative_standard_error
    np.testing.assert_allclose(ratio, np.sqrt(2.0))
    assert doubled_result.log_det - result.log_det == pytest.approx(6 * np.log(2.0))
    assert doubled_result.condition == pytest.approx(result.condition)


@pytest.mark.parametrize(
    ("off_axis", "a5", "unidentifiable_joints"),
    [
        *((off_axis, None, ("A6",)) for off_axis in (0.0, 1e-7, 5e-4)),
        (0.06, None, ()),
        (0.06, 0.0, ("A4", "A6")),  # they cannot be told apart while A5 is straight
    ],
)
def test_a_joint_without_lever_or_in_line_with_another_is_unidentifiable(
    off_axis, a5, unidentifiable_joints, rng
):
    robot = shipped_robot("kr10_r1100_2", tcp=(off_axis, 0.0, 0.08))
    result = identifiability(regressor(robot, *random_samples(robot, 151, rng, a5=a5)), KR10_JOINTS)
    assert result.unidentifiable == unidentifiable_joints
    assert np.isinf(result.condition) == np.isinf(result.log_det) == bool(unidentifiable_joints)
    infinite = np.isinf(result.relative_standard_error).tolist()
    assert infinite == [joint in unidentifiable_joints for joint in KR10_JOINTS]


# ---- choice ----------------------------------------------------------------------------------


def choose(candidates, n, criterion="d-optimal", **options):
    return SpringDesign(candidates, criterion, **options).choose(n)


def information(rows):
    return np.einsum("nki,nkj->ij", rows, rows)


def test_the_greedy_choice_is_that_of_brute_force_determinants(kr10_regressors):
    candidates = kr10_regressors[:25]
    size = np.sqrt((candidates**2).sum(axis=1).mean(axis=0))
    scaled_candidates, chosen_rows = candidates / size, []
    for _ in range(8):
        free_rows = [i for i in range(25) if i not in chosen_rows]
        dets = [
            np.linalg.det(1e-6 * np.eye(6) + information(scaled_candidates[[*chosen_rows, i]]))
            for i in free_rows
        ]
        chosen_rows.append(free_rows[int(np.argmax(dets))])
    assert choose(candidates, 8).tolist() == chosen_rows


def test_the_i_optimal_choice_is_that_of_brute_force_variances(kr10_regressors):
    candidates, workspace, measured = np.split(kr10_regressors, [25, 45])
    workspace_rows, expected_rows = workspace.reshape(-1, 6), []

    def spread(rows):
        matrix = information(measured) + information(candidates[rows])
        return np.trace(workspace_rows @ np.linalg.solve(matrix, workspace_rows.T))

    for _ in range(6):
        free_rows = [i for i in range(25) if i not in expected_rows]
        expected_rows.append(min(free_rows, key=lambda i: spread([*expected_rows, i])))
    chosen_rows = choose(candidates, 6, "i-optimal", workspace=workspace, measured=measured)
    assert chosen_rows.tolist() == expected_rows


# ---- gain ------------------------------------------------------------------------------------


def test_a_plan_measured_twice_over_is_twice_as_efficient(kr10_regressors):
    """Every random plan takes all 10 candidates, so the random plans are the plan itself."""
    ten = kr10_regressors[:10]
    for factor in (1.0, 2.0):
        gain = plan_gain(ten * np.sqrt(factor), ten, KR10_JOINTS)
        assert gain.efficiency == pytest.approx(factor)
        ratio = gain.random_best.worst_error / gain.plan.worst_error
        assert ratio == pytest.approx(np.sqrt(factor))


def test_a_gain_over_nothing_is_refused(kr10_regressors):
    with pytest.raises(DataError, match="60 samples from 10 candidates"):
        plan_gain(kr10_regressors, kr10_regressors[:10], KR10_JOINTS)
