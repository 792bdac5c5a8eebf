"""Freeze strategies: what each word lets move."""

from __future__ import annotations

import pytest

from stiff_models.transfer.freeze_strategies import named_layers, stages
from stiff_protocols.contract.errors import ConfigError


def plan(freeze, epochs=100):
    return stages(freeze, hidden_layers=4, epochs=epochs)


def test_lp_ft_trains_the_head_first_and_then_everything():
    head, everything = plan("lp-ft", epochs=101)
    assert (head.layers, everything.layers) == ((4,), (0, 1, 2, 3, 4))
    assert head.epochs + everything.epochs == 101


@pytest.mark.parametrize(
    "freeze",
    [
        "layers:5",
        "layers:0",
        "layers:",
        "layers:1,x",
        "first:6",
        "last:0",
        "fulll",
        "full:1",
        "l2sp",
        "",
    ],
)
def test_an_impossible_strategy_is_refused_with_what_is_valid(freeze):
    with pytest.raises(ConfigError, match=r"valid"):
        plan(freeze)


def test_the_layers_that_a_strategy_names_are_those_written_and_none_of_another_strategy():
    assert named_layers("layers:1,out") == ("1", "out")
    assert named_layers("first:2") == named_layers("full") == named_layers("") == ()
