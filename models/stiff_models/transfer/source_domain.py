"""The simulated source domain: many poses and wrenches with a VJM's deflections.

A design is a set of poses with some wrenches per pose. It depends only on the ranges of the
training samples, rounded outwards. Different training parts of a data set have so similar ranges
that nearly all of them get the same design.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Literal

import numpy as np

from stiff_protocols.contract.errors import ConfigError
from stiff_protocols.contract.training_range import in_smallest_arcs
from stiff_protocols.contract.types import FloatArray, IntArray, Robot, Samples
from stiff_protocols.kinematics.serial_chain import unit_deflections

PoseDesign = Literal["paper", "sobol"]
WrenchDesign = Literal["paper", "uniform", "sobol"]

_PAPER_GRID_DEG = (  # source paper, Table 4: A1..A6
    range(-45, 46, 15),
    range(-180, 1, 10),
    range(0, 157, 10),
    (0,),
    range(0, 91, 10),
    (0,),
)
PAPER_WRENCHES = np.array(  # source paper, Table 5: N, N m
    [
        [100.0, 40.0, -20.0, 10.0, 10.0, 2.0],
        [80.0, 30.0, -40.0, 8.0, 8.0, 1.0],
        [60.0, 20.0, -60.0, 6.0, 6.0, 0.0],
        [40.0, 10.0, -80.0, 4.0, 4.0, -1.0],
        [20.0, 5.0, -100.0, 2.0, 2.0, -2.0],
    ]
)
POSE_BUDGET = 21_280  # as many poses as the paper's grid
WRENCHES_A_POSE = len(PAPER_WRENCHES)
ANGLE_STEP = np.deg2rad(15.0)
ROUNDING = 1e-6  # share of a step by which a bound may exceed it
FEW_POSES = 20
"""With fewer poses n, their range misses more than a tenth, 2 / (n + 1), of the original range."""


@dataclass(frozen=True, eq=False)
class SourceDesign:
    """Poses and wrenches of the source domain.

    Attributes:
        q: (n_poses, n_joints) rad.
        wrench: (n_poses, n_wrenches, 6) or (1, n_wrenches, 6) when all poses share them.
    """

    q: FloatArray
    wrench: FloatArray

    def rows(self) -> tuple[FloatArray, FloatArray]:
        """Return pose (n, n_joints) and wrench (n, 6) of every sample, pose by pose."""
        n_poses, n_wrenches = len(self.q), self.wrench.shape[1]
        wrench = np.broadcast_to(self.wrench, (n_poses, n_wrenches, 6)).reshape(-1, 6)
        return np.repeat(self.q, n_wrenches, axis=0), wrench


@dataclass(frozen=True, eq=False)
class SourceDomain:
    """Simulated samples, pose by pose.

    Attributes:
        q: (n, n_joints) rad.
        wrench: (n, 6) N and N m.
        parts: (n, 3, n_parts) m, parts of the deflection: one per joint spring, or a single part.
    """

    q: FloatArray
    wrench: FloatArray
    parts: FloatArray

    def __len__(self) -> int:
        """Return the number of samples."""
        return len(self.q)

    @property
    def deflection(self) -> FloatArray:
        """(n, 3) sum of the parts, m."""
        return np.asarray(self.parts.sum(axis=2))

    def take(self, rows: IntArray) -> SourceDomain:
        """Return the samples of these row numbers."""
        return SourceDomain(self.q[rows], self.wrench[rows], self.parts[rows])


def source_design(
    poses: PoseDesign, wrenches: WrenchDesign, robot: Robot, train: Samples, seed: int
) -> SourceDesign:
    """Return the design of a source domain of at most 21,280 poses and five wrenches per pose.

    `poses` and `wrenches` are options of `SourceModel`. Of all data, only `train` determines the
    design. `seed` determines all random draws.

    Raises:
        ConfigError: the paper's poses were requested for a robot without six joints.
    """
    check_poses(poses, robot)
    rng = np.random.default_rng(seed)
    q = _poses(poses, robot, train, rng)
    return SourceDesign(q, _wrenches(wrenches, train, len(q), rng))


def check_poses(poses: str, robot: Robot) -> None:
    """Raise ConfigError if the paper's grid is requested for a robot without six joints."""
    if poses == "paper" and robot.n_joints != len(_PAPER_GRID_DEG):
        raise ConfigError(
            f"source_poses=paper: the paper's Table 4 has {len(_PAPER_GRID_DEG)} joints, robot "
            f"{robot.name!r} has {robot.n_joints}; use source_poses=sobol"
        )


