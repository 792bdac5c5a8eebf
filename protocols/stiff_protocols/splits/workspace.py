"""`workspace-extrapolation`: accuracy of a model in a region without training poses."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, field
from typing import Annotated

import numpy as np
from annotated_types import Ge
from sklearn.cluster import KMeans

from stiff_protocols.contract.errors import ConfigError
from stiff_protocols.contract.types import BenchmarkData, FloatArray, IntArray, Robot, Samples
from stiff_protocols.splits.extrapolation import Division, Extrapolation

STARTS, START_SEED = 50, 0  # of k-means; the best one counts
DECIMALS = 6  # m: positions that differ by less than a micrometre are one


@dataclass(kw_only=True, eq=False)
class WorkspaceExtrapolation(Extrapolation):
    """Divides the poses by the TCP's position, and tests each region with models of the others.

    The regions are the clusters that k-means finds in the TCP's positions, numbered along x of the
    base frame; a condition is named after its region's mean position. They belong to the data set
    and not to the seed, which draws the training and validation parts.

    Attributes:
        regions: number of regions.
    """

    regions: Annotated[int, Ge(2)] = 4
    _robot: Robot | None = field(default=None, init=False)

    def prepared(self, data: BenchmarkData) -> BenchmarkData:
        """Store the robot, whose TCP positions divide the poses."""
        self._robot = data.robot
        return data

    def divisions(self, samples: Samples, seed: int) -> Iterator[Division]:
        """Yield a condition for each region that is held out.

        Raises:
            ConfigError: the robot is not known, or there are fewer positions than regions.
            DataError: the samples are of a robot with another number of joints.
        """
        if self._robot is None:
            raise ConfigError(
                "workspace-extrapolation: the robot is not known; call prepared before splits"
            )
        poses, pose_of_row = np.unique(samples.pose_id, return_inverse=True)
        position = _mean_of(self._robot.tcp_position(samples.q), pose_of_row, len(poses))
        position = position.round(DECIMALS)
        different = len(np.unique(position, axis=0))
        if different < self.regions:
            raise ConfigError(
                f"workspace-extrapolation.regions={self.regions}: the {len(poses)} poses have "
                f"{different} different TCP positions (valid: 2 to as many as there are)"
            )
        clusters = KMeans(self.regions, n_init=STARTS, random_state=START_SEED)
        region_of_pose = clusters.fit_predict(position)
        centres = _mean_of(position, region_of_pose, self.regions)  # (regions, 3) m
        for number, region in enumerate(np.lexsort(centres.T[::-1]), start=1):
            x, y, z = (round(1000.0 * value) for value in centres[region].tolist())
            inside = (region_of_pose == region)[pose_of_row]
            condition = f"region {number} around ({x}, {y}, {z}) mm"
            yield condition, np.flatnonzero(~inside), np.flatnonzero(inside)


def _mean_of(values: FloatArray, part_of: IntArray, parts: int) -> FloatArray:
    """Return the (parts, 3) means of the (n, 3) values of each part."""
    sums = np.zeros((parts, 3))
    np.add.at(sums, part_of, values)
    return sums / np.bincount(part_of, minlength=parts)[:, None]
