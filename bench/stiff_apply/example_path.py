"""Write example tool paths: in front of a robot, or inside the training range of a model."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path
from typing import Annotated, Any, Literal

import numpy as np
from numpy.typing import ArrayLike
from scipy.spatial.transform import Rotation

from stiff_apply.path_file import write_path
from stiff_apply.tool_task import check_word, held_positions, six_numbers, tool_of
from stiff_bench.api.model import Model
from stiff_bench.api.robots import as_robot, payload_of
from stiff_bench.parameter_types import Bounds, FilePath, Form, HeldJoints, Load
from stiff_bench.tables.writers import Text
from stiff_datasets.measured.sample_columns import MM_PER_M
from stiff_protocols.contract.arrays import BoolArray, FloatArray
from stiff_protocols.contract.errors import ConfigError, DataError
from stiff_protocols.contract.files import check_new_file
from stiff_protocols.contract.robot import STANDARD_GRAVITY, Robot
from stiff_protocols.contract.training_range import LEAST_MARGIN, TrainingRange
from stiff_protocols.paths.inverse import evenly_spaced, follow, free_joints
from stiff_protocols.paths.path import SHAPES, ToolPath, shaped

PLACES = ((0.6, 0.4), (0.5, 0.3), (0.7, 0.4), (0.5, 0.6), (0.4, 0.3))
"""Of the path's centre, in front of the base and above it, as shares of the robot's reach."""
CENTRES, SKETCHED_POINTS, FOLLOWED = 60, 25, 12
"""Training poses that are tried, the points at which each is judged first, and the best of them
that are followed along the path."""
LOAD_SHARE = 0.5
"""Default load, as a share of the largest training load in its direction."""
STEPS, REACHED_M = 30, 1e-9
"""Newton steps at most, and the distance from a point that counts as reached."""


def example_path(
    output: FilePath,
    *,
    shape: Literal["square", "circle", "line", "iso9283"] = "square",
    size: Annotated[float, Form("MM"), Bounds(at_least=1.0, at_most=1e4)] = 200.0,
    points: Annotated[int, Bounds(at_least=2, at_most=1_000_000)] = 401,
    load: Load | None = None,
    robot: str | Robot | None = None,
    model: Model | None = None,
    hold: HeldJoints | None = None,
) -> Text:
    """Write an example path for `bench path compensate`.

    The path is horizontal and in front of the robot. With a model it is for the model's robot,
    near a training pose, and inside the training range if the robot can drive such a path.

    Args:
        output: new .csv file.
        shape: shape of the path; iso9283 passes through the five test points of ISO 9283.
        size: edge, diameter or length of the shape; for iso9283 the edge of the cube, in mm.
        points: number of points.
        load: (3,) or (6,) process load on the tool at every point, in N and N m, base frame; by
            default a quarter of the payload downwards, and with a model half of the training load
            that pulls downwards most.
        robot: robot that drives the path: a shipped name or a `Robot`; by default the model's
            robot, or the KR10.
        model: fitted model; its robot drives the path.
        hold: joint of a URDF, or of a robot with more than six joints, that is held at a value in
            deg or mm, by name or number (rail, J3, 3); may be repeated.

    Raises:
        NotFittedError: the model is not fitted.
        ConfigError: the shape, robot or joint is unknown, the load or a held joint is needed, or
            both a robot and a model are given.
        DataError: the robot cannot drive the path at any tried place.
        StoreError: the file cannot be written, or exists.
    """
    output = Path(output)
    check_new_file(output)
    if model is not None:
        model.check_fitted()
    check_word("shape", shape, [*SHAPES])
    if model is not None and robot is not None:
        raise ConfigError("is given, but the model has its own robot; give only one", "robot")
    arm = as_robot(robot) if model is None else model.fitted.robot_
    wrench = None if load is None else six_numbers(load)
    if wrench is None and model is not None:
        wrench = training_load(model.training_range)
    if wrench is None:
        if (payload := payload_of(arm)) is None:
            raise ConfigError(f"is unknown for {arm.name}; give a load in N and N m", "load")
        wrench = np.array([0.0, 0.0, -0.25 * payload * STANDARD_GRAVITY, 0.0, 0.0, 0.0])
    share, form = "", (shape, size / MM_PER_M, points)
    given: dict[str, Any] = {"wrench": wrench, "held": held_positions(arm, hold or {})}
    if model is None:
        path = drivable_path(arm, *form, **given)
    else:
        path, words = path_near_training(arm, model.training_range, *form, **given)
        n_beyond = sum(map(bool, words))
        share = f"; {n_beyond} of {points} points are beyond the training range of {model.name}"
        if n_beyond:
            share += " (a smaller size may be inside)"
    write_path(output, path, tool_of(arm, None))
    return Text(f"{output}: {shape} of {points} points for {arm.name}, base frame{share}")


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

    `held` is as in `free_joints`. Prismatic joints at the base move the path with the arm. Of the
    possible turns among four turns of the tool, it uses the turn with the least motion of the last
    joint.

    Raises:
        DataError: no place was found where the robot can drive the path.
    """
    stands = robot.forward(np.zeros((1, robot.n_joints)) if held is None else np.nan_to_num([held]))
    (base,) = robot.arm_base(stands.points)
    outwards = robot.axes[-1] * (-1.0 if robot.axes[-1] @ robot.tcp < 0.0 else 1.0)
    down, _ = Rotation.align_vectors([[0.0, 0.0, -1.0]], [outwards])  # where the last joint points
    sample_rows = evenly_spaced(n_points)
    for x, z in PLACES:
        driven: list[tuple[float, ToolPath]] = []
        for angle in (0.0, 90.0, 180.0, 270.0):
            turned = (Rotation.from_euler("z", angle, degrees=True) * down).as_matrix()
            centre = base + robot.reach * np.array([x, 0.0, z])
            path = shaped(shape, centre, size, n_points, rotation=turned, wrench=wrench)
            followed = follow(
                robot, path.position[sample_rows], path.rotation[sample_rows], held=held
            )
            if followed.ok.all():
                driven.append((float(np.abs(followed.q[:, -1]).max()), path))
        if driven:
            return min(driven, key=lambda distance_and_path: distance_and_path[0])[1]
    raise DataError(
        f"{robot.name} cannot drive a {shape} of {1000.0 * size:g} mm in front of it; use a "
        "smaller size, or other values of held joints"
    )


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
) -> tuple[ToolPath, list[str]]:
    """Return a horizontal path about a training pose, with the fewest points beyond the range.

    With it come the (n,) words of `TrainingRange.extrapolates`, "" inside the training range.

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
    best = None
    for pose in poses[order[:FOLLOWED]]:
        shape_points = _about(robot, pose, shape, size, n_points, wrench)
        q, reached = _nearest_orientation(robot, shape_points, pose, moves)
        if not reached.all():
            continue
        path = ToolPath(
            shape, shape_points.position, robot.forward(q).rotation, shape_points.wrench
        )
        driven = follow(robot, path.position, path.rotation, near=training_range.middle, held=held)
        if not driven.ok.all():
            continue
        words = training_range.extrapolates(driven.q, path.wrench)
        if best is None or sum(map(bool, words)) < sum(map(bool, best[1])):
            best = path, words
        if not any(best[1]):
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
