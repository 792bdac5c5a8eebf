"""Checks of a data set and of a protocol."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace

import numpy as np

from stiff_protocols.conformance.checks import Check, Failed, NotApplicable, remembered, run_checks
from stiff_protocols.contract.errors import StiffBenchError
from stiff_protocols.contract.protocol_base import completed
from stiff_protocols.contract.types import (
    PATH_GROUP,
    BenchmarkData,
    Samples,
    Split,
    StiffnessDataset,
)
from stiff_protocols.splits.checks import first_fault, named, pose_numbers

LARGEST_WRENCH = 1e5  # N or N m; the largest robots carry some 2e4 N
LARGEST_ANGLE = 8.0 * np.pi  # rad; a joint turns a few times at most, and 90 deg is more
MOST_UNEXPLAINED = 0.5  # of the squared deflection, by a robot that answers new poses
SMALLEST_DEFLECTION, LARGEST_DEFLECTION = 1e-9, 1.0  # m


def check_dataset(make: Callable[[], StiffnessDataset]) -> list[Check]:
    """Check the data of a data set, loaded twice; `make` returns a new data set."""
    return run_checks(DatasetChecks(make))


def check_protocol(make: Callable[[], object], data: BenchmarkData) -> list[Check]:
    """Check a protocol's splits of samples; `make` returns a new protocol."""
    return run_checks(ProtocolChecks(make, data))


class DatasetChecks:
    """The checks of a data set, in their order."""

    def __init__(self, make: Callable[[], StiffnessDataset]) -> None:
        self._make = make

    @remembered
    def _loaded(self, time: str = "first") -> BenchmarkData:
        """Return the data of a new data set."""
        data = self._make().load()
        if not isinstance(data, BenchmarkData):
            raise Failed(f"load returned {type(data).__name__}, expected BenchmarkData")
        return data

    def loading_twice_gives_the_same_samples(self) -> str:
        """Draw all random numbers from an option `seed`; return BenchmarkData(samples, robot)."""
        first, second = self._loaded(), self._loaded("second")
        if first.sha256 != second.sha256:
            raise Failed(f"sha256 {first.sha256[:12]} and {second.sha256[:12]}")
        return f"{len(first.samples)} samples of {first.robot.name}, sha256 {first.sha256[:12]}"

    def values_are_in_rad_N_Nm_and_m(self) -> str:
        """Convert units when the file is read."""
        samples, turns = self._loaded().samples, self._loaded().robot.turns
        angle, wrench, deflection = (
            float(np.abs(values).max(initial=0.0))
            for values in (samples.q[:, turns], samples.wrench, samples.deflection)
        )
        if angle > LARGEST_ANGLE:
            raise Failed(f"a joint angle of {angle:g} rad; check that it is not in deg")
        if wrench > LARGEST_WRENCH:
            raise Failed(f"a wrench component of {wrench:g} N or N m")
        if not SMALLEST_DEFLECTION <= deflection <= LARGEST_DEFLECTION:
            raise Failed(f"the largest deflection is {deflection:g} m; check that it is not in mm")
        return f"wrench up to {wrench:.3g} N or N m, deflection up to {1e3 * deflection:.3g} mm"

    def a_pose_has_one_name(self) -> str:
        """Give the rows of a pose one pose_id; whole turns of a joint are the same pose."""
        samples, robot = self._loaded().samples, self._loaded().robot
        poses, of_row = np.unique(pose_numbers(samples.q, robot), axis=0, return_inverse=True)
        pairs = {*zip(of_row.ravel().tolist(), samples.pose_id.tolist(), strict=True)}
        if len(pairs) > len(poses):
            raise NotApplicable(
                f"warning: {len(poses)} different joint positions have {len(pairs)} names; a split "
                "may put one pose on both sides"
            )
        return f"{len({*samples.pose_id.tolist()})} poses"

    def a_robot_that_answers_new_poses_is_the_one_that_was_measured(self) -> str:
        """Return the same robot's (n, 3) deflection [m] from each under_load(q, wrench)."""
        samples, under_load = self._loaded().samples, self._loaded().under_load
        if under_load is None:
            raise NotApplicable("does not measure new poses")
        measured = samples.deflection
        first, second = (np.asarray(under_load(samples.q, samples.wrench)) for _ in range(2))
        if first.shape != measured.shape or not np.isfinite(first).all():
            raise Failed(f"shape {first.shape}, expected {measured.shape} finite numbers")
        if not np.array_equal(first, second):
            raise Failed("the same poses gave different deflections")
        share = float(np.sum((measured - first) ** 2) / np.sum(measured**2))
        if share > MOST_UNEXPLAINED:
            raise Failed(f"{share:.0%} of the squared deflection is not explained by its answers")
        return f"{share:.1%} of the squared deflection is not in its answers"


