"""A path inside the training range of a model, where its predictions are reliable."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike
from scipy.spatial.transform import Rotation

from stiff_protocols.contract.arrays import BoolArray, FloatArray
from stiff_protocols.contract.errors import DataError
from stiff_protocols.contract.robot import Robot
from stiff_protocols.contract.training_range import LEAST_MARGIN, TrainingRange
from stiff_protocols.paths.inverse import evenly_spaced, follow, free_joints
from stiff_protocols.paths.path import ToolPath, shaped

CENTRES, SKETCHED_POINTS, FOLLOWED = 60, 25, 12
"""Training poses that are tried, the points at which each is judged first, and the best of them
that are followed along the path."""
LOAD_SHARE = 0.5
"""Default load, as a share of the largest training load in its direction."""
STEPS, REACHED_M = 30, 1e-9
"""Newton steps at most, and the distance from a point that counts as reached."""


@dataclass(frozen=True, eq=False)
class TrainedPath:
    """A path near the training poses of a model.

    Attributes:
        path: poses and loads.
        extrapolates: (n,) words of `TrainingRange.extrapolates`; "" inside the training range.
    """

    path: ToolPath
    extrapolates: tuple[str, ...]

    @property
    def n_beyond(self) -> int:
        """Number of points beyond the training range."""
        return sum(map(bool, self.extrapolates))


def training_load(training_range: TrainingRange) -> FloatArray | None:
    """Return the (6,) training load with the largest downward share, at half the largest force.

    N and N m at the TCP, base frame; None: the training samples have no load.
    """
    if not len(training_range.directions):
        return None
    lengths = np.linalg.norm(training_range.directions[:, :3], axis=1)
    down = training_range.directions[np.argmin(training_range.directions[:, 2])]
    force, torque = np.linalg.norm(down[:3]), np.linalg.norm(down[3:])
    if not lengths.any():
        return None
    most = min(
        training_range.force / force if force else np.inf,
        training_range.torque / torque if torque else np.inf,
    )
    return np.asarray(LOAD_SHARE * most * down)


def path_near_training(
    robot: Robot,
    training_range: TrainingRange,
    shape: str,
    size: float,
    n_points: int,
    *,
    wrench: ArrayLike,
    held: FloatArray | None = None,
) -> TrainedPath:
    """Return a horizontal path about a training pose, with the fewest points beyond the range.

    The tool has the orientation of that pose. Joints that the training samples never moved are
    held as well, and the orientation then changes along the path by as little as possible. Of
    paths that are equally far inside, the tool points downwards most in the one returned.

    Args:
        robot: that drives it.
        training_range: of the model.
        shape: its name.
        size: edge, diameter or length, m; of iso9283 the edge of the cube.
        n_points: number of points.
        wrench: (6,) at the TCP, N and N m, base frame.
        held: see `inverse.free_joints`.

    Raises:
        DataError: the robot cannot drive this path about any of the training poses.
    """
    free = free_joints(robot, held)
    moves = free & (training_range.upper - training_range.lower > LEAST_MARGIN)
    if moves.sum() < 3:
        moves = free
    poses = training_range.poses[evenly_spaced(len(training_range.poses), CENTRES)]
    poses = poses if held is None else np.where(np.isnan(held), poses, held)
    order = _most_promising(robot, training_range, poses, shape, size, wrench, moves)
    near, best = 0.5 * (training_range.lower + training_range.upper), None
    for pose in poses[order[:FOLLOWED]]:
        shape_points = _about(robot, pose, shape, size, n_points, wrench)
        q, reached = _nearest_orientation(robot, shape_points, pose, moves)
        if not reached.all():
            continue
        path = ToolPath(
            shape, shape_points.position, robot.forward(q).rotation, shape_points.wrench
        )
        driven = follow(robot, path.position, path.rotation, near=near, held=held)
        if not driven.ok.all():
            continue
        words = tuple(training_range.extrapolates(driven.q, path.wrench))
        trained_path = TrainedPath(path, words)
        if best is None or trained_path.n_beyond < best.n_beyond:
            best = trained_path
        if not best.n_beyond:
            break
    if best is None:
        raise DataError(
            f"{robot.name} cannot drive a {shape} of {1000.0 * size:g} mm about its training "
            "poses; try a smaller size, or other values of held joints"
        )
    return best


def _most_promising(
    robot: Robot,
    training_range: TrainingRange,
    poses: FloatArray,
    shape: str,
    size: float,
    wrench: ArrayLike,
    moves: BoolArray,
) -> list[int]:
    """Return the numbers of the poses with the best few points of a path about them."""
    outwards = robot.axes[-1] * (-1.0 if robot.axes[-1] @ robot.tcp < 0.0 else 1.0)

    def costs() -> Iterator[tuple[float, float, int]]:
        for number, pose in enumerate(poses):
            sketch = _about(robot, pose, shape, size, SKETCHED_POINTS, wrench)
            q, reached = _nearest_orientation(robot, sketch, pose, moves)
            inside = (q > robot.lower) & (q < robot.upper)
            words = training_range.extrapolates(q, sketch.wrench)
            n_bad = sum(map(bool, words)) + (~(reached & inside.all(axis=1))).sum()
            height = float(robot.forward(pose[None]).rotation[0, 2] @ outwards)  # -1: downwards
            yield float(n_bad), height, number

    return [number for *_, number in sorted(costs())]


def _about(
    robot: Robot, pose: FloatArray, shape: str, size: float, n_points: int, wrench: ArrayLike
) -> ToolPath:
    """Return the path about the TCP of (n_joints,) joint positions, with its orientation."""
    stands = robot.forward(pose[None])
    centre, rotation = stands.points[0, -1], stands.rotation[0]
    return shaped(shape, centre, size, n_points, rotation=rotation, wrench=wrench)


def _nearest_orientation(
    robot: Robot, path: ToolPath, seed: FloatArray, moves: BoolArray
) -> tuple[FloatArray, BoolArray]:
    """Return (n, n_joints) rad or m at the points of a path, and (n,) whether each is reached.

    Position comes first; the orientation is the nearest to the path's that the joints that move
    allow (Gauss-Newton steps with the position as a constraint).
    """
    q = np.repeat(seed[None], len(path), axis=0)
    with np.errstate(all="ignore"):
        for _ in range(STEPS):
            stands = robot.forward(q)
            off = path.position - stands.points[:, -1]
            turn = path.rotation @ stands.rotation.transpose(0, 2, 1)
            turned = Rotation.from_matrix(turn).as_rotvec()
            jacobian = robot.jacobian(q)[:, :, moves]
            to_place = np.linalg.pinv(jacobian[:, :3], rcond=1e-6)
            step = np.einsum("nij,nj->ni", to_place, off)
            spare = np.eye(moves.sum()) - to_place @ jacobian[:, :3]
            turned -= np.einsum("nij,nj->ni", jacobian[:, 3:], step)
            spare_turn = np.linalg.pinv(jacobian[:, 3:] @ spare, rcond=1e-6)
            step += np.einsum("nij,nj->ni", spare_turn, turned)
            q[:, moves] += np.clip(step, -0.5, 0.5)
            if np.abs(step).max() < REACHED_M:
                break
    away = np.linalg.norm(path.position - robot.tcp_position(q), axis=1)
    return q, np.asarray(away < REACHED_M)
