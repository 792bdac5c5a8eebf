"""Check which layers each freeze strategy trains."""

from __future__ import annotations

import pytest

from stiff_models.transfer.freeze_strategies import stages
from stiff_protocols.contract.errors import ConfigError


def plan(freeze, epochs=100):
    return stages(freeze, hidden_layers=4, epochs=epochs)


def test_lp_ft_trains_the_head_first_and_then_everything():
    head_stage, full_stage = plan("lp-ft", epochs=101)
    assert (head_stage.layers, full_stage.layers) == ((4,), (0, 1, 2, 3, 4))
    assert head_stage.epochs + full_stage.epochs == 101


@pytest.mark.parametrize(
    ("freeze", "layers"),
    [
        ("layers:3", (2,)),
        ("layers:out,1", (0, 4)),
        ("head", (4,)),
        ("first:2", (0, 1)),
        ("last:2", (3, 4)),
        ("full", (0, 1, 2, 3, 4)),
    ],
)
def test_other_strategies_train_their_layers_in_every_epoch(freeze, layers):
    assert [(stage.epochs, stage.layers) for stage in plan(freeze)] == [(100, layers)]


@pytest.mark.parametrize(
    "freeze",
    ["layers:5", "layers:0", "layers:1,x", "first:6", "last:0", "fulll", "full:1", ""],
)
def test_an_impossible_strategy_is_refused_with_what_is_valid(freeze):
    with pytest.raises(ConfigError, match=r"valid"):
        plan(freeze)