class ProtocolChecks:
    """The checks of a protocol, in their order, on a small data set prepared by it."""

    def __init__(self, make: Callable[[], object], data: BenchmarkData) -> None:
        self._data, self._protocol = data, completed(make())

    @remembered
    def _samples(self) -> Samples:
        """Return the samples to divide, as prepared by the protocol."""
        try:
            return self._protocol.prepared(self._data).samples
        except StiffBenchError as error:
            raise _other_data(error, "whose robot answers new poses") from error

    @remembered
    def _splits(self) -> Sequence[Split]:
        return self._divide(self._samples())

    def _divide(self, samples: Samples) -> Sequence[Split]:
        """Return the splits of any samples."""
        try:
            return self._protocol.splits(samples, n_splits=None, seed=0)
        except StiffBenchError as error:
            raise _other_data(error, "that it can divide") from error

    def _hashes(self, samples: Samples) -> list[tuple[str, str]]:
        """Return condition and hash of each split of these samples."""
        self._splits()
        return [(split.condition, split.sha256) for split in self._divide(samples)]

    def splits_are_those_that_a_run_accepts(self) -> str:
        """Return Split(index, train, validation, test) with disjoint arrays of row numbers.

        Number the splits of each condition 0, 1, 2, ... Set selects_on_test = True if test rows
        choose the epoch, reports_training = True if training rows are reported. Give wrench_error
        the shape (n_test, 6), N and N m.
        """
        splits, protocol = self._splits(), self._protocol
        if fault := first_fault(
            splits,
            len(self._samples()),
            selects_on_test=protocol.selects_on_test,
            reports_training=protocol.reports_training,
        ):
            raise Failed(fault)
        return f"{len(splits)} splits of {len({split.condition for split in splits})} conditions"

    def tool_paths_are_tested_and_never_learned_from(self) -> str:
        """Give the rows of PATH_GROUP to the test part."""
        splits, samples = self._splits(), self._samples()
        points = np.flatnonzero(samples.group == PATH_GROUP)
        if not len(points):
            raise NotApplicable("does not add tool paths")
        for split in splits:
            if not np.array_equal(np.sort(split.reported), points):
                raise Failed(
                    f"{named(split)} reports other rows than the {len(points)} path points"
                )
        return f"{len(points)} points of {len(np.unique(samples.pose_id[points]))} paths"

    def the_same_seed_gives_the_same_splits(self) -> None:
        """Draw all random numbers from `seed`."""
        if self._hashes(self._samples()) != self._hashes(self._samples()):
            raise Failed("the same seed gave different splits")

    def the_division_does_not_look_at_deflections(self) -> None:
        """Divide only by poses, loads and groups."""
        samples = self._samples()
        turned = replace(samples, deflection=samples.deflection[::-1])
        if self._hashes(samples) != self._hashes(turned):
            raise Failed("other deflections gave different splits")

    def no_pose_is_parted(self) -> None:
        """Divide by samples.pose_id."""
        self._splits()
        samples = self._samples()  # renamed to two loads per pose, except points of tool paths
        pairs = np.array([f"P{row // 2}" for row in range(len(samples))])
        pose_id = np.where(samples.group == PATH_GROUP, samples.pose_id, pairs)
        splits = self._divide(replace(samples, pose_id=pose_id))
        selects = self._protocol.selects_on_test  # its validation rows are test rows, as it says
        learned = [s.train if selects else np.r_[s.train, s.validation] for s in splits]
        parted = sum(
            bool(np.isin(pose_id[rows], pose_id[split.test]).any())
            for rows, split in zip(learned, splits, strict=True)
        )
        if parted:
            raise NotApplicable(
                f"warning: {parted} of {len(splits)} splits test a pose that was trained on; such "
                "results are optimistic if a pose has several loads"
            )


def _other_data(error: StiffBenchError, needs: str) -> Failed:
    return Failed(str(error), f"check it on a data set {needs} (--dataset KEY)")