def simulate(robot: Robot, compliance: FloatArray, design: SourceDesign) -> SourceDomain:
    """Return a design's deflections, spring by spring; compliances (n_joints,) rad/(N m)."""
    q, wrench = design.rows()
    rows = np.repeat(robot.jacobian(design.q), design.wrench.shape[1], axis=0)
    return SourceDomain(q, wrench, unit_deflections(rows, wrench) * compliance)


def joint_ranges(robot: Robot, q: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Return the (n_joints,) lowest and highest joint positions, rounded outwards.

    Angles are rounded to 15 degrees; slides are rounded like loads.
    """
    lower, upper = q.min(axis=0), q.max(axis=0)
    slides = ~robot.turns
    slid = _outwards(lower[slides], upper[slides])
    lower = ANGLE_STEP * np.floor(lower / ANGLE_STEP + ROUNDING)
    upper = ANGLE_STEP * np.ceil(upper / ANGLE_STEP - ROUNDING)
    lower[slides], upper[slides] = slid
    return lower, upper


def load_ranges(wrench: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Return the (6,) lowest and highest components of (n, 6) wrenches, rounded outwards.

    A bound is 0, or 1, 2 or 5 times a power of ten. It is at least a tenth of the largest force, or
    torque.
    """
    lower, upper = wrench.min(axis=0), wrench.max(axis=0)
    force, torque = (_outwards(lower[part], upper[part]) for part in (slice(3), slice(3, 6)))
    return np.concatenate([force[0], torque[0]]), np.concatenate([force[1], torque[1]])


def _outwards(lower: FloatArray, upper: FloatArray) -> tuple[FloatArray, FloatArray]:
    largest = max(np.abs(lower).max(initial=0.0), np.abs(upper).max(initial=0.0))
    smallest = _one_two_five(largest / 10.0, up=True) if largest > 0.0 else 0.0

    def down(bound: float) -> float:
        if bound < -ROUNDING * smallest:
            return -max(_one_two_five(-bound, up=True), smallest)
        return _one_two_five(bound, up=False) if bound >= smallest > 0.0 else 0.0

    return (
        np.array([down(bound) for bound in lower]),
        0.0 - np.array([down(-bound) for bound in upper]),
    )


def _one_two_five(value: float, *, up: bool) -> float:
    """Return the next 1, 2 or 5 times a power of ten from a positive number."""
    power = 10.0 ** math.floor(math.log10(value) + ROUNDING)
    factors = (1.0, 2.0, 5.0, 10.0)
    if up:
        return power * min(factor for factor in factors if factor >= value / power - ROUNDING)
    return power * max(factor for factor in factors if factor <= value / power + ROUNDING)


def _poses(
    design: PoseDesign, robot: Robot, train: Samples, rng: np.random.Generator
) -> FloatArray:
    if design == "paper":
        grid = np.meshgrid(*map(np.deg2rad, _PAPER_GRID_DEG), indexing="ij")
        return np.stack(grid, axis=-1).reshape(-1, len(grid))  # the first joint slowest
    q = in_smallest_arcs(train.q, robot)
    return _sobol(*joint_ranges(robot, _spanned(q, train)), POSE_BUDGET, rng)


def _wrenches(
    design: WrenchDesign, train: Samples, n_poses: int, rng: np.random.Generator
) -> FloatArray:
    if design == "paper":
        return PAPER_WRENCHES[None]
    shape = (n_poses, WRENCHES_A_POSE, 6)
    lower, upper = load_ranges(_spanned(train.wrench, train))
    if design == "uniform":
        return rng.uniform(lower, upper, size=shape)
    # in another order than the poses: two parallel Sobol sequences are not independent
    return rng.permutation(_sobol(lower, upper, n_poses * WRENCHES_A_POSE, rng)).reshape(shape)


def _spanned(values: FloatArray, train: Samples) -> FloatArray:
    """Return the (2, k) estimated ends of the original range of (n, k) values.

    With few poses, the ends are moved outwards to the mean ends of a uniform distribution. Networks
    are not reliable beyond their source domain. Most other poses lie outside the range of five.
    """
    lower, upper = values.min(axis=0), values.max(axis=0)
    n_poses = len(np.unique(train.pose_id))
    missed = (upper - lower) / max(n_poses - 1, 1) if n_poses < FEW_POSES else 0.0
    return np.stack([lower - missed, upper + missed])


def _sobol(lower: FloatArray, upper: FloatArray, n: int, rng: np.random.Generator) -> FloatArray:
    """Return (n, n_columns) points of a scrambled Sobol sequence between the bounds."""
    from scipy.stats import qmc  # slow, and a fitted model does not need it

    sequence = qmc.Sobol(len(lower), rng=rng)
    unit = sequence.random_base2((n - 1).bit_length())[:n]  # a power of two covers evenly
    return np.asarray(lower + unit * (upper - lower))
