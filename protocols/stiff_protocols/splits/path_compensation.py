"""`path-compensation`: error of tool paths after a model has corrected their commands."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from itertools import product

import numpy as np

from stiff_protocols.contract.arrays import TextArray
from stiff_protocols.contract.errors import ConfigError, warn
from stiff_protocols.contract.types import (
    PATH_GROUP,
    BenchmarkData,
    BoolArray,
    Deflection,
    FloatArray,
    IntArray,
    Robot,
    Samples,
    Split,
)
from stiff_protocols.paths.compensation import compensate
from stiff_protocols.paths.inverse import free_joints, is_singular, joint_number
from stiff_protocols.paths.path import ToolPath, shaped
from stiff_protocols.splits.generators import LazySplits
from stiff_protocols.splits.random_splits import Holdout

PARTS = ("near", "middle", "far")
"""Thirds of the measured poses, by the distance of the TCP from the base's z axis; of an arm on a
track from that through its carriage."""
DRIVEN = ("line", "square", "circle")
LOADS = {"down": (0, 0, -1), "x": (1, 0, 0), "y": (0, 1, 0), "oblique": (1, 1, -1)}
"""Directions of the process force, base frame."""
FORCE = 0.8
"""Process force, of the largest measured one: inside the payload."""
SIZE = 0.1
"""Edge, diameter or length, of the largest such distance of a measured TCP."""
POINTS = 20
"""Of a path: an even number, so that the middle of a line, a measured pose, is none of them."""
MARGIN_RAD = 0.05
"""Between a path and the limits of the joints, for the corrections."""
SAME_BRANCH_RAD = 1.0
"""How far a joint moves from the middle of a path at most, so that the arm cannot flip."""
DECIMALS_DEG, DECIMALS_M = 4, 8
"""As twins record joint angles and deflections, so that machines agree on the data's hash."""


@dataclass(kw_only=True, eq=False)
class PathHoldout(Holdout):
    """`holdout` whose fitted models also correct tool paths.

    Attributes:
        hold: joints of a robot with more than six that keep the value of the measured pose along a
            path, by names or numbers, separated by commas.
    """

    hold: str = ""

    added_later = ("hold",)

    def held(self, robot: Robot) -> FloatArray:
        """Return (n_joints,) 0 for each joint that is held, NaN for the other joints.

        Raises:
            ConfigError: not exactly six joints move, or a name is unknown.
        """
        names = [name.strip() for name in self.hold.split(",") if name.strip()]
        held = np.full(robot.n_joints, np.nan)
        held[[joint_number(robot.joint_names, name) for name in names]] = 0.0
        if np.isnan(held).sum() != 6:
            raise ConfigError(
                f"robot {robot.name!r} has {robot.n_joints} joints of which {len(names)} are held "
                "(valid: 6 that move, for the position and the orientation of the tool; "
                f"path-compensation@hold=JOINT,... holds others: {', '.join(robot.joint_names)})"
            )
        return held

    def path_commands(
        self, predict: Deflection, robot: Robot, q: FloatArray, wrench: FloatArray
    ) -> FloatArray:
        """Return the commands with which the predicted points lie on their paths.

        A point whose correction does not converge keeps its command, with a warning.
        """
        target_poses = robot.forward(q)
        path = ToolPath(PATH_GROUP, target_poses.points[:, -1], target_poses.rotation, wrench)
        compensation = compensate(predict, robot, path, q, held=self.held(robot))
        if n_left := int((~compensation.converged).sum()):
            reasons = ", ".join(np.unique(compensation.problem[~compensation.converged]))
            warn(f"{n_left} of {len(q)} path points are left uncorrected: {reasons}")
        return compensation.q


