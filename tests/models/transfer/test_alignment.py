"""The objective of `dt-cnn`: when alignment starts, how strong it is, and what it is made of."""

from __future__ import annotations

import math

import pytest
import torch

from stiff_models.transfer.alignment import (
    AlignedObjective,
    coral,
    dare_gram,
    domain_loss,
    jmmd,
    mk_mmd,
    ramp,
    rsd,
    uses_target,
)
from stiff_models.transfer.cnn import build_cnn

DISTANCES = ["mk-mmd", "jmmd", "coral", "dann", "rsd", "dare-gram"]


def normal(n, columns, seed):
    return torch.randn(n, columns, generator=torch.Generator().manual_seed(seed))


INPUTS, TARGETS = normal(50, 7, 0), normal(50, 3, 1)
OF_TARGET = 1.0 + normal(40, 7, 2)


def objective(alignment, weight=1.0, loss="huber", target=OF_TARGET):
    network = build_cnn(7, pool="none", dropout=0.0, per_sample=False, seed=0)
    return AlignedObjective(network, target, alignment=alignment, weight=weight, loss=loss, seed=3)


def together(made, source=INPUTS, target=OF_TARGET):
    """Bottleneck features and outputs of both domains, in one pass as in training."""
    features = made.network.bottleneck(torch.cat([source, target]))
    outputs = made.network.head(features)
    n = len(source)
    return features[:n], features[n:], outputs[:n], outputs[n:]


def test_the_ramp_starts_after_a_sixth_and_ends_at_one():
    assert [ramp(progress) for progress in (0.0, 0.1, 1 / 6)] == [0.0, 0.0, 0.0]
    # UDTL: epoch e of 300, middle epoch 50: 2 / (1 + exp(-10 (e - 50) / 250)) - 1
    for epoch in (50, 51, 100, 175, 299):
        expected = 2 / (1 + math.exp(-10 * (epoch - 50) / 250)) - 1
        assert ramp(epoch / 300) == pytest.approx(expected, abs=1e-12)
    assert ramp(1.0) == pytest.approx(1.0, abs=1e-4)


@pytest.mark.parametrize("alignment", DISTANCES)
def test_the_first_sixth_sees_the_source_alone(alignment):
    made = objective(alignment)
    elsewhere = objective(alignment, target=OF_TARGET + 100.0)
    value = made(0.16, INPUTS, TARGETS)
    assert torch.equal(value, elsewhere(0.16, INPUTS, TARGETS))
    error = (made.network(INPUTS) - TARGETS).abs()
    # Huber with a width of 0.02, divided by it: |e| - 0.01 beyond the width
    expected = torch.where(error > 0.02, error - 0.01, error**2 / 0.04).mean()
    assert value.item() == pytest.approx(expected.item(), rel=1e-5)


@pytest.mark.parametrize(
    ("alignment", "distance"),
    [
        ("mk-mmd", lambda s, t, *_: mk_mmd(s, t)),
        ("jmmd", lambda s, t, a, b: jmmd((s, a), (t, b))),
        ("coral", lambda s, t, *_: coral(s, t)),
        ("rsd", lambda s, t, *_: 1e-3 * rsd(s, t)),
        ("dare-gram", lambda s, t, *_: dare_gram(s, t)),
    ],
)
def test_then_the_distance_comes_in_with_its_weight(alignment, distance):
    # 30 target rows: all of them are in every batch, and fewer than the 36 of the papers
    target = OF_TARGET[:30]
    made = objective(alignment, weight=0.7, loss="mse", target=target)
    order = torch.randperm(30, generator=torch.Generator().manual_seed(3))
    value = made(0.5, INPUTS, TARGETS)
    source_features, target_features, outputs, others = together(made, target=target[order])
    if alignment in ("rsd", "dare-gram"):
        source_features = source_features[:30]
    expected = (outputs - TARGETS).square().mean() + 0.7 * ramp(0.5) * distance(
        source_features, target_features, outputs, others
    )
    assert value.item() == pytest.approx(expected.item(), rel=1e-4)


def test_dann_carries_the_ramp_in_the_reversed_gradient_alone():
    made = objective("dann", loss="mse")
    made.discriminator.eval()
    value = made(0.5, INPUTS, TARGETS)
    source, target, outputs, _ = together(made)
    expected = (outputs - TARGETS).square().mean()
    expected = expected + domain_loss(made.discriminator, source, target, strength=ramp(0.5))
    assert value.item() == pytest.approx(expected.item(), rel=1e-4)
    value.backward()
    of_discriminator = [p.grad.norm().item() for p in made.discriminator.parameters()]
    of_network = made.network.body[1].weight.grad.clone()
    expected.backward()  # the same gradients once more
    assert torch.allclose(made.network.body[1].weight.grad, 2 * of_network, rtol=1e-3, atol=1e-6)
    assert all(
        p.grad.norm().item() == pytest.approx(2 * norm, rel=1e-3)
        for p, norm in zip(made.discriminator.parameters(), of_discriminator, strict=True)
    )


def test_only_dann_trains_something_beside_the_network():
    assert [len(objective(alignment).parameters()) for alignment in DISTANCES] == [0, 0, 0, 6, 0, 0]
    assert [uses_target(name) for name in ("none", "adabn", *DISTANCES)] == [False] * 2 + [True] * 6


def test_target_batches_are_as_long_as_the_sources_and_reach_every_row():
    made = objective("coral")
    batches = [made._target_batch(16) for _ in range(20)]
    assert {len(batch) for batch in batches} == {16}
    seen = {tuple(row.tolist()) for batch in batches for row in batch}
    assert seen == {tuple(row.tolist()) for row in OF_TARGET}
    assert len({tuple(row.tolist()) for row in batches[0]}) == 16  # no row twice in a batch
