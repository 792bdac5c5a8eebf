"""Gradient reversal, the domain discriminator and its loss."""

from __future__ import annotations

import math

import pytest
import torch

from stiff_models.transfer.alignment import build_discriminator, domain_loss, reverse_gradient

SOURCE = torch.tensor([[1.0, -2.0], [0.5, 3.0], [2.0, 1.0]])
TARGET = torch.tensor([[-1.0, 0.0]])


def logit():
    """A discriminator whose logit is x - 2 y + 0.25."""
    layer = torch.nn.Linear(2, 1)
    with torch.no_grad():
        layer.weight.copy_(torch.tensor([[1.0, -2.0]]))
        layer.bias.fill_(0.25)
    return layer


def by_hand(source, target):
    def probability(x, y):
        return 1 / (1 + math.exp(-(x - 2 * y + 0.25)))

    of_source = sum(-math.log(probability(*row)) for row in source.tolist()) / len(source)
    of_target = sum(-math.log(1 - probability(*row)) for row in target.tolist()) / len(target)
    return (of_source + of_target) / 2


def test_reversed_gradients_are_multiplied_by_minus_the_strength():
    values = SOURCE.clone().requires_grad_()
    passed = reverse_gradient(values, 0.3)
    assert torch.equal(passed, values)
    (passed * 5.0).sum().backward()
    assert torch.allclose(values.grad, torch.full_like(values, -1.5))


def test_the_loss_is_the_cross_entropy_with_half_of_the_weight_a_domain():
    value = domain_loss(logit(), SOURCE, TARGET, strength=1.0).item()
    assert value == pytest.approx(by_hand(SOURCE, TARGET), rel=1e-6)


@pytest.mark.parametrize("strength", [0.0, 0.5, 1.0])
def test_features_climb_where_the_discriminator_descends(strength):
    discriminator, source = logit(), SOURCE.clone().requires_grad_()
    domain_loss(discriminator, source, TARGET, strength=strength).backward()
    step = 1e-3

    def slope(move):
        upper, lower = SOURCE.double(), SOURCE.double()
        upper[move] += step
        lower[move] -= step
        return (by_hand(upper, TARGET) - by_hand(lower, TARGET)) / (2 * step)

    assert source.grad[1, 0].item() == pytest.approx(-strength * slope((1, 0)), abs=1e-6)
    # the discriminator itself learns at full weight: d loss / d bias does not know the strength
    probabilities = torch.sigmoid(discriminator(torch.cat([SOURCE, TARGET])))[:, 0]
    expected = ((probabilities[:3] - 1.0).mean() + probabilities[3]) / 2
    assert discriminator.bias.grad.item() == pytest.approx(expected.item(), rel=1e-5)


def test_extreme_logits_have_finite_gradients():
    source = (1e4 * SOURCE).requires_grad_()
    domain_loss(logit(), source, -1e4 * TARGET, strength=1.0).backward()
    assert torch.isfinite(source.grad).all()


def test_the_discriminator_is_256_1024_1024_1_and_drawn_from_its_seed():
    first, again, other = (build_discriminator(256, seed=seed) for seed in (1, 1, 2))
    layers = [m for m in first if isinstance(m, torch.nn.Linear)]
    assert [(m.in_features, m.out_features) for m in layers] == [
        (256, 1024),
        (1024, 1024),
        (1024, 1),
    ]
    assert torch.equal(first[0].weight, again[0].weight)
    assert not torch.equal(first[0].weight, other[0].weight)
