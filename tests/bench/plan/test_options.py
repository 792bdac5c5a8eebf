"""`--set KEY.option=value`: typed, bounded, and helpful when wrong."""

from __future__ import annotations

import pytest

from stiff_bench.plan.options import options_of
from stiff_bench.plan.words import parse_settings
from stiff_models.transfer.ft_mlp import FtMlp
from stiff_protocols.contract.errors import ConfigError
from stiff_protocols.splits.random_splits import Holdout

CLASSES = {"ft-mlp": FtMlp, "holdout": Holdout}


class Foreign:
    """A class of somebody who annotates nothing."""

    def __init__(self, *, alpha=0.5, depth=3, fast=True, name="a"):
        self.alpha, self.depth, self.fast, self.name = alpha, depth, fast, name


def test_values_get_the_type_of_their_option():
    words = [
        "ft-mlp.freeze=layers:2,3",
        "ft-mlp.epochs=7",
        "ft-mlp.learning_rate=1e-3",
        "ft-mlp.pretrain_steps=none",
        "holdout.test_fraction=0.3",
    ]
    assert parse_settings(words, CLASSES) == {
        "ft-mlp": {
            "freeze": "layers:2,3",
            "epochs": 7,
            "learning_rate": 1e-3,
            "pretrain_steps": None,
        },
        "holdout": {"test_fraction": 0.3},
    }


def test_without_annotations_the_default_gives_the_type():
    words = ["f.alpha=2", "f.depth=4", "f.fast=false", "f.name=5"]
    parsed = parse_settings(words, {"f": Foreign})["f"]
    assert parsed == {"alpha": 2.0, "depth": 4, "fast": False, "name": "5"}
    assert isinstance(parsed["alpha"], float)


def test_a_key_may_hold_dots():
    key = "sklearn:ensemble.Forest"
    assert parse_settings([f"{key}.depth=9"], {key: Foreign}) == {key: {"depth": 9}}


@pytest.mark.parametrize(
    ("word", "message"),
    [
        ("ft-mlp.freze=full", "unknown ft-mlp option 'freze'; did you mean 'freeze'"),
        ("ft-mpl.freeze=full", "unknown key 'ft-mpl'; did you mean 'ft-mlp'"),
        ("ft-mlp.epochs=many", r"'many' is no valid epochs.*whole number >= 0"),
        ("ft-mlp.epochs=-1", "greater than or equal to 0"),
        ("ft-mlp.epochs=1.5", "no valid epochs"),
        ("ft-mlp.activation=swish", r"valid: auto \| relu \| tanh \| sigmoid \| gelu"),
        ("holdout.test_fraction=1", "less than 1"),
        ("ft-mlp.learning_rate=nan", "no valid learning_rate"),
        ("ft-mlp.freeze", "expected KEY.option=value"),
        ("freeze=full", "expected KEY.option=value"),
        ("ft-mlp.epochs=18446744073709551617", "more than the 64 bits"),
        ("ft-mlp.freeze=full\udcff", "no UTF-8"),
    ],
)
def test_a_wrong_setting_is_refused_with_what_is_valid(word, message):
    with pytest.raises(ConfigError, match=message):
        parse_settings([word], CLASSES)


def test_every_option_of_ours_is_described():
    for option in options_of(FtMlp).values():
        assert option.description and option.type_text
