"""A study's file: what it asks for, and what is refused."""

from __future__ import annotations

from collections import Counter, defaultdict

import pytest

from stiff_bench.paper.study_file import find_study, read_study
from stiff_bench.plan.registry import build_registry
from stiff_protocols.contract.errors import ConfigError

SIMPLE = (
    'title = "t"\nmodels = ["vjm"]\ndatasets = ["two"]\n[groups]\ntwo = ["kr10-twin", "ur5-twin"]\n'
)


@pytest.fixture(scope="module")
def plans(tmp_path_factory):
    """Return the plans of a shipped study by its name."""
    registry, folder = build_registry(), tmp_path_factory.mktemp("none")
    return lambda name: find_study(name).plans(registry, output=folder, command="")


def fits(plans):
    """(model, data set, protocol, seed, split) of the fits of some plans, as often as asked for."""
    return [
        (model.name, dataset.name, protocol.name, plan.seed, split)
        for plan in plans
        for model in plan.models
        for dataset in plan.datasets
        for protocol in plan.protocols
        for split in range(plan.splits)
    ]


def test_a_run_takes_the_keys_at_the_top_of_the_file_except_its_own(tmp_path):
    file = tmp_path / "mine.toml"
    file.write_text(SIMPLE + "[[run]]\n[[run]]\ndatasets = ['fanuc-r2000ic']\nseed = 3\n")
    study = read_study(file)
    assert (study.name, study.tables) == ("mine", ("scores",))
    shared_run, own_run = study.plans(build_registry(), output=tmp_path, command="")
    assert [choice.name for choice in shared_run.datasets] == ["kr10-twin", "ur5-twin"]
    assert [choice.name for choice in own_run.datasets] == ["fanuc-r2000ic"]
    assert [plan.models[0].name for plan in (shared_run, own_run)] == ["vjm", "vjm"]
    assert (shared_run.seed, own_run.seed) == (0, 3)


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("title = ", "not TOML"),
        (SIMPLE.replace("title", "titel"), "unknown key 'titel'; did you mean 'title'"),
        (SIMPLE.replace("models", "model"), "unknown key 'model'; did you mean 'models'"),
        (SIMPLE + "[board]\nprotocols = 3\n", "unknown key 'protocols'; did you mean 'protocol'"),
        (SIMPLE + "[[run]]\nsplit = 3\n", "unknown key 'split'; did you mean 'splits'"),
        ('title = "t"\nmodels = ["vjm"]\n', "run.0.datasets is missing"),
        (SIMPLE + "[[run]]\nsplits = 0\n", "run.0.splits = 0: it should be greater"),
        (SIMPLE + "[[run]]\nmodels = 3\n", "run.0.models = 3"),
        (SIMPLE.replace('["vjm"]', '["vjm", 3]'), "run.0.models.1 = 3"),
        ("run = 3\n" + SIMPLE, "run = 3"),
        ("name = '../x'\n" + SIMPLE, "name = '../x'"),
    ],
)
def test_a_wrong_file_is_refused_by_file_key_and_value(text, message, tmp_path):
    file = tmp_path / "mine.toml"
    file.write_text(text)
    with pytest.raises(ConfigError) as refused:
        read_study(file)
    assert str(file) in str(refused.value) and message in str(refused.value)


@pytest.mark.parametrize("sign", ["\\n# H", "\\u001b[2J", "\\u202e", "\\u0000", "\\u2028"])
@pytest.mark.parametrize("key", ["name", "title", "notes"])
def test_control_characters_in_texts_of_a_study_are_refused_by_key(key, sign, tmp_path):
    file = tmp_path / "mine.toml"
    value = f'["a{sign}b"]' if key == "notes" else f'"a{sign}b"'
    usual = SIMPLE.removeprefix('title = "t"\n') if key == "title" else SIMPLE
    file.write_text(f"{key} = {value}\n{usual}")
    with pytest.raises(ConfigError, match=rf"mine.toml: {key}.*it should be one line") as refused:
        read_study(file)
    assert str(refused.value).isprintable()


def test_a_run_may_ask_for_intervals(tmp_path):
    file = tmp_path / "mine.toml"
    file.write_text(
        'title = "a"\nmetrics = ["norm"]\n[[run]]\nmodels = ["vjm"]\n'
        'datasets = ["kr10-twin"]\n[[run]]\nmodels = ["gp"]\ndatasets = ["kr10-twin"]\n'
        "intervals = true\n"
    )
    plain, with_intervals = read_study(file).plans(build_registry(), output=tmp_path, command="")
    assert plain.coverage is None and with_intervals.coverage == 0.9


