"""`cross-robot` in the engine: sources of fits, their notes, and refusals."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from helpers.made_robots import random_chain
from helpers.run_requests import computed, planned
from stiff_bench.plan.fits import NO_SOURCE, fit_tasks
from stiff_bench.plan.options import chosen_dataset
from stiff_bench.plan.registry import build_registry
from stiff_bench.store.names import split_word
from stiff_datasets.twin.robot_twin import Ur5Twin
from stiff_protocols.contract.errors import ConfigError
from stiff_protocols.contract.plugin import ProtocolInfo
from stiff_protocols.contract.types import BenchmarkData, Samples, Split
from stiff_protocols.splits.checks import check_source
from stiff_protocols.splits.cross_robot import OWN_SOURCE
from stiff_protocols.splits.random_splits import Holdout

pytestmark = pytest.mark.usefixtures("small_source")

FROM_UR5 = "source ur5-twin"
OPTIONS = {"width": 8, "pretrain_steps": 3, "epochs": 4, "training": "best"}
FT_MLP = "@".join(["ft-mlp", *(f"{name}={value}" for name, value in OPTIONS.items())])


@pytest.fixture(scope="module")
def ur5():
    return Ur5Twin().load()


@pytest.fixture()
def cross_tasks(tasks_of):
    """A function that lists fits of the FANUC with the UR5 as the foreign source."""
    return lambda *models: tasks_of(models, "fanuc-r2000ic", "cross-robot@source=ur5-twin", 2)


def of_condition(tasks, condition):
    return [task for task in tasks if task.fit.condition == condition]


def test_both_conditions_share_rows_and_model_seed_and_are_stored_apart(cross_tasks, ur5):
    tasks = cross_tasks(FT_MLP)
    for own_task, foreign_task in zip(
        of_condition(tasks, OWN_SOURCE), of_condition(tasks, FROM_UR5), strict=True
    ):
        assert own_task.fit.split_sha256 == foreign_task.fit.split_sha256
        assert own_task.fit.model_seed == foreign_task.fit.model_seed
        assert own_task.fit.key != foreign_task.fit.key
        assert own_task.source is None and own_task.fit.source_sha256 == ""
        assert foreign_task.fit.source_sha256 == ur5.sha256 == foreign_task.source.sha256
    assert len({task.fit.model_seed for task in tasks}) == 2  # one per split


@pytest.mark.slow
def test_with_the_foreign_source_a_cell_and_its_intervals_are_those_of_that_source(cross_tasks):
    pretrained = "mlp-pretrained@width=8@pretrain_steps=3"
    own_task, foreign_task, *_ = (
        replace(task, fit=replace(task.fit, coverage=0.8)) for task in cross_tasks(pretrained)
    )
    samples = foreign_task.data.samples
    # every label of the target
    relabelled_samples = replace(samples, deflection=samples.deflection * 2.0)

    def bounds(task):
        result = computed(task)
        interval = result.prediction.interval
        return result.prediction.predicted, (interval.lower + interval.upper) / 2.0

    predicted, centre = bounds(foreign_task)
    np.testing.assert_allclose(centre, predicted, atol=1e-15)  # the copy has the source too
    relabelled = bounds(
        replace(foreign_task, data=replace(foreign_task.data, samples=relabelled_samples))
    )
    np.testing.assert_array_equal(relabelled[0], predicted)
    assert (bounds(own_task)[0] != predicted).any()


def test_rows_have_the_training_regime_of_their_source(cross_tasks):
    tasks = cross_tasks("vjm", "ft-mlp", "mlp-pretrained")
    regimes = {(task.fit.model, task.fit.condition): task.presentation.regime for task in tasks}
    assert (
        regimes["vjm", OWN_SOURCE]
        == regimes["ft-mlp", OWN_SOURCE]
        == regimes["ft-mlp", FROM_UR5]
        == ""
    )
    assert regimes["vjm", FROM_UR5] == NO_SOURCE
    assert regimes["mlp-pretrained", OWN_SOURCE] == "trained on simulated deflections only"
    assert regimes["mlp-pretrained", FROM_UR5] == "no measured deflection used"
    own_caveats, foreign_caveats = (
        of_condition(tasks, condition)[0].presentation.caveats
        for condition in (OWN_SOURCE, FROM_UR5)
    )
    assert set(foreign_caveats) > set(own_caveats) and not any(
        "ur5-twin" in caveat for caveat in own_caveats
    )


@pytest.mark.parametrize(
    ("word", "part"),
    [
        ("kr10-twn", "unknown dataset 'kr10-twn'; did you mean 'kr10-twin'"),
        ("kr10-twin@@specimn=3", "unknown kr10-twin option 'specimn'; did you mean 'specimen'"),
        ("kr10-twin@@specimen=99", "invalid specimen '99'"),
    ],
)
def test_a_source_that_does_not_exist_is_refused_before_any_data_is_loaded(
    word, part, tasks_of, monkeypatch
):
    monkeypatch.setattr("stiff_bench.plan.fits.loaded", lambda _: pytest.fail("loaded"))
    with pytest.raises(ConfigError, match=f"protocol cross-robot@source={word}: source .*{part}"):
        tasks_of(("vjm",), "fanuc-r2000ic", f"cross-robot@source={word}")


def test_a_source_that_holds_but_one_sample_of_the_target_is_refused(fanuc, ur5):
    rows = {
        name: np.concatenate([getattr(ur5.samples, name), getattr(fanuc.samples, name)[[17]]])
        for name in ("q", "wrench", "deflection", "pose_id", "load_id", "group")
    }
    with pytest.raises(ConfigError, match="holds 1 of the 43 samples of its target 'fanuc'"):
        check_source("mixed", BenchmarkData(Samples(**rows), ur5.robot), "fanuc", fanuc)
    check_source("ur5-twin", ur5, "fanuc", fanuc)


def test_a_source_with_the_targets_samples_by_another_turn_or_rounding_is_refused(fanuc):
    for shift in (2.0 * np.pi * np.eye(6)[5], np.full(6, -2e-16)):
        turned = replace(fanuc.samples, q=fanuc.samples.q + shift)
        with pytest.raises(ConfigError, match="holds 43 of the 43 samples"):
            check_source("turned", BenchmarkData(turned, fanuc.robot), "fanuc", fanuc)


def test_a_source_with_other_joints_is_refused(rng, fanuc, ur5):
    five = random_chain(rng, ("revolute",) * 5)
    fewer = BenchmarkData(replace(ur5.samples, q=ur5.samples.q[:, :5]), five)
    with pytest.raises(ConfigError, match=r"'chain' has 5 joints \(revolute\).*has 6 joints"):
        check_source("mine", fewer, "fanuc", fanuc)
    slides = replace(ur5.robot, joint_types=("prismatic", *ur5.robot.joint_types[1:]))
    with pytest.raises(ConfigError, match=r"has 6 joints \(prismatic, revolute, "):
        check_source("mine", BenchmarkData(ur5.samples, slides), "fanuc", fanuc)


def test_a_plugins_split_must_not_name_a_source_that_its_protocol_did_not_announce():
    rows = np.arange(30)

    class Theirs(Holdout):
        def splits(self, samples, *, n_splits, seed):
            return [Split(0, rows, rows[:0], rows[:5] + 30, source="elsewhere")]

    registry = build_registry()
    registry.protocols["mine"] = ProtocolInfo(key="mine", target=Theirs, summary="")
    plan = planned(registry, datasets=("fanuc-r2000ic",), protocols=("mine",))
    with pytest.raises(ConfigError, match=r"'mine': a split's source is 'elsewhere'.*valid: none"):
        next(fit_tasks(plan))


def test_a_word_inside_a_word_doubles_the_mark_and_its_name_can_be_typed_again(tasks_of):
    word = "cross-robot@source=kr10-twin@@specimen=3@@seed=1@test_fraction=0.3"
    assert split_word(word) == (
        "cross-robot",
        ["source=kr10-twin@specimen=3@seed=1", "test_fraction=0.3"],
    )
    task = tasks_of(("vjm",), "fanuc-r2000ic", word)[1]
    assert task.presentation.protocol == word
    assert task.fit.condition == "source kr10-twin@specimen=3@seed=1"
    choice = chosen_dataset("kr10-twin@specimen=3@seed=1", (), build_registry())
    assert task.fit.source_sha256 == choice.make().load().sha256
