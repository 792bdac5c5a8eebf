"""`cross-robot`: transfer of a network that was pre-trained for another robot."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

from stiff_protocols.contract.types import Samples, Split
from stiff_protocols.splits.generators import LazySplits
from stiff_protocols.splits.random_splits import Holdout

OWN_SOURCE = "own source"
"""Condition with the target's own source, as under `holdout`, with different seeds."""


@dataclass(kw_only=True, eq=False)
class CrossRobot(Holdout):
    """`holdout` twice on the same rows: with the target's own source, and with a foreign one.

    A simulated source domain needs joint stiffnesses. Usually a VJM identifies them on the training
    part. Here they come from another robot's or specimen's VJM, identified on all of its samples,
    with its kinematics, poses and loads. Fine-tuning always uses the training part.

    Attributes:
        source: data set of the other robot or specimen, as for --dataset; double its @ if this
            option is part of a word (cross-robot@source=kr10-twin@@specimen=3).
    """

    source: str = "kr10-twin@specimen=9"

    def source_datasets(self) -> Sequence[str]:
        """Return the foreign source."""
        return (self.source,)

    def splits(self, samples: Samples, *, n_splits: int | None, seed: int) -> LazySplits:
        """Return `n_splits` (default 1) divisions, `holdout`'s of the same seed, under both."""

        def under_both(division: Split) -> Sequence[Split]:
            foreign = replace(division, condition=f"source {self.source}", source=self.source)
            return replace(division, condition=OWN_SOURCE), foreign

        return super().splits(samples, n_splits=n_splits, seed=seed).expanded(under_both, 2)
