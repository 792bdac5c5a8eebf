"""The passes without autograd give autograd's numbers."""

from __future__ import annotations

import pytest
import torch

from stiff_models.networks.network import build_network, linear_layers
from stiff_models.networks.plain_sequence import PlainSequence

N_LEARNED = 20


def network(activation="relu"):
    return build_network(5, layers=3, width=32, activation=activation, seed=0)


def inputs():
    return torch.randn(30, 5, generator=torch.Generator().manual_seed(1))


def loss(outputs):
    return outputs[:N_LEARNED].square().mean()


def by_autograd(net):
    outputs = net(inputs())
    loss(outputs).backward()
    return outputs.detach(), {name: p.grad for name, p in net.named_parameters()}


def by_hand(net, moving, *, bfloat16=False):
    passes = PlainSequence.of(net, moving)
    outputs = passes.outputs(inputs(), bfloat16=bfloat16)
    learned = outputs[:N_LEARNED].requires_grad_()
    loss(learned).backward()
    passes.backward(learned.grad)
    return outputs, {name: p.grad for name, p in net.named_parameters()}


@pytest.mark.parametrize("activation", ["relu", "tanh", "sigmoid", "gelu"])
def test_outputs_and_gradients_are_autograds(activation):
    outputs, gradients = by_autograd(network(activation))
    net = network(activation)
    same, ours = by_hand(net, set(net.parameters()))
    torch.testing.assert_close(same, outputs)
    torch.testing.assert_close(ours, gradients)


def test_only_what_moves_gets_a_gradient():
    net = network()
    moving = {linear_layers(net)[1].weight, linear_layers(net)[2].bias}
    _, expected = by_autograd(network())
    _, ours = by_hand(net, moving)
    assert {name for name, gradient in ours.items() if gradient is not None} == {
        "2.weight",
        "4.bias",
    }
    torch.testing.assert_close(ours["2.weight"], expected["2.weight"])
    torch.testing.assert_close(ours["4.bias"], expected["4.bias"])


def test_in_bfloat16_they_agree_to_its_8_bits():
    outputs, gradients = by_autograd(network())
    net = network()
    same, ours = by_hand(net, set(net.parameters()), bfloat16=True)
    assert same.dtype == torch.float32
    assert (same - outputs).norm() < 2**-6 * outputs.norm()
    for name, gradient in ours.items():
        assert (gradient - gradients[name]).norm() < 2**-5 * gradients[name].norm()


def test_in_bfloat16_a_pass_sees_the_weights_that_moved_since_the_last():
    net = network()
    moving = {linear_layers(net)[0].weight}
    passes = PlainSequence.of(net, moving)
    before = passes.outputs(inputs(), bfloat16=True)
    with torch.no_grad():
        linear_layers(net)[0].weight.add_(1.0)
    assert not torch.equal(passes.outputs(inputs(), bfloat16=True), before)


class Residual(torch.nn.Sequential):
    def forward(self, x):
        return x + super().forward(x)


@pytest.mark.parametrize(
    "net",
    [
        Residual(torch.nn.Linear(5, 5)),
        torch.nn.Sequential(torch.nn.Linear(5, 5), torch.nn.SiLU(), torch.nn.Linear(5, 3)),
        torch.nn.Sequential(torch.nn.Linear(5, 5), torch.nn.GELU("tanh"), torch.nn.Linear(5, 3)),
        torch.nn.Sequential(torch.nn.Linear(5, 3, bias=False)),
        torch.nn.Linear(5, 3),
    ],
    ids=["subclass", "silu", "tanh-gelu", "no-bias", "no-sequence"],
)
def test_other_networks_are_left_to_autograd(net):
    assert PlainSequence.of(net, set(net.parameters())) is None
