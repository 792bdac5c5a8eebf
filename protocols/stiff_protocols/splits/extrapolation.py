"""Protocols whose test part is unlike the training part on purpose: other poses, other loads.

Random splits ask whether a model can fill gaps between poses that it knows. These ask what happens
beyond them. Each condition has one division of the data; with ``--splits J`` each of J draws
trains on a random part of the training side's poses, so that the spread over training sets shows.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass
from typing import Literal

import numpy as np

from stiff_protocols.contract.errors import ConfigError
from stiff_protocols.contract.protocol_base import EvaluationProtocol
from stiff_protocols.contract.types import FloatArray, IntArray, Samples, Split
from stiff_protocols.splits.generators import LazySplits, divided_inside
from stiff_protocols.splits.random_splits import Fraction

ALL_POSES = ", all training poses"
"""Of a condition that was not repeated with a part of the training poses."""

Division = tuple[str, IntArray, IntArray]
"""Condition, training rows, test rows."""
DECIMALS = 9  # of N, and of directions' components: what differs by less is one load
_NEEDS_GROUPS = "it needs at least two groups of poses, such as joint-space and cartesian"


def _part(samples: Samples, rows: IntArray, fraction: float, rng: np.random.Generator) -> IntArray:
    """Return the rows of a random part of their poses, at least one."""
    poses = np.unique(samples.pose_id[rows])
    kept_poses = rng.permutation(poses)[: max(1, round(fraction * len(poses)))]
    return rows[np.isin(samples.pose_id[rows], kept_poses)]


@dataclass(kw_only=True, eq=False)
class Extrapolation(EvaluationProtocol):
    """Base of the extrapolation protocols: each division is drawn once or several times.

    Both are different conditions: they train on different numbers of poses.

    Attributes:
        train_fraction: share of the training poses, drawn again for each of several splits.
        validation_fraction: share of the training poses that may choose the epoch.
    """

    train_fraction: Fraction = 0.8
    validation_fraction: Fraction = 0.2

    def divisions(self, samples: Samples, seed: int) -> Iterable[Division]:
        """Return every condition with its rows; ConfigError if there is none."""
        raise NotImplementedError

    def splits(self, samples: Samples, *, n_splits: int | None, seed: int) -> Sequence[Split]:
        """Return each division once, or `n_splits` times with a part of its training poses.

        ConfigError: the samples cannot be divided.
        """
        divisions = list(self.divisions(samples, seed))
        repeated = n_splits is not None and n_splits > 1

        def divided() -> Iterator[Split]:
            for index in range(n_splits or 1):
                rng = np.random.default_rng([seed, index])
                for condition, train, test in divisions:
                    if repeated:
                        train = _part(samples, train, self.train_fraction, rng)
                    else:
                        condition = f"{condition}{ALL_POSES}"
                    yield divided_inside(
                        samples, index, train, test, self.validation_fraction, seed, condition
                    )

        return LazySplits(divided, (n_splits or 1) * len(divisions))


@dataclass(kw_only=True, eq=False)
class SpaceTransfer(Extrapolation):
    """Train on one group of the measurement plan, test on the others, and the other way round."""

    def divisions(self, samples: Samples, seed: int) -> list[Division]:
        """Return a condition for each group that is trained on; ConfigError for fewer than two."""
        groups = list(dict.fromkeys(samples.group.tolist()))
        if len(groups) < 2:
            raise ConfigError(
                f"space-transfer: all samples are of group {groups[0]!r}; {_NEEDS_GROUPS}"
            )
        divisions = []
        for group in groups:
            other_groups = " + ".join(other_group for other_group in groups if other_group != group)
            inside = samples.group == group
            # a pose that two groups share is left out of the training part
            shared = np.isin(samples.pose_id, samples.pose_id[~inside])
            train = np.flatnonzero(inside & ~shared)
            if len(train):
                divisions.append((f"{group} -> {other_groups}", train, np.flatnonzero(~inside)))
        if not divisions:
            raise ConfigError(
                f"space-transfer: every pose stands in several of the groups {', '.join(groups)}; "
                f"{_NEEDS_GROUPS}"
            )
        return divisions


@dataclass(kw_only=True, eq=False)
class LoadExtrapolation(Extrapolation):
    """Train on light loads, test on heavy ones; train on some directions, test on others.

    Attributes:
        by: "size" of the force, "direction" of the force, or "both", one condition each.
        test_fraction: of the samples: those with the heaviest forces, or with the directions
            farthest along the line on which the directions differ most. More, where more share
            the largest value.
    """

    by: Literal["size", "direction", "both"] = "both"
    test_fraction: Fraction = 0.3

    def divisions(self, samples: Samples, seed: int) -> Iterator[Division]:
        """Yield one condition or both; ConfigError if the samples' loads do not differ.

        A pose with loads on both sides keeps the loads of one side, which is drawn.
        """
        force = samples.wrench[:, :3]
        if self.by != "direction":
            yield self._divided(
                samples, "light -> heavy loads", np.linalg.norm(force, axis=1), seed
            )
        if self.by != "size":
            yield self._divided(samples, "other directions", _along(force), seed)

    def _divided(
        self, samples: Samples, condition: str, measure: FloatArray, seed: int
    ) -> Division:
        """Return the rows below and above the quantile, no pose on both sides."""
        measure = measure.round(DECIMALS)
        different = np.unique(measure)
        if len(different) < 2:
            raise ConfigError(
                f"load-extrapolation: {condition}: the samples' loads do not differ (use by=size "
                "or by=direction for only one condition)"
            )
        beyond = measure > min(np.quantile(measure, 1.0 - self.test_fraction), different[-2])
        torn = np.intersect1d(samples.pose_id[beyond], samples.pose_id[~beyond])
        drawn = np.random.default_rng(seed).permutation(torn)
        of_torn = np.isin(samples.pose_id, torn)
        of_tested = np.isin(samples.pose_id, drawn[: (len(drawn) + 1) // 2])
        train = ~beyond & ~of_tested
        test = beyond & (~of_torn | of_tested)
        if not train.any() or not test.any():
            raise ConfigError(f"load-extrapolation: {condition}: too few poses to part the loads")
        return condition, np.flatnonzero(train), np.flatnonzero(test)


def _along(force: FloatArray) -> FloatArray:
    """Return where (n, 3) forces point along the first principal axis of all directions."""
    size = np.linalg.norm(force, axis=1, keepdims=True)
    directions = np.divide(force, size, out=np.zeros_like(force), where=size > 0.0)
    centred = directions - directions.mean(axis=0)
    _, _, axes = np.linalg.svd(centred, full_matrices=False)
    # the sign of a principal axis is arbitrary: its largest component points upwards
    axis = axes[0] * np.sign(axes[0][np.argmax(np.abs(axes[0]))])
    return np.asarray(centred @ axis)
