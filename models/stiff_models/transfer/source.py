"""The simulated source domain: many poses and wrenches whose deflection a VJM supplies.

A design is a set of poses and some wrenches a pose. The compliance matrix is computed once a pose
and shared by that pose's wrenches; on a grid it is computed once for all values of the first joint.
Where a design follows data, it follows the training samples alone.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

import numpy as np
from scipy.spatial.transform import Rotation
from scipy.stats import qmc

from stiff_models.physics.kinematics import compliance_matrix
from stiff_protocols.contract.errors import ConfigError
from stiff_protocols.contract.types import FloatArray, IntArray, Robot, Samples

PoseDesign = Literal["auto", "paper", "data", "sobol"]
WrenchDesign = Literal["auto", "paper", "data", "uniform", "sobol"]

PAPER_ROBOT = "kr10_r1100_2"
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
POSE_BUDGET = 21_280  # poses of the paper's grid; a grid of ours has no more
WRENCHES_A_POSE = len(PAPER_WRENCHES)


@dataclass(frozen=True, eq=False)
class SourceDesign:
    """Where the source domain is sampled.

    Attributes:
        q: (n_poses, n_joints) rad.
        wrench: (n_poses, n_wrenches, 6) or (1, n_wrenches, 6) when all poses share them.
        first_values: (k,) values of the first joint where the poses are a grid, of which `q` holds
            all others' poses k times, once a value; None where they are none.
    """

    q: FloatArray
    wrench: FloatArray
    first_values: FloatArray | None = None


@dataclass(frozen=True, eq=False)
class SourceDomain:
    """Simulated samples, pose by pose: `q` (n, n_joints), `wrench` (n, 6), `deflection` (n, 3)."""

    q: FloatArray
    wrench: FloatArray
    deflection: FloatArray

    def __len__(self) -> int:
        """Return the number of samples."""
        return len(self.q)

    def take(self, rows: IntArray) -> SourceDomain:
        """Return the samples of these row numbers."""
        return SourceDomain(self.q[rows], self.wrench[rows], self.deflection[rows])


def source_design(
    poses: PoseDesign, wrenches: WrenchDesign, robot: Robot, train: Samples, seed: int
) -> SourceDesign:
    """Return the design of a source domain of at most 21,280 poses and five wrenches a pose.

    `poses` and `wrenches` are options of `SourceModel`; `train` alone, of all data, shapes the
    design; `seed` is of everything drawn.

    Raises:
        ConfigError: the paper's poses were asked for a robot without six joints.
    """
    check_poses(poses, robot)
    automatic: Literal["paper", "data"] = "paper" if robot.name == PAPER_ROBOT else "data"
    rng = np.random.default_rng(seed)
    q, first_values = _poses(automatic if poses == "auto" else poses, train, rng)
    wrench = _wrenches(automatic if wrenches == "auto" else wrenches, train, len(q), rng)
    return SourceDesign(q, wrench, first_values)


def check_poses(poses: PoseDesign, robot: Robot) -> None:
    """Raise ConfigError when the paper's grid is asked for a robot without six joints."""
    if poses == "paper" and robot.n_joints != len(_PAPER_GRID_DEG):
        raise ConfigError(
            f"source_poses=paper: Table 4 has {len(_PAPER_GRID_DEG)} joints, robot "
            f"{robot.name!r} has {robot.n_joints} (valid: auto, data, sobol)"
        )


def simulate(robot: Robot, compliance: FloatArray, design: SourceDesign) -> SourceDomain:
    """Return the deflections of joint springs, (n_joints,) rad/(N m), over a design."""
    n_poses, n_wrenches = len(design.q), design.wrench.shape[1]
    wrench = np.broadcast_to(design.wrench, (n_poses, n_wrenches, 6))
    return SourceDomain(
        q=np.repeat(design.q, n_wrenches, axis=0),
        wrench=wrench.reshape(-1, 6),
        deflection=design_deflection(robot, compliance, design).reshape(-1, 3),
    )


def design_deflection(robot: Robot, compliance: FloatArray, design: SourceDesign) -> FloatArray:
    """Return the (n_poses, n_wrenches, 3) deflections [m] of joint springs over a design."""
    if design.first_values is not None and len(design.wrench) == 1:
        return _on_grid(robot, compliance, design.q, design.first_values, design.wrench[0])
    matrices = compliance_matrix(robot, compliance, design.q)  # (p, 3, 6)
    return np.asarray(design.wrench @ matrices.transpose(0, 2, 1))


