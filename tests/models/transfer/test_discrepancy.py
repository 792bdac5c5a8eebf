"""MK-MMD, JMMD and CORAL against sums written out in numpy."""

from __future__ import annotations

import itertools

import numpy as np
import pytest
import torch
from domain_rows import SOURCE, SOURCE_OUTPUTS, TARGET

from stiff_models.transfer.alignment import coral, jmmd, mk_mmd


def squares_by_hand(rows):
    return {
        (i, j): sum((a - b) ** 2 for a, b in zip(rows[i], rows[j], strict=True))
        for i, j in itertools.product(range(len(rows)), repeat=2)
    }


def mean_square(rows):
    return sum(squares_by_hand(rows).values()) / (len(rows) * (len(rows) - 1))


def kernels_by_hand(rows, factors, bandwidth=None):
    """Kernel values of all ordered pairs of rows, as a dict, pair by pair."""
    bandwidth = mean_square(rows) if bandwidth is None else bandwidth
    return {
        pair: sum(np.exp(-square / (bandwidth * factor)) for factor in factors)
        for pair, square in squares_by_hand(rows).items()
    }


def discrepancy_by_hand(kernels, n, m):
    source, target = range(n), range(n, n + m)
    within = sum(kernels[i, j] for i in source for j in source) / n**2
    other = sum(kernels[i, j] for i in target for j in target) / m**2
    return within + other - 2 * sum(kernels[i, j] for i in source for j in target) / (n * m)


@pytest.mark.parametrize("n_target", [1, 2, 3])
def test_mk_mmd_is_the_sum_over_all_pairs(n_target):
    source, target = SOURCE, TARGET[:n_target]
    rows = torch.cat([source, target]).tolist()
    kernels = kernels_by_hand(rows, [1 / 4, 1 / 2, 1, 2, 4])
    assert mk_mmd(source, target).item() == pytest.approx(
        discrepancy_by_hand(kernels, 3, n_target), rel=1e-12
    )


def test_jmmd_sees_that_features_and_outputs_belong_together():
    # the same features and the same outputs, in another pairing: only a joint distance sees it
    pairs = (SOURCE, SOURCE_OUTPUTS), (SOURCE, SOURCE_OUTPUTS[[1, 2, 0]])
    assert jmmd(*pairs).item() > 0.1


@pytest.mark.parametrize("distance", [mk_mmd, coral])
def test_shifted_features_differ_in_mean_for_mmd_and_in_nothing_for_coral(distance):
    shift = distance(SOURCE, SOURCE + 3.0).item()
    assert shift == pytest.approx(0.0, abs=1e-12) if distance is coral else shift > 1.0


def test_the_gradient_of_coral_is_that_of_finite_differences():
    assert torch.autograd.gradcheck(coral, (SOURCE.clone().requires_grad_(), TARGET))


def test_the_gradient_of_mk_mmd_holds_the_bandwidth_fixed():
    source = SOURCE.clone().requires_grad_()
    mk_mmd(source, TARGET).backward()
    rows = torch.cat([SOURCE, TARGET]).tolist()
    bandwidth = mean_square(rows)

    def value(step):
        moved = [list(row) for row in rows]
        moved[1][2] += step
        return discrepancy_by_hand(kernels_by_hand(moved, [1 / 4, 1 / 2, 1, 2, 4], bandwidth), 3, 3)

    slope = (value(1e-6) - value(-1e-6)) / 2e-6
    assert source.grad[1, 2].item() == pytest.approx(slope, rel=1e-6)
