"""Check that splits keep their parts apart, and that impossible splits are refused."""

from __future__ import annotations

import re
from dataclasses import replace

import numpy as np
import pytest
from sklearn.model_selection import GroupShuffleSplit

from helpers.made_samples import unloaded
from stiff_protocols.contract.errors import ConfigError
from stiff_protocols.contract.types import Split
from stiff_protocols.splits.checks import first_fault
from stiff_protocols.splits.generators import LazySplits, group_shuffles
from stiff_protocols.splits.random_splits import (
    Holdout,
    KFold,
    LeaveOneOut,
    PaperHoldout,
    RepeatedHoldout,
)
from stiff_protocols.splits.sample_efficiency import SampleEfficiency
from stiff_protocols.splits.sensor_noise import SensorNoise

BY_POSE = [Holdout(), RepeatedHoldout(), KFold(), LeaveOneOut()]


def test_holdout_tests_a_fifth_of_the_poses_and_leave_one_out_each_one_in_the_datas_order():
    (split,) = Holdout().splits(unloaded(150), n_splits=1, seed=0)
    assert [len(split.train), len(split.validation), len(split.test)] == [96, 24, 30]
    splits = LeaveOneOut().splits(unloaded(12), n_splits=None, seed=0)
    assert [int(split.test[0]) for split in splits] == list(range(12))


@pytest.mark.parametrize(
    ("protocol", "n_poses", "n_splits", "message"),
    [
        *((protocol, 1, None, "1 samples of .* cannot be divided") for protocol in BY_POSE),
        (PaperHoldout(), 1, None, "cannot be divided"),
        (SensorNoise(), 1, None, "1 samples of 1 poses cannot be divided"),
        (KFold(), 4, 5, r"4 samples of 4 poses cannot be divided: folds=5 \(valid: 2 to 4\)"),
        (Holdout(test_fraction=0.9), 5, None, r"test_fraction=0.9 .*\(valid: at most 4/5\)"),
        (
            Holdout(validation_fraction=0.9),
            5,
            None,
            r"validation_fraction=0.9 .*valid: at most 3/4",
        ),
        (KFold(folds=3), 10, 4, r"splits 4: kfold has 3 splits.*kfold@folds=4"),
        (LeaveOneOut(), 10, 2, "one split per pose"),
        (SampleEfficiency(), 4, None, "4 poses cannot be divided: test_fraction=0.2"),
        (SampleEfficiency(test_fraction=0.5), 2, None, "2 poses cannot be divided: test_frac"),
        (SampleEfficiency(), 1, None, "1 poses cannot be divided: test_fraction=0.2"),
    ],
)
def test_what_the_poses_do_not_allow_is_refused_with_numbers(protocol, n_poses, n_splits, message):
    with pytest.raises(ConfigError, match=message):
        protocol.splits(unloaded(n_poses), n_splits=n_splits, seed=0)


@pytest.mark.parametrize(
    ("protocol", "option", "valid", "texts"),
    [
        (
            SampleEfficiency,
            "sample-efficiency.sizes",
            "whole numbers from 1",
            ("few", "5,,10", "5;10", "", "0,5", "-3", "2.5"),
        ),
        (SensorNoise, "sensor-noise.levels", "numbers from 0", ("loud", "1,,5", "-1", "0,inf")),
    ],
)
def test_a_list_that_holds_no_valid_numbers_is_refused_by_its_option(
    protocol, option, valid, texts
):
    for text in texts:
        instance = protocol(**{option.partition(".")[2]: text})
        message = re.escape(f"{option}={text!r}: valid are {valid}, separated by commas")
        with pytest.raises(ConfigError, match=message):
            instance.splits(unloaded(20), n_splits=None, seed=0)


def test_repeated_holdout_begins_with_holdouts_splits_and_has_fifteen_unless_told_otherwise():
    samples = unloaded(30, 2)
    repeated_splits = RepeatedHoldout().splits(samples, n_splits=None, seed=4)
    holdout_splits = Holdout().splits(samples, n_splits=3, seed=4)
    assert [s.sha256 for s in repeated_splits[:3]] == [s.sha256 for s in holdout_splits]
    assert [s.index for s in repeated_splits] == list(range(15))
    for protocol, n_splits, expected in (
        (RepeatedHoldout(), 2, 2),
        (RepeatedHoldout(repetitions=7), None, 7),
    ):
        assert len(protocol.splits(samples, n_splits=n_splits, seed=4)) == expected


