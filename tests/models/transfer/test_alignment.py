"""Check distances of domains and their objective against explicit sums and published code."""

from __future__ import annotations

import math

import pytest
import torch

from helpers.domain_rows import (
    INPUTS,
    OF_TARGET,
    SOURCE,
    TARGET,
    TARGETS,
)
from stiff_models.transfer.alignment import (
    AlignedObjective,
    coral,
    domain_loss,
    mk_mmd,
    ramp,
)
from stiff_models.transfer.cnn import build_cnn


def objective(alignment, weight=1.0, loss="huber", target=OF_TARGET):
    network = build_cnn(7, pool="none", dropout=0.0, per_sample=False, seed=0)
    return AlignedObjective(network, target, alignment=alignment, weight=weight, loss=loss, seed=3)


def joint_pass(aligned, source=INPUTS, target=OF_TARGET):
    """Return bottleneck features and outputs of both domains, in one pass as in training."""
    features = aligned.network.bottleneck(torch.cat([source, target]))
    outputs = aligned.network.head(features)
    n = len(source)
    return features[:n], features[n:], outputs[:n], outputs[n:]


def test_the_ramp_starts_after_a_sixth_and_ends_at_one():
    assert [ramp(progress) for progress in (0.0, 0.1, 1 / 6)] == [0.0, 0.0, 0.0]
    # UDTL: epoch e of 300, middle epoch 50: 2 / (1 + exp(-10 (e - 50) / 250)) - 1
    for epoch in (50, 51, 100, 175, 299):
        expected = 2 / (1 + math.exp(-10 * (epoch - 50) / 250)) - 1
        assert ramp(epoch / 300) == pytest.approx(expected, abs=1e-12)
    assert ramp(1.0) == pytest.approx(1.0, abs=1e-4)


@pytest.mark.parametrize(("alignment", "distance"), [("mk-mmd", mk_mmd), ("coral", coral)])
def test_then_the_distance_comes_in_with_its_weight(alignment, distance):
    # 30 target rows: all of them are in every batch
    target = OF_TARGET[:30]
    aligned = objective(alignment, weight=0.7, loss="mse", target=target)
    order = torch.randperm(30, generator=torch.Generator().manual_seed(3))
    value = aligned(0.5, INPUTS, TARGETS)
    source_features, target_features, outputs, _ = joint_pass(aligned, target=target[order])
    expected = (outputs - TARGETS).square().mean() + 0.7 * ramp(0.5) * distance(
        source_features, target_features
    )
    assert value.item() == pytest.approx(expected.item(), rel=1e-4)


def test_dann_carries_the_ramp_only_in_the_reversed_gradient():
    aligned = objective("dann", loss="mse")
    aligned.discriminator.eval()
    value = aligned(0.5, INPUTS, TARGETS)
    source, target, outputs, _ = joint_pass(aligned)
    expected = (outputs - TARGETS).square().mean()
    expected = expected + domain_loss(aligned.discriminator, source, target, strength=ramp(0.5))
    assert value.item() == pytest.approx(expected.item(), rel=1e-4)
    value.backward()
    discriminator_norms = [p.grad.norm().item() for p in aligned.discriminator.parameters()]
    network_gradient = aligned.network.body[1].weight.grad.clone()
    expected.backward()  # the same gradients once more
    assert torch.allclose(
        aligned.network.body[1].weight.grad, 2 * network_gradient, rtol=1e-3, atol=1e-6
    )
    assert all(
        p.grad.norm().item() == pytest.approx(2 * norm, rel=1e-3)
        for p, norm in zip(aligned.discriminator.parameters(), discriminator_norms, strict=True)
    )


@pytest.mark.parametrize(
    ("value", "published"),
    [
        # skada 0.6.0, skada.deep.losses._maximum_mean_discrepancy with five Gaussians; UDTL,
        # loss/DAN.py (commit 9a349e9)
        (mk_mmd(SOURCE, TARGET), 3.1061729937692517),
        # skada 0.6.0, skada.deep.losses.deepcoral_loss
        (coral(SOURCE, TARGET), 0.06320981503793319),
    ],
)
def test_values_are_those_of_public_implementations(value, published):
    assert value.item() == pytest.approx(published, rel=1e-9)


THREE = torch.tensor([[1.0, -2.0], [0.5, 3.0], [2.0, 1.0]])
ONE_SAMPLE = torch.tensor([[-1.0, 0.0]])


def logit():
    """Return a discriminator whose logit is x - 2 y + 0.25."""
    layer = torch.nn.Linear(2, 1)
    with torch.no_grad():
        layer.weight.copy_(torch.tensor([[1.0, -2.0]]))
        layer.bias.fill_(0.25)
    return layer


def expected_loss(source, target):
    def probability(x, y):
        return 1 / (1 + math.exp(-(x - 2 * y + 0.25)))

    of_source = sum(-math.log(probability(*row)) for row in source.tolist()) / len(source)
    of_target = sum(-math.log(1 - probability(*row)) for row in target.tolist()) / len(target)
    return (of_source + of_target) / 2


@pytest.mark.parametrize("strength", [0.0, 0.5, 1.0])
def test_the_loss_is_the_cross_entropy_and_features_climb_where_the_discriminator_descends(
    strength,
):
    discriminator, source = logit(), THREE.clone().requires_grad_()
    loss = domain_loss(discriminator, source, ONE_SAMPLE, strength=strength)
    assert loss.item() == pytest.approx(expected_loss(THREE, ONE_SAMPLE), rel=1e-6)
    loss.backward()
    step = 1e-3

    def slope(move):
        upper, lower = THREE.double(), THREE.double()
        upper[move] += step
        lower[move] -= step
        return (expected_loss(upper, ONE_SAMPLE) - expected_loss(lower, ONE_SAMPLE)) / (2 * step)

    assert source.grad[1, 0].item() == pytest.approx(-strength * slope((1, 0)), abs=1e-6)
    # the discriminator itself learns at full weight: d loss / d bias does not know the strength
    probabilities = torch.sigmoid(discriminator(torch.cat([THREE, ONE_SAMPLE])))[:, 0]
    expected = ((probabilities[:3] - 1.0).mean() + probabilities[3]) / 2
    assert discriminator.bias.grad.item() == pytest.approx(expected.item(), rel=1e-5)
