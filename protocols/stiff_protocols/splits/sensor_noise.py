"""`sensor-noise`: what becomes of predictions when the force sensor errs?"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, replace
from typing import Annotated

import numpy as np
from annotated_types import Ge

from stiff_protocols.contract.types import FloatArray, Samples, Split
from stiff_protocols.splits.generators import LazySplits, numbers_in
from stiff_protocols.splits.random_splits import Holdout

SENSOR = (0.04, 0.04, 0.04, 0.002, 0.002, 0.002)
"""N and N m: the figures of the ATI Axia80-M8 in the source paper."""

NonNegative = Annotated[float, Ge(0.0)]


@dataclass(kw_only=True, eq=False)
class SensorNoise(Holdout):
    """`holdout` with test wrenches of a force sensor with noise and bias.

    Models learn from clean wrenches and predict with wrong wrenches; the measured deflections
    belong to the true wrenches. A level is a multiple of the sensor's figures, 0.04 N and
    0.002 N m. These are standard deviations of the noise (Gaussian, independent between samples)
    and of the bias (one draw per split). All levels of a split have the same draws, and so the same
    fit and paired results. The errors are isotropic, so the sensor's frame does not matter. They
    act at the TCP, not at the flange, which is a simplification: a force error at the flange would
    also be a torque error at the TCP.

    Attributes:
        levels: multiples of the sensor's figures, separated by commas.
        noise: factor on the noise; 0: only bias.
        bias: factor on the bias; 0: only noise.
    """

    levels: str = "0,1,5,20"
    noise: NonNegative = 1.0
    bias: NonNegative = 1.0

    def splits(self, samples: Samples, *, n_splits: int | None, seed: int) -> LazySplits:
        """Return `n_splits` (default 1) divisions, `holdout`'s of the same seed, at every level."""
        requested_levels = numbers_in("sensor-noise.levels", self.levels, float, fewest=0)
        levels = sorted({level + 0.0 for level in requested_levels})  # -0.0 is 0.0

        def at_all_levels(split: Split) -> Iterator[Split]:
            rng = np.random.default_rng([seed, split.index])
            noise = rng.standard_normal((len(split.test), len(SENSOR)))
            bias = rng.standard_normal(len(SENSOR))
            unit: FloatArray = (self.noise * noise + self.bias * bias) * SENSOR  # (n_test, 6)
            for level in levels:
                error = level * unit
                yield replace(
                    split,
                    condition=f"noise x{str(level).removesuffix('.0')}",
                    # an error of nothing is none: the split is holdout's, and so is its hash
                    wrench_error=error if error.any() else None,
                )

        divisions = super().splits(samples, n_splits=n_splits, seed=seed)
        return divisions.expanded(at_all_levels, len(levels))
