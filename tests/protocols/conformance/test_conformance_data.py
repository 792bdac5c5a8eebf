"""The conformance suite for data sets and protocols."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from stiff_datasets.measured.fanuc_r2000ic import FanucR2000iC
from stiff_datasets.twin.kr10_twin import Kr10Twin
from stiff_protocols.catalog import PROTOCOLS
from stiff_protocols.conformance.data import check_dataset, check_protocol
from stiff_protocols.contract.types import BenchmarkData, Split
from stiff_protocols.splits.extrapolation import SpaceTransfer
from stiff_protocols.splits.random_splits import Holdout


@pytest.fixture(scope="module")
def data() -> BenchmarkData:
    return FanucR2000iC().load()


@pytest.fixture(scope="module")
def twin() -> BenchmarkData:
    return Kr10Twin().load()


def by_name(make, data):
    return {check.name: check for check in check_protocol(make, data)}


@pytest.mark.parametrize("info", PROTOCOLS, ids=lambda info: info.key)
def test_the_shipped_protocols_keep_the_contract_and_part_no_pose(info, twin):
    checks = by_name(info.load(), twin)
    assert [str(check) for check in checks.values() if check.status == "failed"] == []
    assert checks["no pose is parted"].status == "passed"
    assert (checks["sensor errors are those of the test rows"].status == "passed") == (
        info.key == "sensor-noise"
    )


def test_a_protocol_that_cannot_divide_a_data_set_says_so_once(data):
    checks = check_protocol(SpaceTransfer, data)
    (failed,) = (check for check in checks if check.status == "failed")
    assert "all samples are of group 'all'" in failed.reason and "--dataset KEY" in failed.advice
    assert {check.reason for check in checks if check is not failed} == {"splits failed"}


def test_a_protocol_that_trains_on_test_rows_or_by_chance_fails(data):
    class Careless(Holdout):
        def splits(self, samples, *, n_splits, seed):
            order = np.random.default_rng().permutation(len(samples))
            return [Split(0, order[:30], order[:0], order[20:40])]

    checks = by_name(Careless, data)
    assert checks["no row is learned from and tested"].reason == (
        "split 0 trains on 10 rows of its other parts"
    )
    assert checks["the same seed gives the same splits"].reason == "the same seed gave other splits"
    assert checks["every row is used"].reason == "leaves out 3 of 43 rows"


class ByRow(Holdout):
    """One row in five is tested; what a test changes is an attribute of a subclass."""

    def splits(self, samples, *, n_splits, seed):
        rows = np.arange(len(samples))
        return [Split(0, rows[rows % 5 > 0], rows[:0], rows[rows % 5 == 0])]


def test_a_protocol_that_parts_poses_is_warned_of(data):
    parted = by_name(ByRow, data)["no pose is parted"]
    assert parted.status == "not applicable"
    assert parted.reason.startswith("warning: 1 of 1 splits test a pose that was trained on")


def test_a_protocol_without_splits_fails(data):
    class Nothing(Holdout):
        def splits(self, samples, *, n_splits, seed):
            return []

    assert by_name(Nothing, data)["splits name existing rows"].reason == "there are no splits"


def test_a_protocol_that_divides_by_deflections_fails(data):
    class ByDeflection(Holdout):
        def splits(self, samples, *, n_splits, seed):
            order = np.argsort(samples.deflection[:, 2])
            return [Split(0, order[10:], order[:0], order[:10])]

    check = by_name(ByDeflection, data)["the division does not look at deflections"]
    assert (check.status, check.reason) == ("failed", "other deflections gave other splits")


@pytest.mark.parametrize("shape", [(1, 6), (9, 3)])
def test_sensor_errors_of_another_shape_than_the_test_rows_fail(shape, data):
    class Erring(ByRow):
        def splits(self, samples, **how):
            (split,) = super().splits(samples, **how)
            return [replace(split, condition="loud", wrench_error=np.ones(shape))]

    check = by_name(Erring, data)["sensor errors are those of the test rows"]
    assert check.status == "failed"
    assert f"loud | split 0 has sensor errors of shape {shape} for 9 test rows" in check.reason


@pytest.mark.parametrize("indices", [(0, 0), (1, 2)])
def test_splits_of_a_condition_that_are_not_numbered_from_0_fail(indices, data):
    class Numbered(ByRow):
        def splits(self, samples, **how):
            (split,) = super().splits(samples, **how)
            return [replace(split, index=index, condition="c") for index in indices]

    check = by_name(Numbered, data)["splits are told apart"]
    assert check.status == "failed"
    assert check.reason == f"condition 'c' has splits of index {list(indices)}"


def test_a_data_set_in_mm_or_of_chance_fails(data):
    class Loads:
        factor = 1.0

        def load(self):
            s = data.samples
            parts = (s.pose_id, s.load_id, s.group)
            shaken = s.wrench * np.random.default_rng().uniform()
            return BenchmarkData(
                type(s)(s.q, shaken, s.deflection * self.factor, *parts), data.robot
            )

    class InMillimetres(Loads):
        factor = 1000.0

    assert all(check.status == "passed" for check in check_dataset(FanucR2000iC))
    chance, units = check_dataset(Loads)
    assert (chance.status, units.status) == ("failed", "passed")
    assert "is it in mm?" in check_dataset(InMillimetres)[1].reason
