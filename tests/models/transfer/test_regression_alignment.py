"""RSD and DARE-GRAM against numpy on tiny matrices."""

from __future__ import annotations

import numpy as np
import pytest
import torch
from domain_rows import waves

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


def test_rsd_is_finite_where_subspaces_meet():
    # 3 + 3 dimensions in 5 meet in one; TLLIB's function gives NaN for these rows
    source, target = waves(3, 5)
    source.requires_grad_()
    value = rsd(source, target)
    value.backward()
    assert torch.isfinite(value) and torch.isfinite(source.grad).all()


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