@dataclass(kw_only=True, eq=False)
class PathCompensation(PathHoldout):
    """Tool paths under process loads that a simulated robot follows with corrected commands.

    Models learn from the training side of `holdout`'s divisions of the measured poses; the test
    side is left out.
    """

    caveat = "errors are path errors that a model's corrections leave; a pose is a whole path."

    def prepared(self, data: BenchmarkData) -> BenchmarkData:
        """Return the data with the points of 36 paths behind the samples.

        Three shapes in three parts of the workspace under four loads, each about another measured
        pose whose orientation is held.

        Raises:
            ConfigError: the robot cannot be asked again, other than six joints move, or no path of
                a part can be driven.
        """
        if data.under_load is None:
            raise ConfigError(
                "a measured robot cannot be moved with corrected commands; use a simulated data "
                "set, such as kr10-twin"
            )
        held = self.held(data.robot)
        if (data.samples.group == PATH_GROUP).any():
            raise ConfigError(
                f"its samples use the group {PATH_GROUP!r}, which is reserved for paths; rename it"
            )
        q, wrench, names = _points(data, held)
        points = Samples(
            q=q,
            wrench=wrench,
            deflection=data.under_load(q, wrench).round(DECIMALS_M),
            pose_id=names[:, 0],
            load_id=names[:, 1],
            group=np.full(len(q), PATH_GROUP),
        )
        samples = Samples.together(data.samples, points)
        extended = replace(data, samples=samples, bound_deflections={})
        rows = np.arange(len(data.samples), len(samples))
        oracle = samples.deflection.copy()
        commands = self.commanded(data.under_load, data.robot, points.q, points.wrench)
        oracle[rows] = self.scored(oracle[rows], commands, extended, rows)
        return replace(
            extended, bound_deflections={"oracle": oracle, "uncorrected": np.zeros_like(oracle)}
        )

    def commanded(
        self, predict: Deflection, robot: Robot, q: FloatArray, wrench: FloatArray
    ) -> FloatArray:
        """Return `path_commands`: all reported rows are points of paths."""
        return self.path_commands(predict, robot, q, wrench)

    def scored(
        self, predicted: FloatArray, commands: FloatArray, data: BenchmarkData, rows: IntArray
    ) -> FloatArray:
        """Return the path error without correction minus the error with the commands.

        The simulated robot follows the commands; their predictions are not used.
        """
        points = data.samples.take(rows)
        remaining = _path_errors(commands, points.q, points.wrench, data)
        return np.asarray(points.deflection - remaining)

    def splits(self, samples: Samples, *, n_splits: int | None, seed: int) -> LazySplits:
        """Return `n_splits` (default 1) divisions, `holdout`'s of the same seed, with all paths."""
        is_point = samples.group == PATH_GROUP
        measured, points = np.flatnonzero(~is_point), np.flatnonzero(is_point)
        divisions = super().splits(samples.take(measured), n_splits=n_splits, seed=seed)
        return divisions.expanded(
            lambda split: [
                Split(split.index, measured[split.train], measured[split.validation], points)
            ]
        )


class HoldoutPaths(PathHoldout):
    """`holdout`, and the error that the same fits leave on the tool paths of `path-compensation`.

    A measured robot cannot be moved with corrected commands, so it does not have this error.
    """

    def prepared(self, data: BenchmarkData) -> BenchmarkData:
        """Return the data and the points of the paths; errors as `PathCompensation`."""
        if data.under_load is None:
            return data
        q, wrench, _ = _points(data, self.held(data.robot))
        return replace(data, paths=(q, wrench))

    def path_errors(self, commands: FloatArray, data: BenchmarkData) -> FloatArray:
        """Return the loaded robot's offset from the paths' points with the commands."""
        assert data.paths is not None
        return _path_errors(commands, *data.paths, data)


def _path_errors(
    commands: FloatArray, q: FloatArray, wrench: FloatArray, data: BenchmarkData
) -> FloatArray:
    """Return the (n, 3) remaining path errors [m] of commands at points of paths under load."""
    assert data.under_load is not None  # else it has no paths
    stands = data.robot.tcp_position(commands) + data.under_load(commands, wrench)
    return np.asarray(stands - data.robot.tcp_position(q))


