"""Protocols that divide the poses at random: every test pose is like the training poses."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Iterator
from dataclasses import dataclass, replace
from functools import partial
from typing import Annotated, Literal

import numpy as np
from annotated_types import Ge, Gt, Lt

from stiff_protocols.contract.errors import ConfigError
from stiff_protocols.contract.protocol_base import EvaluationProtocol
from stiff_protocols.contract.types import Samples, Split
from stiff_protocols.splits.generators import (
    Division,
    LazySplits,
    divided_inside,
    group_shuffles,
    indivisible,
)

Fraction = Annotated[float, Gt(0.0), Lt(1.0)]


@dataclass(kw_only=True, eq=False)
class Holdout(EvaluationProtocol):
    """Random 80/20 division by pose; a fifth of the training side may choose the epoch.

    By default networks choose it by cross-validation and learn from the whole training side.

    Attributes:
        test_fraction: of all poses.
        validation_fraction: of the training side's poses, may choose the epoch.
    """

    test_fraction: Fraction = 0.2
    validation_fraction: Fraction = 0.2

    def splits(self, samples: Samples, *, n_splits: int | None, seed: int) -> LazySplits:
        """Return `n_splits` (default 1) divisions."""
        return _shuffled(samples, n_splits, self.test_fraction, self.validation_fraction, seed)


@dataclass(kw_only=True, eq=False)
class RepeatedHoldout(Holdout):
    """`holdout` drawn many times, enough for a corrected t test.

    Attributes:
        repetitions: number of splits; --splits overrides it.
    """

    repetitions: Annotated[int, Ge(2)] = 15

    def splits(self, samples: Samples, *, n_splits: int | None, seed: int) -> LazySplits:
        """Return the divisions; the first ones are `holdout`'s of the same seed."""
        return super().splits(samples, n_splits=n_splits or self.repetitions, seed=seed)


@dataclass(kw_only=True, eq=False)
class KFold(EvaluationProtocol):
    """Poses in k parts of about one size; each part is tested by models of the others.

    Attributes:
        folds: number of folds; --splits cannot change it.
        validation_fraction: of the training side's poses, may choose the epoch.
    """

    folds: Annotated[int, Ge(2)] = 5
    validation_fraction: Fraction = 0.2

    def splits(self, samples: Samples, *, n_splits: int | None, seed: int) -> LazySplits:
        """Return one division per part; ConfigError for another number or too few poses."""
        if n_splits not in (None, self.folds):
            raise ConfigError(
                f"{n_splits}: kfold has {self.folds} splits, one per fold; omit this option, "
                f"or use kfold@folds={n_splits}",
                "splits",
            )
        from sklearn.model_selection import GroupKFold  # slow, and only this protocol needs it

        n_poses = len(np.unique(samples.pose_id))
        if self.folds > n_poses:
            reason = f"(valid: 2 to {n_poses})" if n_poses > 1 else "needs as many poses"
            raise indivisible(samples, f"folds={self.folds} {reason}")
        splitter = GroupKFold(self.folds, shuffle=True, random_state=seed)
        divide = partial(splitter.split, samples.q, groups=samples.pose_id)
        return _divided_by(divide, self.folds, samples, self.validation_fraction, seed)


@dataclass(kw_only=True, eq=False)
class PaperHoldout(EvaluationProtocol):
    """The source paper's division: 80/20 by pose, and the 20 % also picks the best epoch.

    Attributes:
        test_fraction: of all poses.
        read_on: reported rows: "test", or "all" for the same fits on all samples, as most likely in
            the source paper's Table 10. Four fifths of these are training samples, so "all" is not
            a test.
    """

    selects_on_test = True
    added_later = ("read_on",)

    test_fraction: Fraction = 0.2
    read_on: Literal["test", "all"] = "test"

    @property
    def reports_training(self) -> bool:  # type: ignore[override]  # read only
        """True if training rows are reported with the test rows."""
        return self.read_on == "all"

    def splits(self, samples: Samples, *, n_splits: int | None, seed: int) -> LazySplits:
        """Return `n_splits` (default 1) divisions, the same ones for either reading."""
        divisions = _shuffled(samples, n_splits, self.test_fraction, None, seed)
        if not self.reports_training:
            return divisions
        return divisions.expanded(lambda split: [replace(split, also_reported=split.train)])


@dataclass(kw_only=True, eq=False)
class LeaveOneOut(EvaluationProtocol):
    """Each pose is tested once; the metrics are computed over the predictions of all poses.

    Attributes:
        validation_fraction: of the training side's poses, may choose the epoch.
    """

    pooled = True

    validation_fraction: Fraction = 0.2

    def splits(self, samples: Samples, *, n_splits: int | None, seed: int) -> LazySplits:
        """Return one division per pose, in the order of the poses' first rows.

        Raises:
            ConfigError: a number of splits was given, or there are too few poses.
        """
        if n_splits is not None:
            raise ConfigError(
                f"{n_splits}: leave-one-out has one split per pose; omit this option", "splits"
            )
        _, first_rows, pose = np.unique(samples.pose_id, return_index=True, return_inverse=True)
        if len(first_rows) < 2:
            raise indivisible(samples, "leave-one-out needs two poses")

        def left_out() -> Iterator[Division]:
            for first_row in np.sort(first_rows):
                tested = first_rows[pose] == first_row
                yield np.flatnonzero(~tested), np.flatnonzero(tested)

        return _divided_by(left_out, len(first_rows), samples, self.validation_fraction, seed)


def _shuffled(
    samples: Samples,
    n_splits: int | None,
    test_fraction: float,
    validation_fraction: float | None,
    seed: int,
) -> LazySplits:
    """Return `n_splits` (default 1) random divisions; ConfigError for too few poses."""
    n_poses = len(np.unique(samples.pose_id))
    if math.ceil(test_fraction * n_poses) >= n_poses:
        reason = f"leaves no pose to learn from (valid: at most {n_poses - 1}/{n_poses})"
        reason = reason if n_poses > 1 else "needs two poses"
        raise indivisible(samples, f"test_fraction={test_fraction:g} {reason}")
    n_divisions = n_splits or 1
    divide = partial(group_shuffles, samples.pose_id, n_divisions, test_fraction, seed)
    return _divided_by(divide, n_divisions, samples, validation_fraction, seed)


def _divided_by(
    divide: Callable[[], Iterable[Division]],
    n_divisions: int,
    samples: Samples,
    validation_fraction: float | None,
    seed: int,
) -> LazySplits:
    """Return the divisions that `divide` gives, each with a validation part.

    Without a `validation_fraction` of the training poses, the test rows are the validation rows.
    """

    def divided() -> Iterator[Split]:
        for index, (train, test) in enumerate(divide()):
            if validation_fraction is None:
                yield Split(index, np.sort(train), np.sort(test), np.sort(test))
            else:
                yield divided_inside(samples, index, train, test, validation_fraction, seed)

    return LazySplits(divided, n_divisions)
