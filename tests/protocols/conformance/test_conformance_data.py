"""Check the conformance suite for data sets and protocols."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from stiff_datasets.measured.fanuc_r2000ic import FanucR2000iC
from stiff_protocols.conformance.data_and_protocol_checks import check_dataset, check_protocol
from stiff_protocols.contract.types import BenchmarkData, Samples, Split
from stiff_protocols.protocol_catalog import PROTOCOLS
from stiff_protocols.splits.extrapolation import SpaceTransfer
from stiff_protocols.splits.random_splits import Holdout, PaperHoldout


def checks_by_name(make, fanuc):
    return {check.name: check for check in check_protocol(make, fanuc)}


@pytest.mark.parametrize("info", PROTOCOLS, ids=lambda info: info.key)
def test_the_shipped_protocols_keep_the_contract_and_part_no_pose(info, twin):
    samples = twin.samples.take(np.arange(0, len(twin.samples), 3))
    thinned_data = BenchmarkData(samples, twin.robot, under_load=twin.under_load)
    checks = checks_by_name(info.load(), thinned_data)
    assert [str(check) for check in checks.values() if check.status == "failed"] == []
    assert checks["no pose is parted"].status == "passed"


def test_a_protocol_may_report_training_rows_where_it_declares_that_and_nowhere_else(fanuc):
    question = "splits are those that a run accepts"
    checks = checks_by_name(lambda: PaperHoldout(read_on="all"), fanuc)
    assert [str(check) for check in checks.values() if check.status == "failed"] == []

    class Silent(PaperHoldout):
        reports_training = False

        def splits(self, samples, *, n_splits, seed):
            return PaperHoldout(read_on="all").splits(samples, n_splits=n_splits, seed=seed)

    check = checks_by_name(Silent, fanuc)[question]
    assert check.status == "failed" and "does not declare reports_training" in check.reason


def test_a_protocol_that_cannot_divide_a_data_set_says_so_once(fanuc):
    checks = check_protocol(SpaceTransfer, fanuc)
    (failed,) = (check for check in checks if check.status == "failed")
    assert "all samples are of group 'all'" in failed.reason and "--dataset KEY" in failed.advice
    assert {check.reason for check in checks if check is not failed} == {f"see {failed.name!r}"}


def random_overlapping_splits(samples):
    order = np.random.default_rng().permutation(len(samples))
    return [Split(0, order[:30], order[:0], order[20:40])]


def by_deflection(samples):
    order = np.argsort(samples.deflection[:, 2])
    return [Split(0, order[10:], order[:0], order[:10])]


def by_row(samples):
    """Return a split that tests one row in five."""
    rows = np.arange(len(samples))
    return [Split(0, rows[rows % 5 > 0], rows[:0], rows[rows % 5 == 0])]


ACCEPTED = "splits are those that a run accepts"


@pytest.mark.parametrize(
    ("make_splits", "question", "status", "reason"),
    [
        (random_overlapping_splits, ACCEPTED, "failed", "trains on 10 rows of its other"),
        (lambda _: [], ACCEPTED, "failed", "made no split"),
        (lambda samples: 2 * by_row(samples), ACCEPTED, "failed", "splits of index [0, 0]"),
        (
            random_overlapping_splits,
            "the same seed gives the same splits",
            "failed",
            "the same seed gave different",
        ),
        (
            by_deflection,
            "the division does not look at deflections",
            "failed",
            "gave different splits",
        ),
        (by_row, "no pose is parted", "not applicable", "warning: 1 of 1 splits test a pose"),
    ],
)
def test_a_protocol_that_breaks_a_rule_is_told_which(make_splits, question, status, reason, fanuc):
    class Broken(Holdout):
        def splits(self, samples, *, n_splits, seed):
            return make_splits(samples)

    check = checks_by_name(Broken, fanuc)[question]
    assert check.status == status and reason in check.reason


def test_a_data_set_in_mm_or_of_chance_fails(fanuc):
    class Loads:
        def load(self):
            wrench = fanuc.samples.wrench * np.random.default_rng().uniform()
            return replace(fanuc, samples=replace(fanuc.samples, wrench=wrench))

    class InMillimetres:
        def load(self):
            deflection = 1000.0 * fanuc.samples.deflection
            return replace(fanuc, samples=replace(fanuc.samples, deflection=deflection))

    *checks, answers = check_dataset(FanucR2000iC)
    assert all(check.status == "passed" for check in checks)
    assert answers.status == "not applicable"
    chance, units, *_ = check_dataset(Loads)
    assert (chance.status, units.status) == ("failed", "passed")
    assert "check that it is not in mm" in check_dataset(InMillimetres)[1].reason


def test_a_data_set_that_names_a_pose_of_another_turn_as_another_pose_gets_a_warning(fanuc):
    class TwoNames:
        def load(self):
            rows = fanuc.samples.take(np.array([0]))
            turned = replace(rows, q=rows.q - 2.0 * np.pi * np.eye(6)[5], pose_id=["other"])
            samples = Samples.together(fanuc.samples, turned)
            return replace(fanuc, samples=samples)

    names = {check.name: check for check in check_dataset(TwoNames)}
    assert names["a pose has one name"].status == "not applicable"
    assert names["a pose has one name"].reason.startswith("warning: 43 different joint positions")


@pytest.mark.parametrize(
    ("answer", "reason"),
    [
        (lambda q, wrench: np.zeros((len(q), 2)), "shape"),
        (
            lambda q, wrench: np.random.default_rng().normal(size=(len(q), 3)),
            "different deflections",
        ),
        (lambda q, wrench: np.full((len(q), 3), 1.0), "squared deflection"),
    ],
)
def test_a_robot_that_answers_as_another_one_or_by_chance_fails(answer, reason, twin):
    class Answers:
        def load(self):
            return replace(twin, under_load=answer)

    *checks, answers = check_dataset(Answers)
    assert all(check.status == "passed" for check in checks)
    assert answers.status == "failed" and reason in answers.reason
