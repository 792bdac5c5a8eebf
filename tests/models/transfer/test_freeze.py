"""Freeze strategies: what each word lets move."""

from __future__ import annotations

import pytest

from stiff_models.transfer.freeze import stages
from stiff_protocols.contract.errors import ConfigError


def plan(freeze, epochs=100):
    return stages(freeze, hidden_layers=4, epochs=epochs, unfreeze_every=20, l2sp_alpha=0.5)


@pytest.mark.parametrize(
    ("freeze", "layers"),
    [
        ("layers:1,2", [0, 1]),
        ("layers:3", [2]),
        ("layers:4,out", [3, 4]),
        ("full", [0, 1, 2, 3, 4]),
        ("head", [4]),
        ("first:2", [0, 1]),
        ("last:2", [3, 4]),
        ("bias", [0, 1, 2, 3, 4]),
        ("l2sp", [0, 1, 2, 3, 4]),
    ],
)
def test_a_strategy_moves_its_layers_for_all_epochs(freeze, layers):
    (stage,) = plan(freeze)
    assert sorted(stage.rates) == layers
    assert set(stage.rates.values()) == {1.0}
    assert stage.epochs == 100
    assert stage.biases_only == (freeze == "bias")
    assert stage.pull == (0.5 if freeze == "l2sp" else 0.0)


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
