"""A simulated data set: a robot whose joints are springs, one load per pose."""

from dataclasses import dataclass
from typing import Annotated

import numpy as np
from annotated_types import Ge, Le

import stiffbench as sb
from stiff_protocols.contract.plugin import DatasetInfo
from stiff_protocols.contract.types import BenchmarkData, Samples


@dataclass(kw_only=True)
class SixSprings:
    """Poses between the joint limits, forces in all directions.

    Attributes:
        poses: number of poses.
        seed: of poses and loads.
    """

    poses: Annotated[int, Ge(10), Le(100_000)] = 60
    seed: Annotated[int, Ge(0)] = 0

    def load(self):
        robot = sb.load_robot("ur5")
        rng = np.random.default_rng(self.seed)
        q = rng.uniform(-np.pi, np.pi, (self.poses, robot.n_joints))  # rad
        wrench = np.zeros((self.poses, 6))
        wrench[:, :3] = rng.normal(0.0, 30.0, (self.poses, 3))  # N
        jacobian = robot.jacobian(q)  # (n, 6, n_joints)
        torque = np.einsum("nij,ni->nj", jacobian, wrench)  # N m
        deflection = np.einsum("nij,nj->ni", jacobian[:, :3], torque / 2e4)  # m; 2e4 N m/rad
        names = np.array([f"P{number}" for number in range(self.poses)])
        plan = np.full(self.poses, "random")
        samples = Samples(q, wrench, deflection, pose_id=names, load_id=names, group=plan)
        return BenchmarkData(samples, robot)


DATASETS = [
    DatasetInfo(key="six-springs", target=SixSprings, summary="linear springs", kind="simulated")
]
