"""Words of the command line: ``KEY@OPTION=VALUE`` and `--set KEY.option=value`, typed."""

from __future__ import annotations

from typing import Annotated

import pytest
from pydantic import AfterValidator

from helpers.run_requests import planned
from stiff_bench.plan.fits import fit_tasks
from stiff_bench.plan.options import Choice, options_of, parse_settings
from stiff_models.physics.vjm import VirtualJointModel
from stiff_models.transfer.ft_mlp import FtMlp
from stiff_protocols.contract.errors import ConfigError
from stiff_protocols.splits.random_splits import Holdout

CLASSES = {"ft-mlp": FtMlp, "holdout": Holdout, "vjm": VirtualJointModel}


class Foreign:
    """A class without annotations."""

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
        "vjm": {},
    }


@pytest.mark.parametrize("key", ["f", "sklearn:ensemble.Forest"])
def test_without_annotations_the_default_gives_the_type_and_a_key_may_hold_dots(key):
    words = [f"{key}.{setting}" for setting in ("alpha=2", "depth=4", "fast=false", "name=5")]
    parsed = parse_settings(words, {key: Foreign})[key]
    assert parsed == {"alpha": 2.0, "depth": 4, "fast": False, "name": "5"}
    assert isinstance(parsed["alpha"], float)


@pytest.mark.parametrize(
    ("word", "message"),
    [
        ("ft-mlp.freze=full", "unknown ft-mlp option 'freze'; did you mean 'freeze'"),
        ("ft-mpl.freeze=full", "unknown key 'ft-mpl'; did you mean 'ft-mlp'"),
        ("ft-mlp.epochs=-1", r"invalid epochs '-1' \(valid: whole number >= 0 or none\)"),
        ("ft-mlp.activation=swish", r"valid: auto \| relu .* \| sharp-gelu"),
        ("holdout.test_fraction=1", r"\(valid: number > 0 and < 1\)"),
        ("vjm.lever=maybe", r"invalid lever 'maybe' \(valid: given \| fit\)$"),
        ("ft-mlp.learning_rate=nan", "invalid learning_rate"),
        ("ft-mlp.freeze", "expected KEY.OPTION=VALUE"),
    ],
)
def test_a_wrong_setting_is_refused_with_what_is_valid(word, message):
    with pytest.raises(ConfigError, match=message):
        parse_settings([word], CLASSES)


def even(value: int) -> int:
    if value % 2:
        raise ValueError("an odd number of turns")
    return value


class Turned:
    def __init__(self, *, turns: Annotated[int, AfterValidator(even)] = 2): ...


def test_a_plugins_own_reason_is_printed_with_the_valid_values():
    with pytest.raises(ConfigError, match=r"invalid turns '3': an odd .* \(valid: whole"):
        parse_settings(["t.turns=3"], {"t": Turned})


def test_every_option_of_ours_is_described():
    for option in options_of(FtMlp).values():
        assert option.description and option.type_text


def names(choices):
    return [choice.name for choice in choices]


def test_one_run_can_have_several_variants_of_one_key():
    made = planned(
        models=("ft-mlp@freeze=full", "ft-mlp@freeze=layers:2,3@epochs=5", "ft-mlp"),
        datasets=("kr10-twin", "kr10-twin@specimen=3"),
        protocols=("kfold@folds=3",),
    )
    assert names(made.models) == [
        "ft-mlp@freeze=full",
        "ft-mlp@epochs=5@freeze=layers:2,3",
        "ft-mlp",
    ]
    assert names(made.datasets) == ["kr10-twin", "kr10-twin@specimen=3"]
    assert names(made.protocols) == ["kfold@folds=3"]
    assert [model.params["freeze"] for model in made.models[:2]] == ["full", "layers:2,3"]


def test_variants_are_cells_of_their_own_with_one_seed():
    plan = planned(models=("vjm", "knn@neighbours=3"), datasets=("kr10-twin@specimen=2",))
    tasks = list(fit_tasks(plan))
    names = [(task.presentation.model, task.presentation.dataset) for task in tasks]
    assert names == [(model, "kr10-twin@specimen=2") for model in ("vjm", "knn@neighbours=3")]
    assert len({task.fit.key for task in tasks}) == 2
    assert len({task.fit.model_seed for task in tasks}) == 1


def test_an_option_that_was_added_later_is_in_no_key_while_it_has_its_default():
    words = ("vjm", "vjm@tcp=fit", "vjm@tcp=given")
    default, chosen = planned(models=words).models
    assert default.identity == {}  # stored options of vjm before it had this option
    assert chosen.identity == {"tcp": "fit"}
    for choice, word in zip((default, chosen), words, strict=False):
        assert Choice.of_stored(choice.info, choice.identity).name == word


def test_a_stored_option_that_is_there_no_more_is_refused_and_named():
    (choice,) = planned(models=("knn@neighbours=3",)).models
    with pytest.raises(ConfigError, match="unknown knn option 'gone'"):
        Choice.of_stored(choice.info, {**choice.identity, "gone": 1})


def test_results_of_paper_holdout_keep_their_keys_though_it_got_another_reading():
    words = ("paper-holdout", "paper-holdout@read_on=all", "paper-holdout@read_on=test")
    default, read_on_all = planned(protocols=words).protocols
    assert default.identity == {"test_fraction": 0.2}
    assert read_on_all.identity == {"test_fraction": 0.2, "read_on": "all"}
    assert Choice.of_stored(read_on_all.info, read_on_all.identity).name == words[1]


def test_a_default_spelled_out_and_the_device_make_no_other_thing():
    made = planned(models=("mlp@device=cpu", "mlp"), datasets=("kr10-twin", "kr10-twin@specimen=0"))
    assert (names(made.models), names(made.datasets)) == (["mlp"], ["kr10-twin"])


def test_set_reaches_every_variant_and_the_word_has_the_last_word():
    made = planned(
        models=("mlp", "mlp@width=8"), settings=("mlp.width=16", "mlp.epochs=3"), metrics=("mae",)
    )
    assert names(made.models) == ["mlp@epochs=3@width=16", "mlp@epochs=3@width=8"]


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"models": ("vmj",)}, "unknown model 'vmj'; did you mean 'vjm'"),
        ({"models": ("mlp@widht=8",)}, "model 'mlp@widht=8': unknown mlp option 'widht'; did"),
        (
            {"protocols": ("cross-robot@source=kr10-twin@specimen=3",)},
            "unknown cross-robot option 'specimen' (valid: source, test_fraction, validation_f",
        ),
        (
            {"protocols": ("cross-robot@source=kr10-twin@specimen=3",)},
            "an @ inside a value is doubled: @@",
        ),
        ({"models": ("mlp@width",)}, "model 'mlp@width': expected KEY@OPTION=VALUE"),
        ({"models": ("mlp@width=8@width=9",)}, "mlp.width is set twice"),
        ({"datasets": ("kr10-twin@specimen=10",)}, "invalid specimen '10'"),
        ({"protocols": ("kfold@folds=1",)}, "protocol 'kfold@folds=1': invalid folds '1'"),
    ],
)
def test_a_wrong_word_is_refused_with_what_is_valid(changes, message):
    with pytest.raises(ConfigError) as refused:
        planned(**changes)
    assert message in str(refused.value)
