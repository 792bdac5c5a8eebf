"""The studies ask for what the tables and figures look up, under the same names."""

from __future__ import annotations

import pytest

from stiff_bench.cli.run import foreseen
from stiff_bench.paper.study import (
    ALL_PAIRS,
    DEPTHS,
    WIDTH_DEPTHS,
    WIDTHS,
    effects_study,
    leaderboard_study,
    paper_study,
    pretrained,
    study_plans,
    unfrozen,
)
from stiff_bench.plan.cells import cell_tasks
from stiff_bench.plan.registry import build_registry
from stiff_bench.run.execution import IN_THIS_PROCESS
from stiff_models.catalog import MODELS

KEYS = [info.key for info in MODELS]


def different(variants):
    return dict.fromkeys(one.name for one in variants)


def study_of(runs, folder):
    registry = build_registry()
    return study_plans(runs, output=folder, command="bench reproduce", registry=registry)


@pytest.mark.parametrize("runs", [paper_study(full=True), leaderboard_study(KEYS), effects_study()])
def test_every_variant_has_the_name_under_which_its_results_are_stored(runs, tmp_path):
    for run, plan in zip(runs, study_of(runs, tmp_path), strict=True):
        assert tuple(choice.name for choice in plan.models) == tuple(different(run.models))
        assert tuple(choice.name for choice in plan.datasets) == tuple(different(run.datasets))
        assert tuple(choice.name for choice in plan.protocols) == run.protocols


def test_the_full_study_has_the_papers_depths_widths_activations_and_every_pair_of_layers():
    models = {name for run in paper_study(full=True) for name in different(run.models)}
    assert {pretrained(layers=depth, width=100).name for depth in DEPTHS} <= models
    assert len(WIDTHS) == 19 and {pretrained(layers=3, width=n).name for n in WIDTHS} <= models
    assert {pretrained(layers=d, width=400).name for d in WIDTH_DEPTHS} <= models
    assert "mlp-pretrained@activation=tanh" in models
    assert len(ALL_PAIRS) == 10 and {unfrozen(pair).name for pair in ALL_PAIRS} <= models
    assert {run.splits for run in paper_study(full=True)} == {5}


def test_the_quick_study_is_a_part_of_the_full_one_on_one_split():
    quick, full = (
        {m for r in paper_study(full=f) for m in different(r.models)} for f in (False, True)
    )
    assert quick < full
    assert {run.splits for run in paper_study(full=False)} == {1}


def test_a_cell_that_two_parts_need_is_asked_for_once(tmp_path):
    runs = paper_study(full=True)
    asked = [(name, run.protocols) for run in runs for name in different(run.models)]
    assert len(asked) > len(set(asked))  # Figure 5's sweep has Table 6's and Table 7's networks too
    keys = [task.cell.key for task in cell_tasks(*study_of(runs, tmp_path))]
    assert len(keys) == len(set(keys)) == 5 * len(set(asked))


def test_the_leaderboard_has_every_shipped_model_once():
    for run in leaderboard_study(KEYS):
        assert [one.key for one in run.models] == KEYS


def test_before_anything_is_stored_a_forecast_says_that_no_time_is_known(tmp_path):
    found = foreseen(study_of(paper_study(full=False), tmp_path), IN_THIS_PROCESS)
    assert found.n_unknown == found.n_cells > 0 and found.seconds == 0.0