def test_kfold_tests_every_pose_once_in_folds_of_about_one_size():
    samples = unloaded(23, 2)
    splits = KFold().splits(samples, n_splits=None, seed=0)
    test_rows = np.concatenate([split.test for split in splits])
    np.testing.assert_array_equal(np.sort(test_rows), np.arange(46))
    assert sorted(len(split.test) // 2 for split in splits) == [4, 4, 5, 5, 5]
    for n_splits in (None, 3):
        assert len(KFold(folds=3).splits(samples, n_splits=n_splits, seed=0)) == 3


def test_splits_that_differ_only_in_sensor_errors_have_other_hashes_and_the_same_rows():
    samples = unloaded(10)
    (split,) = Holdout().splits(samples, n_splits=1, seed=0)
    error = np.full((len(split.test), 6), 0.5)
    noisy, noisy_copy = (replace(split, wrench_error=error.copy()) for _ in range(2))
    assert noisy.sha256 == noisy_copy.sha256 != split.sha256 == split.rows_sha256
    assert noisy.rows_sha256 == split.rows_sha256
    np.testing.assert_array_equal(noisy.told_wrench(samples), samples.wrench[split.test] + 0.5)
    np.testing.assert_array_equal(split.told_wrench(samples), samples.wrench[split.test])


def test_paper_holdout_read_on_all_samples_divides_as_before_and_reports_them_all():
    samples = unloaded(151)
    test_splits = PaperHoldout().splits(samples, n_splits=3, seed=4)
    full_splits = PaperHoldout(read_on="all").splits(samples, n_splits=3, seed=4)
    for test_split, full_split in zip(test_splits, full_splits, strict=True):
        assert (
            test_split.rows_sha256
            == full_split.rows_sha256
            == test_split.sha256
            != full_split.sha256
        )
        np.testing.assert_array_equal(full_split.reported, np.arange(151))
        np.testing.assert_array_equal(test_split.reported, test_split.test)
        np.testing.assert_array_equal(full_split.told_wrench(samples), samples.wrench)


def split_of(**changes):
    rows = {"train": np.arange(6), "validation": np.arange(6, 8), "test": np.arange(8, 10)}
    return Split(0, **(rows | changes))


@pytest.mark.parametrize(
    ("splits", "message"),
    [
        ([], "made no split"),
        ([split_of(test=np.array([-1, -2]))], r"split 0 has test rows outside 0\.\.9"),
        ([split_of(test=np.array([9, 10]))], r"test rows outside 0\.\.9"),
        ([split_of(test=np.array([], dtype=int))], "split 0 has no test rows"),
        ([split_of(train=np.array([], dtype=int))], "has no training rows"),
        ([split_of(train=[0, 1])], "training rows that are not a one-dimensional integer array"),
        ([split_of(train=np.array([0.0, 1.0]))], "not a one-dimensional integer array"),
        ([split_of(train=np.array([1, 1]))], "training rows that occur twice"),
        ([split_of(train=np.arange(9))], "trains on 3 rows of its other parts"),
        ([split_of(validation=np.arange(8, 10))], "has 2 test rows that choose an epoch"),
        ([split_of(wrench_error=np.zeros((3, 6)))], r"sensor errors of shape \(3, 6\) for 2"),
        ([split_of(also_reported=np.arange(3))], "reports 3 rows that are not test rows, and the"),
        ([split_of(also_reported=np.arange(9))], "has 1 test rows among the also reported ones"),
        ([split_of(also_reported=np.array([10]))], r"also reported rows outside 0\.\.9"),
        ([split_of(), split_of()], r"condition '' has splits of index \[0, 0\]"),
        ([split_of(condition="a"), replace(split_of(), index=1)], "condition '' has splits of"),
    ],
)
def test_a_split_that_cannot_be_used_or_leaks_is_found(splits, message):
    assert re.search(message, first_fault(splits, 10, selects_on_test=False))


def test_splits_that_keep_the_rules_or_declare_what_they_do_have_no_fault():
    assert first_fault([split_of(), replace(split_of(), index=1)], 10, selects_on_test=False) == ""
    selecting_split = split_of(validation=np.arange(8, 10))
    assert first_fault([selecting_split], 10, selects_on_test=True) == ""
    declarations = {"selects_on_test": False, "reports_training": True}
    reporting_split = split_of(also_reported=np.arange(8))
    assert first_fault([reporting_split], 10, **declarations) == ""
    leaking_split = replace(reporting_split, train=np.arange(9))
    assert "trains on 3 rows" in first_fault([leaking_split], 10, **declarations)


def test_lazy_splits_are_computed_when_they_are_looked_at_and_are_the_same_every_time():
    computed = []

    def make():
        for index in range(4):
            computed.append(index)
            yield replace(split_of(), index=index)

    splits = LazySplits(make, 4)
    assert computed == [0]  # whether the data can be divided
    assert len(splits) == 4 and computed == [0]
    assert splits[1].index == 1 and computed == [0, 0, 1]
    assert splits[-1].index == 3
    assert [split.index for split in splits[1:3]] == [1, 2]
    assert [[split.index for split in splits] for _ in range(2)] == [[0, 1, 2, 3]] * 2
    with pytest.raises(IndexError):
        splits[4]


@pytest.mark.parametrize(
    "protocol", [Holdout(), KFold(), LeaveOneOut(), PaperHoldout(), SampleEfficiency(sizes="5,9")]
)
def test_protocols_say_how_many_splits_they_make(protocol):
    splits = protocol.splits(unloaded(20, 2), n_splits=None, seed=0)
    assert isinstance(splits, LazySplits) and len(splits) == len(list(splits))


@pytest.mark.parametrize(
    ("n_groups", "fraction", "seed"), [(2, 0.5, 0), (7, 0.2, 1), (41, 0.33, 9)]
)
def test_random_divisions_are_those_of_scikit_learn(n_groups, fraction, seed):
    groups = np.random.default_rng(seed).integers(0, n_groups, 120)
    theirs = GroupShuffleSplit(3, test_size=fraction, random_state=seed).split(
        groups, groups=groups
    )
    for ours, expected in zip(group_shuffles(groups, 3, fraction, seed), theirs, strict=True):
        np.testing.assert_array_equal(np.concatenate(ours), np.concatenate(expected))
        np.testing.assert_array_equal(ours[1], expected[1])
