"""The full VJM: springs in all axes, found where they can be and counted where not."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from made_samples import samples_with
from stiff_models.physics.full_vjm import FullVjm, spring_names, spring_regressor
from stiff_models.physics.identification import ridge
from stiff_models.physics.vjm import compliance_regressor, joint_deflection

STIFFNESS = np.array([50.9e3, 63.4e3, 50.3e3, 2.27e3, 8.89e3, 1.39e3])


def loads(rng, n=120):
    q = rng.uniform(-1.5, 1.5, size=(n, 6))
    return q, rng.normal(size=(n, 6)) * np.repeat([60.0, 5.0], 3)


def own_springs(robot, springs):
    names = [f"{name} rz" for name in robot.joint_names]
    return [spring_names(robot, springs).index(name) for name in names]


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


def test_samples_of_the_linear_vjm_give_no_other_springs_than_the_joints(kr10, rng):
    q, wrench = loads(rng)
    samples = samples_with(q, wrench, joint_deflection(kr10, 1 / STIFFNESS, q, wrench))
    model = FullVjm().fit(samples, robot=kr10)
    predicted = model.predict(q, wrench)
    np.testing.assert_allclose(predicted, samples.deflection, atol=1e-12)
    known = [name for name in spring_names(kr10, 3) if name not in model.unidentifiable_]
    own = dict(zip((f"{name} rz" for name in kr10.joint_names), 1 / STIFFNESS, strict=True))
    for name in known:
        found = model.compliance_[model.springs_.index(name)]
        assert found == pytest.approx(own.get(name, 0.0), abs=1e-11)
    assert len(known) >= 12


def test_a_joint_that_tilts_is_told_from_one_that_turns(kr10, rng):
    q, wrench = loads(rng)
    springs = spring_names(kr10, 3)
    compliance = np.zeros(18)
    compliance[springs.index("A1 rx")], compliance[springs.index("A2 rz")] = 2e-5, 3e-5
    deflection = spring_regressor(kr10, q, wrench, 3) @ compliance
    model = FullVjm().fit(samples_with(q, wrench, deflection), robot=kr10)
    np.testing.assert_allclose(model.compliance_, compliance, atol=1e-12)


def test_not_all_springs_can_be_identified_and_those_are_named(kr10, rng):
    q, wrench = loads(rng)
    regressor = spring_regressor(kr10, q, wrench, 3).reshape(-1, 18)
    samples = samples_with(q, wrench, joint_deflection(kr10, 1 / STIFFNESS, q, wrench))
    model = FullVjm().fit(samples, robot=kr10)
    assert model.diagnostics_["springs"] == 18.0
    rank = np.linalg.matrix_rank(regressor / np.linalg.norm(regressor, axis=0), tol=1e-8)
    assert model.diagnostics_["rank"] == rank < 18
    assert model.diagnostics_["springs not identifiable"] == len(model.unidentifiable_) > 0
    for name in model.unidentifiable_:  # it is a sum of others: leaving it out loses no rank
        others = np.delete(regressor, model.springs_.index(name), axis=1)
        assert np.linalg.matrix_rank(others / np.linalg.norm(others, axis=0), tol=1e-8) == rank


def test_ridge_minimises_generalised_cross_validation_against_brute_force(rng):
    matrix = rng.normal(size=(40, 8)) @ np.diag(np.geomspace(1.0, 1e-2, 8))
    target = matrix @ rng.normal(size=8) + rng.normal(size=40) * 0.3

    def gcv(strength):
        hat = matrix @ np.linalg.solve(matrix.T @ matrix + strength * np.eye(8), matrix.T)
        residual = target - hat @ target
        return (residual @ residual) / np.trace(np.eye(40) - hat) ** 2

    best = min(np.geomspace(1e-8, 1e1, 2000), key=gcv)
    truth = np.linalg.solve(matrix.T @ matrix + best * np.eye(8), matrix.T @ target)
    np.testing.assert_allclose(ridge(matrix, target), truth, rtol=0.02, atol=1e-3)


def test_ridge_does_not_shrink_what_is_exact(rng):
    matrix, truth = rng.normal(size=(20, 4)), np.array([1.0, -2.0, 0.5, 3.0])
    np.testing.assert_allclose(ridge(matrix, matrix @ truth), truth, rtol=1e-5)


def test_ridge_leaves_directions_alone_that_the_samples_do_not_resolve(rng):
    matrix = rng.normal(size=(30, 4))
    doubled = np.column_stack([matrix, matrix[:, 0]])  # two springs that do the same
    solution = ridge(doubled, matrix @ np.ones(4) + rng.normal(size=30) * 0.1)
    assert solution[0] == pytest.approx(solution[4])


def test_three_springs_of_a_sliding_joint_are_along_its_axes(kr10, rng):
    sliding = replace(kr10, joint_types=("prismatic", *kr10.joint_types[1:]))
    assert spring_names(sliding, 3)[:6] == ("A1 x", "A1 y", "A1 z", "A2 rx", "A2 ry", "A2 rz")
    q, wrench = loads(rng, n=4)
    np.testing.assert_allclose(
        spring_regressor(sliding, q, wrench, 3)[..., 2],
        compliance_regressor(sliding, q, wrench)[..., 0],
        atol=1e-12,
    )
