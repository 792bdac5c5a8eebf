"""RSD and DARE-GRAM against numpy on tiny matrices."""

from __future__ import annotations

import numpy as np
import pytest
import torch
from domain_rows import waves
from scipy.linalg import subspace_angles

from stiff_models.transfer.alignment import dare_gram, rsd, smooth_svd


def in_plane(angle):
    """Two rows that span the first axis and one at `angle` between the second and the third."""
    return torch.tensor(
        [[3.0, 0.0, 0.0, 0.0], [0.0, np.cos(angle), np.sin(angle), 0.0]], dtype=torch.float64
    )


@pytest.mark.parametrize("angle", [0.1, 0.7, 1.5])
def test_rsd_of_two_planes_is_the_sine_of_the_angle_between_them(angle):
    # one direction in common; the bases match up to signs, so no penalty: 0 + sin(angle)
    assert rsd(in_plane(0.0), in_plane(angle)).item() == pytest.approx(np.sin(angle), abs=1e-6)


def test_rsd_is_the_sum_of_sines_of_scipys_angles_and_the_mismatch_of_numpys_bases():
    source, target = waves(3, 8)
    angles = subspace_angles(source.numpy().T, target.numpy().T)
    bases = [np.linalg.svd(rows.numpy().T, full_matrices=False)[0] for rows in (source, target)]
    left, _, right = np.linalg.svd(bases[0].T @ bases[1])
    mismatch = np.sqrt(((np.abs(left) - np.abs(right.T)) ** 2).sum())
    assert mismatch > 1.0  # the penalty counts here
    assert rsd(source, target).item() == pytest.approx(np.sin(angles).sum() + 0.1 * mismatch)


def test_rsd_is_finite_where_subspaces_meet():
    # 3 + 3 dimensions in 5 meet in one; TLLIB's function gives NaN for these rows
    source, target = waves(3, 5)
    source.requires_grad_()
    value = rsd(source, target)
    value.backward()
    assert torch.isfinite(value) and torch.isfinite(source.grad).all()


def test_rsd_ignores_the_scale_of_the_features():
    source, target = waves(3, 8)
    assert rsd(source, target).item() == pytest.approx(rsd(source, 50.0 * target).item())
    assert rsd(source, 50.0 * source).item() == pytest.approx(0.0, abs=1e-5)


def dare_gram_by_numpy(source, target, kept):
    spectra, inverses = [], []
    for rows in (source.numpy(), target.numpy()):
        z = np.hstack([np.ones((len(rows), 1)), rows])
        values, vectors = np.linalg.eigh(z.T @ z)
        values, vectors = values[::-1], vectors[:, ::-1]
        spectra.append(values[:kept])
        inverses.append(
            sum(np.outer(vectors[:, i], vectors[:, i]) / values[i] for i in range(kept))
        )
    cosines = [
        a @ b / (np.linalg.norm(a) * np.linalg.norm(b))
        for a, b in zip(inverses[0].T, inverses[1].T, strict=True)
    ]
    scale = np.linalg.norm(spectra[0] - spectra[1]) / kept
    return 0.05 * np.mean([abs(1 - cosine) for cosine in cosines]) + 0.001 * scale


def test_dare_gram_is_numpys_with_as_many_eigenvalues_as_it_keeps():
    source, target = waves(7, 8)
    value = dare_gram(source, target).item()
    assert value == pytest.approx(dare_gram_by_numpy(source, target, kept=3), rel=1e-9)
    for wrong in (2, 4):
        assert value != pytest.approx(dare_gram_by_numpy(source, target, kept=wrong), rel=1e-2)


def test_dare_gram_of_constant_features_is_its_closed_form():
    source = torch.full((4, 1), 10.0, dtype=torch.float64)
    target = torch.full((4, 1), 20.0, dtype=torch.float64)
    # Z = [1, a] in every row: one eigenvalue 4 (1 + a^2), eigenvector (1, a) / sqrt(1 + a^2)
    cosine = (1 + 200) / np.sqrt(101 * 401)
    expected = 0.05 * (1 - cosine) + 0.001 * (4 * 401 - 4 * 101)
    assert dare_gram(source, target).item() == pytest.approx(expected, rel=1e-9)


@pytest.mark.parametrize("distance", [rsd, dare_gram])
def test_gradients_are_those_of_finite_differences(distance):
    source, target = (rows.requires_grad_() for rows in waves(4, 9))
    assert torch.autograd.gradcheck(distance, (source, target))


@pytest.mark.parametrize("distance", [rsd, dare_gram])
@pytest.mark.parametrize("case", ["zeros", "ones", "repeated rows", "identical domains", "few"])
def test_gradients_are_finite_where_singular_values_meet(distance, case):
    generator = torch.Generator().manual_seed(0)
    source, target = (torch.relu(torch.randn(6, 16, generator=generator)) for _ in range(2))
    if case in ("zeros", "ones"):
        source = torch.full((6, 16), float(case == "ones"))
    elif case == "repeated rows":
        target = target[[0, 0, 1, 1, 2, 2]]
    elif case == "identical domains":
        target = source.clone()
    else:
        source, target = source[:2], target[:2]
    source, target = source.requires_grad_(), target.requires_grad_()
    distance(source, target).backward()
    for rows in (source, target):
        assert rows.grad.dtype == torch.float32
        assert torch.isfinite(rows.grad).all() and rows.grad.abs().max() < 1e3


@pytest.mark.parametrize("shape", [(7, 4), (4, 7), (4, 4)])
def test_the_smooth_decomposition_is_torchs_where_singular_values_are_apart(shape):
    matrix = torch.randn(shape, dtype=torch.float64, generator=torch.Generator().manual_seed(0))
    weights = torch.arange(1.0, 5.0, dtype=torch.float64)

    def reading(parts):
        left, singular, right = parts  # absolute values: the signs of singular vectors are free
        return (left.abs() @ weights).sum() + singular @ weights + (right.abs() @ weights).sum()

    def ours(values):
        return reading(smooth_svd(values))

    def torchs(values):
        left, singular, right = torch.linalg.svd(values, full_matrices=False)
        return reading((left, singular, right.mT))

    gradients = []
    for function in (ours, torchs):
        moving = matrix.clone().requires_grad_()
        function(moving).backward()
        gradients.append(moving.grad)
    assert torch.allclose(*gradients, rtol=1e-8)