def _on_grid(
    robot: Robot,
    compliance: FloatArray,
    q: FloatArray,
    first_values: FloatArray,
    wrenches: FloatArray,
) -> FloatArray:
    """Return the deflections where every value of the first joint meets the same other poses.

    A turn R of the first joint turns the whole chain: ``C(q) = R C(0, q2, ...) R^T``, and a slide
    leaves C as it is. The deflection ``d = R C' R^T w`` is linear in the 18 components of C', with
    factors that depend on the first joint and the wrench alone.
    """
    k, n_others = len(first_values), len(q) // len(first_values)
    others = q[:n_others].copy()
    others[:, 0] = 0.0
    matrices = compliance_matrix(robot, compliance, others).reshape(1, n_others, 18)
    turns = np.tile(np.eye(3), (k, 1, 1))  # (k, 3, 3)
    if robot.joint_types[0] == "revolute":
        axis = robot.placements[0, :3, :3] @ robot.axes[0]
        turns = Rotation.from_rotvec(first_values[:, None] * axis).as_matrix()
    # wrenches as the turned chain feels them: R^T f and R^T m
    felt = np.einsum("kba,wcb->kwca", turns, wrenches.reshape(-1, 2, 3)).reshape(k, -1, 6)
    factors = np.einsum("kxa,kwb->kabwx", turns, felt).reshape(k, 18, -1)
    deflection = matrices @ factors  # (k, n_others, w * 3)
    return np.asarray(deflection.reshape(len(q), -1, 3))


def drawn_from(
    design: SourceDesign, n: int, rng: np.random.Generator
) -> tuple[FloatArray, FloatArray]:
    """Return `n` poses of a design (at most all of them), rad, and one wrench each, N and N m."""
    chosen = rng.permutation(len(design.q))[:n]
    wrench = np.broadcast_to(design.wrench, (len(design.q), *design.wrench.shape[1:]))
    which = rng.integers(wrench.shape[1], size=len(chosen))
    return design.q[chosen], wrench[chosen, which]


def _grid(axes: list[FloatArray]) -> tuple[FloatArray, FloatArray]:
    """Return the product of the joints' values, the first slowest, and the first's values."""
    values = np.stack(np.meshgrid(*axes, indexing="ij"), axis=-1)
    return values.reshape(-1, len(axes)), np.asarray(axes[0])


def _poses(
    design: Literal["paper", "data", "sobol"], train: Samples, rng: np.random.Generator
) -> tuple[FloatArray, FloatArray | None]:
    """Return the poses of a design, and of a grid the first joint's values."""
    if design == "paper":
        return _grid([np.deg2rad(axis) for axis in _PAPER_GRID_DEG])
    lower, upper = train.q.min(axis=0), train.q.max(axis=0)
    if design == "sobol":
        return _sobol(lower, upper, POSE_BUDGET, rng), None
    moving = upper > lower
    # every moving joint gets the same number of values, as many as the budget of poses allows
    n_values = int(POSE_BUDGET ** (1.0 / moving.sum())) if moving.any() else 1
    return _grid(
        [
            np.linspace(low, high, n_values) if moves else np.array([low])
            for low, high, moves in zip(lower, upper, moving, strict=True)
        ]
    )


def _wrenches(
    design: Literal["paper", "data", "uniform", "sobol"],
    train: Samples,
    n_poses: int,
    rng: np.random.Generator,
) -> FloatArray:
    if design == "paper":
        return PAPER_WRENCHES[None]
    shape = (n_poses, WRENCHES_A_POSE, 6)
    lower, upper = train.wrench.min(axis=0), train.wrench.max(axis=0)
    if design == "uniform":
        return rng.uniform(lower, upper, size=shape)
    if design == "sobol":
        # in another order than the poses: two Sobol sequences side by side are not independent
        return rng.permutation(_sobol(lower, upper, n_poses * WRENCHES_A_POSE, rng)).reshape(shape)
    return _wrenches_like(train, n_poses, rng)


def _wrenches_like(train: Samples, n_poses: int, rng: np.random.Generator) -> FloatArray:
    """Loads drawn like the samples': a smoothed bootstrap.

    A training wrench drawn at random plus normal scatter with the training wrenches' covariance,
    narrowed by Scott's factor n^(-1/(d+4)), d = 6.
    """
    n_train = len(train)
    drawn = rng.integers(n_train, size=(n_poses, WRENCHES_A_POSE))
    centred = train.wrench - train.wrench.mean(axis=0)
    # R^T R is the data's covariance; QR serves a covariance of any rank (torques may all be zero)
    root = np.linalg.qr(centred / np.sqrt(max(n_train - 1, 1)), mode="r")  # (min(n, 6), 6)
    scatter = rng.normal(size=(n_poses, WRENCHES_A_POSE, len(root))) @ root
    bandwidth = n_train ** (-1.0 / (6 + 4))
    return np.asarray(train.wrench[drawn] + bandwidth * scatter)


def _sobol(lower: FloatArray, upper: FloatArray, n: int, rng: np.random.Generator) -> FloatArray:
    """Return (n, n_columns) points of a scrambled Sobol sequence between the bounds."""
    sequence = qmc.Sobol(len(lower), rng=rng)
    unit = sequence.random_base2((n - 1).bit_length())[:n]  # a power of two is drawn evenly
    return np.asarray(lower + unit * (upper - lower))