@pytest.mark.parametrize(
    ("name", "n_fits", "n_shared"),
    [
        *(("paper", 494, 25), ("paper-quick", 49, 1)),  # of several tables and figures
        ("intervals", 225, 0),
        ("fresh", 720, 0),
    ],
)
def test_a_shipped_study_asks_for_its_fits_by_valid_names(name, n_fits, n_shared, plans):
    """Only other tables and figures of the paper request a fit twice."""
    requested_fits = fits(plans(name))
    assert len(set(requested_fits)) == n_fits
    assert len(requested_fits) == n_fits + n_shared


def test_the_leaderboard_has_every_world_of_twelve_robots_and_two_plans_of_the_clean_one(plans):
    groups, (first, *_) = find_study("leaderboard").groups, plans("leaderboard")
    assert [len(set(group)) for group in groups.values()] == [12] * 6
    names = [name for name, group in groups.items() for _ in group]
    assert len({choice.name for choice in first.datasets}) == 72
    for name, choice in zip(names, first.datasets, strict=True):
        world, _, plan = name.partition(", ")
        assert choice.identity["world"] == world
        assert choice.identity["plan"] == (plan or "wide")


def test_leaderboard_models_have_every_data_set_once(plans):
    study, requested = find_study("leaderboard"), plans("leaderboard")
    all_fits = fits(requested)
    assert len(set(all_fits)) == len(all_fits)
    counts: dict[str, Counter] = defaultdict(Counter)
    for plan in requested:
        if plan.protocols[0].name == study.board.protocol:
            for model in plan.models:
                counts[model.name].update(choice.name for choice in plan.datasets)
    assert {*study.board.variants} < counts.keys()
    for name, of_model in counts.items():
        assert {*of_model.values()} == {1}
        is_everywhere = len(of_model) == 73 and "fanuc-r2000ic" in of_model
        assert is_everywhere or name in study.board.variants


def test_the_leaderboards_controls_and_variants_are_models_that_it_runs(plans):
    study = find_study("leaderboard")
    models = {model.name for plan in plans("leaderboard") for model in plan.models}
    assert {*study.board.variants, *study.board.controls, *study.board.controls.values()} <= models


def test_the_quick_study_is_a_part_of_the_full_one_on_one_split(plans):
    assert {*fits(plans("paper-quick"))} < {*fits(plans("paper"))}
    assert {plan.splits for plan in plans("paper-quick")} == {1}


def test_the_short_leaderboard_is_one_split_of_four_robots_with_every_model_of_that_split(plans):
    study = find_study("leaderboard")
    (run,) = study.lite_version().run
    assert (run.datasets, run.splits, run.seed) == (study.lite, 1, 0) and len(run.datasets) == 4
    divided_alike = [
        part for part in study.run if (part.protocols, part.seed) == (run.protocols, run.seed)
    ]
    assert {*run.models} == {word for part in divided_alike for word in part.models}
    assert len({*run.models}) == len(run.models)
    assert run.settings == () and run.protocols == study.run[0].protocols


def test_a_study_without_a_short_version_says_so(tmp_path):
    file = tmp_path / "mine.toml"
    file.write_text(SIMPLE)
    with pytest.raises(ConfigError, match="has no key lite"):
        read_study(file).lite_version()
    file.write_text(SIMPLE.replace("[groups]", 'lite = ["kr11-twin"]\n[groups]'))
    with pytest.raises(ConfigError, match="lite: unknown data set 'kr11-twin'"):
        read_study(file)


def test_another_model_takes_part_in_every_division_once_with_its_own_settings(tmp_path):
    study = find_study("leaderboard").with_models(["vjm", "ft-mlp"])
    divisions = [
        (dataset, run.protocols, run.splits, run.seed)
        for run in study.run
        for dataset in run.datasets
    ]
    assert len(set(divisions)) == len(divisions) == 3 * 72 + 1
    numbers = {number for _, protocols, number, _ in divisions if "holdout-paths" in protocols}
    assert numbers == {2, 15}  # of simulated robots, and of the FANUC
    assert {run.models for run in study.run} == {("vjm", "ft-mlp")}
    assert {word for run in study.run for word in run.settings} == set()
