"""Freeze strategies: what each word lets move."""

from __future__ import annotations

import pytest

from stiff_models.transfer.freeze import named_layers, stages
from stiff_protocols.contract.errors import ConfigError


def plan(freeze, epochs=100):
    return stages(freeze, hidden_layers=4, epochs=epochs, unfreeze_every=20, l2sp_alpha=0.5)


def test_l2sp_pulls_every_layer_and_bias_moves_no_weight():
    (pulled,), (biases,), (full,) = plan("l2sp"), plan("bias"), plan("full")
    assert pulled.pull == 0.5 and full.pull == biases.pull == 0.0
    assert biases.biases_only and pulled.rates == biases.rates == full.rates
    assert pulled.epochs == biases.epochs == full.epochs == 100


def test_gradual_frees_one_more_layer_from_the_top_every_few_epochs():
    result = plan("gradual")
    assert [min(stage.rates) for stage in result] == [4, 3, 2, 1, 0]
    assert [stage.epochs for stage in result] == [20] * 5
    assert sum(stage.epochs for stage in plan("gradual", epochs=30)) == 30


def test_discriminative_rates_fall_by_2_6_a_layer_downwards():
    (stage,) = plan("discriminative")
    assert stage.rates[4] == 1.0
    assert all(stage.rates[i + 1] / stage.rates[i] == pytest.approx(2.6) for i in range(4))


def test_lp_ft_trains_the_head_first_and_then_everything():
    head, everything = plan("lp-ft", epochs=101)
    assert (sorted(head.rates), sorted(everything.rates)) == ([4], [0, 1, 2, 3, 4])
    assert head.epochs + everything.epochs == 101


@pytest.mark.parametrize(
    "freeze",
    ["layers:5", "layers:0", "layers:", "layers:1,x", "first:6", "last:0", "fulll", "full:1", ""],
)
def test_an_impossible_strategy_is_refused_with_what_is_valid(freeze):
    with pytest.raises(ConfigError, match=r"valid"):
        plan(freeze)


def test_the_layers_that_a_strategy_names_are_those_written_and_none_of_another_strategy():
    assert named_layers("layers:1,out") == ("1", "out")
    assert named_layers("first:2") == named_layers("full") == named_layers("") == ()