def _points(data: BenchmarkData, held: FloatArray) -> tuple[FloatArray, FloatArray, TextArray]:
    """Return joint positions, wrenches, and names of path and load of the points of all paths.

    They are (n, n_joints) [rad or m], (n, 6) [N, N m] and (n, 2) words.
    """
    samples, robot = data.samples, data.robot
    force = FORCE * float(np.linalg.norm(samples.wrench[:, :3], axis=1).max())
    poses = samples.q[np.sort(np.unique(samples.pose_id, return_index=True)[1])]
    poses = poses[np.random.default_rng(0).permutation(len(poses))]  # a plan's neighbours are alike
    points = robot.forward(poses).points
    reach = np.hypot(*(points[:, -1] - robot.arm_base(points))[:, :2].T)
    size = SIZE * float(reach.max())
    # the other shapes lie inside the square
    _, is_place = _driven(robot, ["square"] * len(poses), poses, size, held)
    edges = np.quantile(reach, np.arange(1, len(PARTS)) / len(PARTS))
    part_of_pose = np.searchsorted(edges, reach)
    names, shapes, starts, wrench = [], [], [], []
    for number, part in enumerate(PARTS):
        places = poses[is_place & (part_of_pose == number)]
        if not len(places):
            raise ConfigError(
                f"robot {robot.name!r} cannot drive a square of {1000.0 * size:.0f} mm about any "
                f"measured pose in the {part} part of the workspace: joint limits or a singularity "
                "are in the way"
            )
        for k, (shape, load) in enumerate(product(DRIVEN, LOADS)):
            names.append((f"{shape}, {part}, {load}", load))
            shapes.append(shape)
            starts.append(places[k % len(places)])
            direction = np.array(LOADS[load]) / np.linalg.norm(LOADS[load])
            wrench.append(np.r_[force * direction, np.zeros(3)])
    angles, driven = _driven(robot, shapes, np.array(starts), size, held)
    if not driven.all():
        path, _ = names[int(np.argmin(driven))]
        raise ConfigError(f"robot {robot.name!r} cannot drive the path {path!r}")
    q = np.deg2rad(np.rad2deg(angles).round(DECIMALS_DEG))
    return q, np.repeat(wrench, POINTS, axis=0), np.repeat(np.array(names), POINTS, axis=0)


def _driven(
    robot: Robot, shapes: Sequence[str], starts: FloatArray, size: float, held: FloatArray
) -> tuple[FloatArray, BoolArray]:
    """Return (k POINTS, n_joints) rad along k paths, and (k,) whether each can be driven.

    They are of one size [m], about the poses `starts` (k, n_joints) rad, whose orientation and held
    joints are kept.
    """
    stands = robot.forward(starts)
    centres, rotations = stands.points[:, -1], stands.rotation
    about_zero = {
        shape: shaped(shape, np.zeros(3), size, POINTS, rotation=np.eye(3), wrench=np.zeros(6))
        for shape in {*shapes}
    }
    outlines = [
        centre + about_zero[shape].position for shape, centre in zip(shapes, centres, strict=True)
    ]
    seeds = np.repeat(starts, POINTS, axis=0)
    position, rotation = np.concatenate(outlines), np.repeat(rotations, POINTS, axis=0)
    free = free_joints(robot, held)
    q, reached = robot.inverse(position, rotation, seeds, free)
    ok = reached & ~is_singular(robot, q, free)
    ok &= (np.abs(q - seeds) < SAME_BRANCH_RAD).all(axis=1)
    margin = np.minimum(q - robot.lower, robot.upper - q)[:, free]
    ok &= (margin > MARGIN_RAD).all(axis=1)
    return q, np.asarray(ok.reshape(-1, POINTS).all(axis=1))
