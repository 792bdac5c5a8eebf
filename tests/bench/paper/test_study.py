"""The studies ask for what the tables and figures look up, under the same names."""

from __future__ import annotations

import pytest

from stiff_bench.paper.results import PaperResults
from stiff_bench.paper.study import (
    ALL_PAIRS,
    DEPTHS,
    FAIR_PROTOCOL,
    PAPER_PROTOCOL,
    READ_ON_ALL,
    WIDTH_DEPTHS,
    WIDTHS,
    effects_study,
    leaderboard_study,
    paper_recipe_study,
    paper_study,
    pretrained,
    study_plans,
    transfer_study,
    unfrozen,
)
from stiff_bench.plan.cells import cell_tasks
from stiff_bench.plan.registry import build_registry
from stiff_bench.run.cell import unfinished
from stiff_bench.store.database import ResultStore
from stiff_models.model_catalog import MODELS

KEYS = [info.key for info in MODELS]


def different(variants):
    return dict.fromkeys(one.name for one in variants)


def study_of(runs, folder):
    registry = build_registry()
    return study_plans(runs, output=folder, command="bench reproduce", registry=registry)


STUDIES = [
    (*paper_study(full=True), *paper_recipe_study()),
    leaderboard_study(KEYS),
    effects_study(),
    transfer_study(),
]


@pytest.mark.parametrize("runs", STUDIES)
def test_every_variant_has_the_name_under_which_its_results_are_stored(runs, tmp_path):
    """The paper's models name defaults, too, which no stored name does: see the next test."""
    for run, plan in zip(runs, study_of(runs, tmp_path), strict=True):
        assert len(plan.models) == len(different(run.models))
        if runs is not STUDIES[0]:
            assert tuple(choice.name for choice in plan.models) == tuple(different(run.models))
        assert tuple(choice.name for choice in plan.datasets) == tuple(different(run.datasets))
        assert tuple(choice.name for choice in plan.protocols) == tuple(different(run.protocols))


def test_the_results_of_every_model_of_the_paper_are_found_again(tmp_path):
    """By the options that it names, whichever of them are defaults and left out of its name."""
    runs = (*paper_study(full=False), *paper_recipe_study())
    store = ResultStore(tmp_path)
    models = {one.name: one for run in runs for one in run.models}
    for task in cell_tasks(*study_of(runs, tmp_path)):
        store.write_cells([unfinished(task, "r", task.cell.key)])
    stored = PaperResults.of(tmp_path)
    for protocol in (PAPER_PROTOCOL.name, READ_ON_ALL.name, FAIR_PROTOCOL.name):
        asked = {n for r in runs for n in different(r.models) if protocol in different(r.protocols)}
        found = stored.of_models(models.values(), protocol)
        assert found.failures.keys() == asked and set(found.missing) == models.keys() - asked
        assert len(set(found.failures.values())) == len(asked)  # nobody has another's


def test_the_full_study_has_what_the_paper_varies_and_the_quick_one_a_part_of_it_on_one_split():
    full, quick = (
        {name for run in paper_study(full=whole) for name in different(run.models)}
        for whole in (True, False)
    )
    assert quick < full
    assert {pretrained(layers=depth, width=100).name for depth in DEPTHS} <= full
    assert len(WIDTHS) == 19 and {pretrained(layers=3, width=n).name for n in WIDTHS} <= full
    assert {pretrained(layers=d, width=400).name for d in WIDTH_DEPTHS} <= full
    assert pretrained(activation="tanh").name in full
    assert len(ALL_PAIRS) == 10 and {unfrozen(pair).name for pair in ALL_PAIRS} <= full
    assert {run.splits for run in paper_study(full=True)} == {5}
    assert {run.splits for run in paper_study(full=False)} == {1}


def test_a_cell_that_two_parts_need_is_asked_for_once(tmp_path):
    runs = paper_study(full=True)
    asked = [
        (name, protocol)
        for run in runs
        for name in different(run.models)
        for protocol in different(run.protocols)
    ]
    assert len(asked) > len(set(asked))  # Figure 5's sweep has Table 6's and Table 7's networks too
    keys = [task.cell.key for task in cell_tasks(*study_of(runs, tmp_path))]
    assert len(keys) == len(set(keys)) == 5 * len(set(asked))


def test_the_leaderboard_has_every_shipped_model_once():
    for run in leaderboard_study(KEYS):
        assert [one.key for one in run.models] == KEYS
