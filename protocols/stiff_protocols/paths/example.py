"""A path in front of a robot that it can drive, to try corrections on."""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike
from scipy.spatial.transform import Rotation

from stiff_protocols.contract.arrays import BoolArray, FloatArray
from stiff_protocols.contract.errors import DataError
from stiff_protocols.contract.robot import Robot
from stiff_protocols.contract.training_range import TrainingRange
from stiff_protocols.paths.inverse import SINGULAR, evenly_spaced, follow, judged
from stiff_protocols.paths.path import ToolPath, shaped

PLACES = ((0.6, 0.4), (0.5, 0.3), (0.7, 0.4), (0.5, 0.6), (0.4, 0.3))
"""Of the path's centre, in front of the base and above it, as shares of the robot's reach."""

CENTRES, COARSE = 40, 41
"""Training poses about which a path is tried, and its points that are looked at."""
UNMOVED = 0.02
"""rad or m: a joint that training moved less stays where it was."""
NEWTON_STEPS, ARRIVED_M = 20, 1e-9


def drivable_path(
    robot: Robot,
    shape: str,
    size: float,
    n_points: int,
    *,
    wrench: ArrayLike,
    held: FloatArray | None = None,
) -> ToolPath:
    """Return a horizontal path, the tool pointing down; arguments as `shaped`.

    `held` is as in `free_joints`. Prismatic ones at the base carry the path with the arm.
    Of four turns of the tool that can be driven, it takes the one that turns the last joint least.

    Raises:
        DataError: no place was found where the robot can drive the path.
    """
    reach = np.linalg.norm(robot.placements[robot.n_slides + 1 :, :3, 3], axis=1).sum()
    stands = robot.forward(np.zeros((1, robot.n_joints)) if held is None else np.nan_to_num([held]))
    (base,) = robot.arm_base(stands.points)
    outwards = robot.axes[-1] * (-1.0 if robot.axes[-1] @ robot.tcp < 0.0 else 1.0)
    down, _ = Rotation.align_vectors([[0.0, 0.0, -1.0]], [outwards])  # where the last joint points
    some = evenly_spaced(n_points)
    for x, z in PLACES:
        driven: list[tuple[float, ToolPath]] = []
        for angle in (0.0, 90.0, 180.0, 270.0):
            turned = (Rotation.from_euler("z", angle, degrees=True) * down).as_matrix()
            centre = base + reach * np.array([x, 0.0, z])
            path = shaped(shape, centre, size, n_points, rotation=turned, wrench=wrench)
            found = follow(robot, path.position[some], path.rotation[some], held=held)
            if found.ok.all():
                driven.append((float(np.abs(found.q[:, -1]).max()), path))
        if driven:
            return min(driven, key=lambda one: one[0])[1]
    raise DataError(
        f"{robot.name} cannot drive a {shape} of {1000.0 * size:g} mm in front of it; try a "
        "smaller size, or other values of held joints"
    )


def trained_path(
    robot: Robot,
    known: TrainingRange,
    shape: str,
    size: float,
    n_points: int,
    *,
    wrench: ArrayLike,
) -> tuple[ToolPath, float]:
    """Return a path near a training pose, and the share of its points that are beyond training.

    From each of `CENTRES` training poses on, the joints move least so that the TCP takes the
    shape; the tool's orientation is what results. Joints that training hardly moved stay. The path
    with the smallest share is taken, of several the first.

    Args:
        robot: that drives it.
        known: range of the model's training samples.
        shape: its name, see `shaped`.
        size: of the shape, m.
        n_points: of the path.
        wrench: (6,) at the TCP, N and N m, base frame.

    Raises:
        DataError: the robot cannot drive the shape from any of the training poses.
    """
    moves = known.upper - known.lower > UNMOVED
    load = np.asarray(wrench, dtype=np.float64)
    best: tuple[float, FloatArray, ToolPath] | None = None
    for start in known.poses[evenly_spaced(len(known.poses), CENTRES)]:
        centre = robot.tcp_position(start[None])[0]
        path = shaped(shape, centre, size, n_points, rotation=np.eye(3), wrench=load)
        some = evenly_spaced(n_points, COARSE)
        q = _least_motion(robot, path.position[some], start, moves)
        if q is None or not judged(robot, q).ok.all():
            continue
        words = known.extrapolates(q, path.wrench[some])
        share = sum(map(bool, words)) / len(words)
        if best is None or share < best[0]:
            best = share, start, path
        if share == 0.0:
            break
    joints = None if best is None else _least_motion(robot, best[2].position, best[1], moves)
    if best is None or joints is None:
        raise DataError(
            f"{robot.name} cannot drive a {shape} of {1000.0 * size:g} mm about a training pose; "
            "try a smaller size"
        )
    path = best[2]
    words = known.extrapolates(joints, path.wrench)
    rotation = robot.forward(joints).rotation
    path = ToolPath(path.name, path.position, rotation, path.wrench)
    return path, sum(map(bool, words)) / len(words)


def _least_motion(
    robot: Robot, position: FloatArray, start: FloatArray, moves: BoolArray
) -> FloatArray | None:
    """Return (n, n_joints) joints with the TCP at each position, each from the one before.

    Newton's method with the least change of the joints that move; None where it does not arrive.
    """
    q, rows = start.copy(), []
    for point in position:
        for _ in range(NEWTON_STEPS):
            off = point - robot.tcp_position(q[None])[0]
            if np.linalg.norm(off) < ARRIVED_M:
                break
            jacobian = robot.jacobian(q[None])[0, :3][:, moves]
            q[moves] += np.linalg.lstsq(jacobian, off, rcond=1.0 / SINGULAR)[0]
        else:
            return None
        rows.append(q.copy())
    return np.array(rows)
