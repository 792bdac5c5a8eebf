"""How well samples identify joints: against the VJM, closed forms, chance."""

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
    """Poses inside the limits and forces of 80 N."""
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
    found = identifiability(kr10_regressors, KR10_JOINTS, reference_compliance=compliance)
    matrix = kr10_regressors.reshape(-1, 6)
    noise = rng.normal(scale=DEFLECTION_NOISE, size=(len(matrix), 4000))
    identified = np.linalg.lstsq(matrix, (matrix @ compliance)[:, None] + noise, rcond=None)[0]
    scatter = identified.std(axis=1) / compliance
    np.testing.assert_allclose(found.relative_standard_error, scatter, rtol=0.05)


def test_the_log_determinant_is_that_of_the_relative_compliances(kr10_regressors):
    once = identifiability(kr10_regressors, KR10_JOINTS, reference_compliance=3e-5)
    relative = kr10_regressors.reshape(-1, 6) * 3e-5 / DEFLECTION_NOISE
    assert once.log_det == pytest.approx(np.linalg.slogdet(relative.T @ relative)[1])
    size = np.linalg.norm(relative, axis=0)
    assert once.condition == pytest.approx(np.linalg.cond(relative / size))
    doubled = np.concatenate([kr10_regressors] * 2)
    twice = identifiability(doubled, KR10_JOINTS, reference_compliance=3e-5)
    ratio = once.relative_standard_error / twice.relative_standard_error
    np.testing.assert_allclose(ratio, np.sqrt(2.0))
    assert twice.log_det - once.log_det == pytest.approx(6 * np.log(2.0))
    assert twice.condition == pytest.approx(once.condition)


@pytest.mark.parametrize(
    ("off_axis", "a5", "unknown"),
    [
        *((off_axis, None, ("A6",)) for off_axis in (0.0, 1e-7, 5e-4)),
        (0.06, None, ()),
        (0.06, 0.0, ("A4", "A6")),  # they cannot be told apart while A5 is straight
    ],
)
def test_a_joint_without_lever_or_in_line_with_another_is_unidentifiable(
    off_axis, a5, unknown, rng
):
    robot = shipped_robot("kr10_r1100_2", tcp=(off_axis, 0.0, 0.08))
    found = identifiability(regressor(robot, *random_samples(robot, 151, rng, a5=a5)), KR10_JOINTS)
    assert found.unidentifiable == unknown
    assert np.isinf(found.condition) == np.isinf(found.log_det) == bool(unknown)
    infinite = np.isinf(found.relative_standard_error).tolist()
    assert infinite == [joint in unknown for joint in KR10_JOINTS]


# ---- choice ----------------------------------------------------------------------------------


def choose(candidates, n, criterion="d-optimal", **options):
    return SpringDesign(candidates, criterion, **options).choose(n)


def information(rows):
    return np.einsum("nki,nkj->ij", rows, rows)


def test_the_greedy_choice_is_that_of_brute_force_determinants(kr10_regressors):
    candidates = kr10_regressors[:25]
    size = np.sqrt((candidates**2).sum(axis=1).mean(axis=0))
    scaled, chosen = candidates / size, []
    for _ in range(8):
        left = [i for i in range(25) if i not in chosen]
        dets = [np.linalg.det(1e-6 * np.eye(6) + information(scaled[[*chosen, i]])) for i in left]
        chosen.append(left[int(np.argmax(dets))])
    assert choose(candidates, 8).tolist() == chosen


def test_the_i_optimal_choice_is_that_of_brute_force_variances(kr10_regressors):
    candidates, workspace, measured = np.split(kr10_regressors, [25, 45])
    wanted, known, chosen = workspace.reshape(-1, 6), information(measured), []

    def spread(rows):
        found = np.linalg.solve(known + information(candidates[rows]), wanted.T)
        return np.trace(wanted @ found)

    for _ in range(6):
        left = [i for i in range(25) if i not in chosen]
        chosen.append(min(left, key=lambda i: spread([*chosen, i])))
    found = choose(candidates, 6, "i-optimal", workspace=workspace, measured=measured)
    assert found.tolist() == chosen


# ---- gain ------------------------------------------------------------------------------------


def test_a_plan_measured_twice_over_is_twice_as_efficient(kr10_regressors):
    """Every random plan takes all 10 candidates, so the random plans are the plan itself."""
    ten = kr10_regressors[:10]
    for factor in (1.0, 2.0):
        found = plan_gain(ten * np.sqrt(factor), ten, KR10_JOINTS)
        assert found.efficiency == pytest.approx(factor)
        ratio = found.random_best.worst_error / found.plan.worst_error
        assert ratio == pytest.approx(np.sqrt(factor))


def test_a_gain_over_nothing_is_refused(kr10_regressors):
    with pytest.raises(DataError, match="60 samples from 10 candidates"):
        plan_gain(kr10_regressors, kr10_regressors[:10], KR10_JOINTS)
