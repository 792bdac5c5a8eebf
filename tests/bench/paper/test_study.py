"""The studies ask for what the tables and figures look up, in the words of `bench run`."""

from __future__ import annotations

import pytest

from stiff_bench.execution import IN_THIS_PROCESS
from stiff_bench.option_word import split_word
from stiff_bench.paper.expected_time import DT_CNN_STEPS, RECIPES, expected_s
from stiff_bench.paper.model_words import ALL_PAIRS, pretrained, unfrozen
from stiff_bench.paper.reproduce import Study, forecast_of
from stiff_bench.paper.study import (
    DEPTHS,
    WIDTH_DEPTHS,
    WIDTHS,
    leaderboard_study,
    paper_study,
)
from stiff_bench.registry import usable_registry
from stiff_models import dt_cnn
from stiff_models.catalog import MODELS
from stiff_models.mlp_pretrained import PRETRAINING

KEYS = [info.key for info in MODELS]


def study_of(runs, folder):
    return Study.of(runs, output=folder, command="bench reproduce", registry=usable_registry())


@pytest.mark.parametrize("runs", [paper_study(full=True), leaderboard_study(KEYS)])
def test_every_word_is_the_name_under_which_its_results_are_stored(runs, tmp_path):
    for run, plan in zip(runs, study_of(runs, tmp_path).plans, strict=True):
        assert tuple(choice.name for choice in plan.models) == run.models
        assert tuple(choice.name for choice in plan.datasets) == run.datasets
        assert tuple(choice.name for choice in plan.protocols) == run.protocols


def test_the_full_study_has_the_papers_depths_widths_activations_and_every_pair_of_layers():
    models = {model for run in paper_study(full=True) for model in run.models}
    assert {pretrained(layers=depth, width=100) for depth in DEPTHS} <= models
    assert len(WIDTHS) == 19 and {pretrained(layers=3, width=width) for width in WIDTHS} <= models
    assert {pretrained(layers=d, width=400) for d in WIDTH_DEPTHS} <= models
    assert "mlp-pretrained@activation=tanh" in models
    assert len(ALL_PAIRS) == 10 and {unfrozen(pair) for pair in ALL_PAIRS} <= models
    assert {run.splits for run in paper_study(full=True)} == {5}


def test_the_quick_study_is_a_part_of_the_full_one_on_one_split():
    quick, full = ({m for r in paper_study(full=f) for m in r.models} for f in (False, True))
    assert quick < full
    assert {run.splits for run in paper_study(full=False)} == {1}


def test_a_cell_that_two_parts_need_is_asked_for_once(tmp_path):
    runs = paper_study(full=True)
    asked = [(model, run.protocols) for run in runs for model in run.models]
    assert len(asked) > len(set(asked))  # Figure 5's sweep has Table 6's and Table 7's networks too
    keys = [task.cell.key for task in study_of(runs, tmp_path).tasks()]
    assert len(keys) == len(set(keys)) == 5 * len(set(asked))


def test_the_leaderboard_has_every_shipped_model_once():
    for run in leaderboard_study(KEYS):
        assert [split_word(word)[0] for word in run.models] == KEYS


def test_a_forecast_knows_a_time_for_every_cell_before_any_is_stored(tmp_path):
    found = forecast_of(study_of(paper_study(full=False), tmp_path), IN_THIS_PROCESS)
    assert found.n_unknown == 0
    assert 60.0 < found.seconds < 3600.0


def test_the_expected_time_grows_with_the_network_and_its_steps():
    assert expected_s("mlp-pretrained@width=40") < expected_s("mlp-pretrained")
    assert expected_s("mlp-pretrained@pretrain_steps=300") < expected_s("mlp-pretrained")
    assert expected_s("mlp-pretrained@layers=6") > expected_s("mlp-pretrained")
    assert expected_s("dt-cnn@pretrain_steps=300") < 0.2 * expected_s("dt-cnn")
    short = "mlp-pretrained@pretrain_steps=100"
    assert expected_s(f"{short}@recipe=paper") < 0.6 * expected_s(short)  # 256 samples, not 1,024
    assert expected_s("mlp-pretrained@recipe=paper") > 5 * expected_s("mlp-pretrained@recipe=best")
    assert expected_s("vjm") < 1.0 < expected_s("deep-ensemble")


def test_the_recipes_that_a_forecast_counts_with_are_those_of_the_models():
    plans = {recipe: (plan.steps, plan.batch) for recipe, plan in PRETRAINING.items()}
    assert plans == RECIPES
    assert dt_cnn.FAST.steps == DT_CNN_STEPS
