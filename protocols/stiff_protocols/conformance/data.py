"""The conformance suite for data sets and protocols."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import replace
from functools import cached_property, partial

import numpy as np

from stiff_protocols.conformance.checklist import (
    Check,
    Checklist,
    Failed,
    NotApplicable,
    StageFailed,
)
from stiff_protocols.contract.errors import StiffBenchError
from stiff_protocols.contract.interfaces import StiffnessDataset
from stiff_protocols.contract.protocol_base import completed
from stiff_protocols.contract.types import PATH_GROUP, BenchmarkData, Samples, Split
from stiff_protocols.splits.checks import (
    fault_of_numbers,
    fault_of_rows,
    fault_of_sensor_errors,
    leak_of,
    named,
)

LARGEST_WRENCH = 1e5  # N or N m; the largest robots carry some 2e4 N
LARGEST_ANGLE = 8.0 * np.pi  # rad; a joint turns a few times at most, and 90 deg is more
MOST_UNEXPLAINED = 0.5  # of the squared deflection, by a robot that answers new poses
SMALLEST_DEFLECTION, LARGEST_DEFLECTION = 1e-9, 1.0  # m

MakeDataset = Callable[[], StiffnessDataset]
_DATASET = Checklist()


def check_dataset(make: MakeDataset) -> list[Check]:
    """Check what a data set loads, twice; `make` returns a new one with its options."""
    return _DATASET.answers(LoadedData(make))


class LoadedData:
    """What a data set loads, once for all questions but the one that loads it again."""

    def __init__(self, make: MakeDataset) -> None:
        self._make = make

    @cached_property
    def data(self) -> BenchmarkData:
        """The first that it loaded."""
        return self.again()

    def again(self) -> BenchmarkData:
        """Return what a new one loads."""
        data = self._make().load()
        if not isinstance(data, BenchmarkData):
            raise Failed(f"load returned {type(data).__name__}, expected BenchmarkData")
        return data


@_DATASET.asks(
    "loading twice gives the same samples",
    "draw all chance from an option `seed`, and return BenchmarkData(samples, robot)",
)
def _same_numbers(loaded: LoadedData) -> str:
    first, second = loaded.data, loaded.again()
    if first.sha256 != second.sha256:
        raise Failed(f"sha256 {first.sha256[:12]} and {second.sha256[:12]}")
    return f"{len(first.samples)} samples of {first.robot.name}, sha256 {first.sha256[:12]}"


@_DATASET.asks("values are in rad, N, N m and m", "convert units where the file is read")
def _plausible_units(loaded: LoadedData) -> str:
    """Look at sizes: values in deg or mm are too large, in km too small."""
    data = loaded.data
    angle = float(np.abs(data.samples.q[:, data.robot.turns]).max(initial=0.0))
    wrench = float(np.abs(data.samples.wrench).max(initial=0.0))
    deflection = float(np.abs(data.samples.deflection).max(initial=0.0))
    if angle > LARGEST_ANGLE:
        raise Failed(f"a joint angle of {angle:g} rad; is it in deg?")
    if wrench > LARGEST_WRENCH:
        raise Failed(f"a wrench component of {wrench:g} N or N m")
    if not SMALLEST_DEFLECTION <= deflection <= LARGEST_DEFLECTION:
        raise Failed(f"the largest deflection is {deflection:g} m; is it in mm?")
    return f"wrench up to {wrench:.3g} N or N m, deflection up to {1e3 * deflection:.3g} mm"


@_DATASET.asks(
    "a robot that answers new poses is the one that was measured",
    "under_load(q, wrench) returns the (n, 3) deflection [m] of that robot, the same at each call",
)
def _answers(loaded: LoadedData) -> str:
    """Ask it for the measured poses: what is not noise must come back."""
    data = loaded.data
    if data.under_load is None:
        raise NotApplicable("answers no new poses")
    q, wrench, measured = data.samples.q, data.samples.wrench, data.samples.deflection
    first, second = (np.asarray(data.under_load(q, wrench)) for _ in range(2))
    if first.shape != measured.shape or not np.isfinite(first).all():
        raise Failed(f"shape {first.shape}, expected {measured.shape} finite numbers")
    if not np.array_equal(first, second):
        raise Failed("the same poses gave other deflections")
    share = float(np.sum((measured - first) ** 2) / np.sum(measured**2))
    if share > MOST_UNEXPLAINED:
        raise Failed(f"{share:.0%} of the squared deflection is not explained by its answers")
    return f"{share:.1%} of the squared deflection is not in its answers"


_PROTOCOL = Checklist()


class DividedRows:
    """A protocol, and a small data set that it prepares and divides."""

    def __init__(self, make: Callable[[], object], data: BenchmarkData) -> None:
        self._data, self.protocol = data, completed(make())

    @cached_property
    def samples(self) -> Samples:
        """The samples that are divided, as the protocol prepared them; StageFailed: it cannot."""
        with _stage("prepared", "whose robot answers new poses"):
            return self.protocol.prepared(self._data).samples

    @cached_property
    def splits(self) -> Sequence[Split]:
        """The divisions of these samples."""
        return self.divide(self.samples)

    def divide(self, samples: Samples) -> Sequence[Split]:
        """Return the divisions of these samples or others; StageFailed where there are none."""
        with _stage("splits", "that it can divide"):
            return self.protocol.splits(samples, n_splits=None, seed=0)


@contextmanager
def _stage(name: str, needs: str) -> Iterator[None]:
    """Make an error a failed stage; one of ours says that the data set is not one that it needs."""
    try:
        yield
    except StiffBenchError as error:
        advice = f"check it on a data set {needs} (--dataset KEY)"
        raise StageFailed(name, Failed(str(error), advice)) from error
    except (Exception, SystemExit) as error:
        raise StageFailed(name, error) from error


def check_protocol(make: Callable[[], object], data: BenchmarkData) -> list[Check]:
    """Check how a protocol divides samples; `make` returns a new one with its options."""
    return _PROTOCOL.answers(DividedRows(make, data))


@_PROTOCOL.asks(
    "splits name existing rows", "return Split(index, train, validation, test) with row numbers"
)
def _rows_exist(divided: DividedRows) -> str:
    """See that every part holds row numbers, and training and test part some."""
    splits = divided.splits
    if not splits:
        raise Failed("there are no splits")
    _have_none(splits, lambda split: fault_of_rows(split, len(divided.samples)))
    return f"{len(splits)} splits"


def _have_none(splits: Iterable[Split], fault_of: Callable[[Split], str]) -> None:
    for split in splits:
        if fault := fault_of(split):
            raise Failed(f"{named(split)} {fault}")


@_PROTOCOL.asks("splits have different indices", "number the splits of each condition 0, 1, 2, ...")
def _told_apart(divided: DividedRows) -> str:
    splits = divided.splits
    if fault := fault_of_numbers((split.condition, split.index) for split in splits):
        raise Failed(fault)
    conditions = {split.condition for split in splits}
    return f"{len(conditions)} conditions" if len(conditions) > 1 else ""


@_PROTOCOL.asks(
    "no row is learned from and tested",
    "keep the parts disjoint, or set selects_on_test = True if test rows choose the epoch, "
    "reports_training = True if training rows are reported",
)
def _disjoint(divided: DividedRows) -> None:
    selects, reports = divided.protocol.selects_on_test, divided.protocol.reports_training
    leaks = partial(leak_of, selects_on_test=selects, reports_training=reports)
    _have_none(divided.splits, leaks)


@_PROTOCOL.asks(
    "sensor errors are those of the test rows", "give wrench_error the shape (n_test, 6), N and N m"
)
def _sensor_errors_fit(divided: DividedRows) -> str:
    erring = [split for split in divided.splits if split.wrench_error is not None]
    _have_none(erring, fault_of_sensor_errors)
    if not erring:
        raise NotApplicable("adds no sensor errors")
    return f"{len(erring)} splits with sensor errors"


@_PROTOCOL.asks(
    "tool paths are tested and never learned from", "give the rows of PATH_GROUP to the test part"
)
def _paths_are_tested(divided: DividedRows) -> str:
    splits = divided.splits
    points = np.flatnonzero(divided.samples.group == PATH_GROUP)
    if not len(points):
        raise NotApplicable("adds no tool paths")
    for split in splits:
        if not np.array_equal(np.sort(split.reported), points):
            raise Failed(f"{named(split)} reports other rows than the {len(points)} path points")
    return f"{len(points)} points of {len(np.unique(divided.samples.pose_id[points]))} paths"


@_PROTOCOL.asks("every row is used", "return splits that can be concatenated")
def _covers(divided: DividedRows) -> None:
    used = [rows for s in divided.splits for rows in (s.train, s.validation, s.test)]
    left_out = len(divided.samples) - len(np.unique(np.concatenate(used)))
    if left_out:
        raise NotApplicable(f"leaves out {left_out} of {len(divided.samples)} rows")


@_PROTOCOL.asks("the same seed gives the same splits", "draw all chance from `seed`")
def _same_splits(divided: DividedRows) -> None:
    first, second = _hashes(divided.splits), _hashes(divided.divide(divided.samples))
    if first != second:
        raise Failed("the same seed gave other splits")


@_PROTOCOL.asks(
    "the division does not look at deflections", "divide by poses, loads and groups alone"
)
def _blind_to_deflections(divided: DividedRows) -> None:
    """Divide the same samples with each other's deflections."""
    turned = replace(divided.samples, deflection=divided.samples.deflection[::-1])
    if _hashes(divided.splits) != _hashes(divided.divide(turned)):
        raise Failed("other deflections gave other splits")


@_PROTOCOL.asks("no pose is parted", "divide by samples.pose_id")
def _keeps_poses(divided: DividedRows) -> None:
    """Divide the same samples named as two loads a pose; points of tool paths keep their path."""
    samples = divided.samples
    pairs = np.array([f"P{row // 2}" for row in range(len(samples))])
    pose_id = np.where(samples.group == PATH_GROUP, samples.pose_id, pairs)
    splits = divided.divide(replace(samples, pose_id=pose_id))
    selects = divided.protocol.selects_on_test  # its validation rows are test rows, as it says
    learned = [s.train if selects else np.r_[s.train, s.validation] for s in splits]
    parted = sum(
        bool(np.isin(pose_id[rows], pose_id[split.test]).any())
        for rows, split in zip(learned, splits, strict=True)
    )
    if parted:
        raise NotApplicable(
            f"warning: {parted} of {len(splits)} splits test a pose that was trained on; such "
            "results are optimistic where a pose has several loads"
        )


def _hashes(splits: Sequence[Split]) -> list[tuple[str, str]]:
    return [(split.condition, split.sha256) for split in splits]
