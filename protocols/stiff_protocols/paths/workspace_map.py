"""Deflections or compliances that a model predicts at points of the workspace.

At each point the tool has a given orientation, or the best of some turns about its axis. The arm
has the configuration nearest to the training poses (`reached_poses`).
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Literal

import numpy as np

from stiff_protocols.contract.arrays import BoolArray, FloatArray, TextArray
from stiff_protocols.contract.progress import report
from stiff_protocols.contract.robot import Robot
from stiff_protocols.contract.training_range import TrainingRange
from stiff_protocols.contract.types import AXES
from stiff_protocols.paths.reached_poses import ReachedPoses, reached_poses
from stiff_protocols.springs.cartesian_stiffness import (
    cartesian_compliance,
    largest_compliance,
    translational_compliance,
)

Quantity = Literal["deflection", "compliance"]
QUANTITIES: tuple[Quantity, ...] = ("deflection", "compliance")
TOOL_AXIS = "tool"
MAP_AXES = (*AXES, TOOL_AXIS)
"""Directions of a component: axes of the base frame, and the tool's own z axis."""
BEST_TURNS_RAD: tuple[float, ...] = tuple(np.radians(np.arange(0.0, 360.0, 30.0)).tolist())
"""Turns about the tool axis of which the best is taken."""
FORCE_SHARE = 0.1
"""Step of the derivative with respect to the force, as a share of the largest training force."""


@dataclass(frozen=True, eq=False)
class MappedPoints:
    """Predictions at n points of the workspace.

    Attributes:
        q: (n, n_joints) joint positions, rad or m; NaN where blank.
        turns: (n,) turn about the tool axis from the given orientation, rad; NaN where blank.
        vectors: (n, 3) deflections, m, or (n, 3, 3) translational compliances, m/N, base frame; NaN
            where blank.
        values: (n,) mapped quantity, m or m/N; NaN where blank.
        blank: (n,) reason why a point has no value, of `BLANK_REASONS`; "" for a point that has.
        extrapolates: (n,) difference from the training samples, see `TrainingRange.extrapolates`.
    """

    q: FloatArray
    turns: FloatArray
    vectors: FloatArray
    values: FloatArray
    blank: TextArray
    extrapolates: TextArray


@dataclass(frozen=True, eq=False)
class WorkspaceTask:
    """A tool, its load, and the quantity that is predicted at each point.

    Attributes:
        robot: of the model.
        training_range: of the model.
        predict: returns (n, 3) deflections [m] of (n, n_joints) q and (n, 6) wrenches, at the TCP.
        joint_compliance: (n_joints,) rad/(N m) or m/N of a model that is nothing but joint springs,
            whose compliance has a closed form; None: of any other model.
        tool: (3, 3) orientation of the tool frame in the last joint's frame.
        orientation: (3, 3) orientation of the tool frame in the base frame.
        load: (6,) N and N m at the TCP.
        in_tool_frame: whether the load turns with the tool; else it is in the base frame.
        quantity: deflection under the load, or compliance at it.
        axis: of the component, of `MAP_AXES`; None: length of the deflection, or the largest
            principal compliance.
        held: (n_joints,) rad or m at which joints are held, NaN for a joint that moves.
    """

    robot: Robot
    training_range: TrainingRange
    predict: Callable[[FloatArray, FloatArray], FloatArray]
    joint_compliance: FloatArray | None
    tool: FloatArray
    orientation: FloatArray
    load: FloatArray
    in_tool_frame: bool
    quantity: Quantity
    axis: str | None
    held: FloatArray

    def wrench(self, turn: float) -> FloatArray:
        """Return the (6,) load after a turn of the tool, N and N m, base frame."""
        if not self.in_tool_frame:
            return self.load
        rotation = turned_tool(self.orientation, turn)
        return np.asarray((self.load.reshape(2, 3) @ rotation.T).ravel())

    def reached(self, points: FloatArray, turn: float) -> ReachedPoses:
        """Return the joint positions at (n_rows, n_columns, 3) points after a turn of the tool."""
        rotation = turned_tool(self.orientation, turn) @ self.tool.T
        return reached_poses(self.robot, points, rotation, self.training_range, self.held)

    def are_reached(self, points: FloatArray, turns: Sequence[float]) -> BoolArray:
        """Return (n_rows, n_columns) true for points reached with any turn of the tool."""
        reached = [self.reached(points, turn).reached for turn in turns]
        return np.asarray(np.any(reached, axis=0).reshape(points.shape[:2]))

    def predictions(self, q: FloatArray, turn: float) -> tuple[FloatArray, FloatArray]:
        """Return values and vectors of `MappedPoints` at (n, n_joints) q."""
        wrench = np.tile(self.wrench(turn), (len(q), 1))
        if self.quantity == "deflection":
            deflection = self.predict(q, wrench)
            if self.axis is None:
                return np.linalg.norm(deflection, axis=1), deflection
            return deflection @ self._direction, deflection
        if self.joint_compliance is not None:
            rows = self.robot.jacobian(q)[:, :3]
            compliance = cartesian_compliance(rows, self.joint_compliance)
        else:
            step = FORCE_SHARE * self.training_range.force or 1.0
            compliance = translational_compliance(self.predict, q, wrench, step)
        if self.axis is None:
            return largest_compliance(compliance), compliance
        along = np.einsum("i,nij,j->n", self._direction, compliance, self._direction)
        return along, compliance

    @property
    def _direction(self) -> FloatArray:
        """(3,) unit vector of `axis` in the base frame."""
        if self.axis == TOOL_AXIS:
            return np.asarray(self.orientation[:, 2])
        return np.asarray(np.eye(3)[MAP_AXES.index(self.axis or "x")])


def turned_tool(orientation: FloatArray, turn: float) -> FloatArray:
    """Return the (3, 3) orientation of a tool frame after a turn about its z axis, rad."""
    cosine, sine = np.cos(turn), np.sin(turn)
    about_z = np.array([[cosine, -sine, 0.0], [sine, cosine, 0.0], [0.0, 0.0, 1.0]])
    return np.asarray(orientation @ about_z)


def mapped_points(
    task: WorkspaceTask, planes: FloatArray, turns: Sequence[float] = (0.0,)
) -> MappedPoints:
    """Return a task's predictions at the n points of parallel planes, plane by plane, row by row.

    Args:
        task: the tool, its load and the quantity.
        planes: (n_planes, n_rows, n_columns, 3) points of the TCP, base frame, m.
        turns: about the tool axis, rad; of several, each point has the one with the smallest value.
    """
    mapped_planes, n_steps = [], len(planes) * len(turns)
    for number, points in enumerate(planes):
        best = None
        for step, turn in enumerate(turns, start=1 + number * len(turns)):
            candidate = _mapped(task, points, turn)
            best = candidate if best is None else _better(best, candidate)
            report("map", step, n_steps)
        mapped_planes.append(vars(best).values())
    return MappedPoints(*map(np.concatenate, zip(*mapped_planes, strict=True)))


def _mapped(task: WorkspaceTask, points: FloatArray, turn: float) -> MappedPoints:
    """Return the predictions at (n_rows, n_columns, 3) points after one turn of the tool."""
    poses = task.reached(points, turn)
    reached, n = poses.reached, len(poses.q)
    values, turns, extrapolates = np.full(n, np.nan), np.full(n, np.nan), np.full(n, "", "<U32")
    shape = (n, 3) if task.quantity == "deflection" else (n, 3, 3)
    vectors, q = np.full(shape, np.nan), poses.q[reached]
    if len(q):
        values[reached], vectors[reached] = task.predictions(q, turn)
        turns[reached] = turn
        wrench = np.tile(task.wrench(turn), (len(q), 1))
        extrapolates[reached] = task.training_range.extrapolates(q, wrench)
    return MappedPoints(poses.q, turns, vectors, values, poses.blank, extrapolates)


def _better(first: MappedPoints, second: MappedPoints) -> MappedPoints:
    """Return at each point the prediction with the smaller value; blank points are never better."""
    sizes = [
        np.where(points.blank == "", np.abs(points.values), np.inf) for points in (first, second)
    ]
    is_second = sizes[1] < sizes[0]
    parts = (
        np.where(is_second.reshape(-1, *[1] * (theirs.ndim - 1)), theirs, ours)
        for ours, theirs in zip(vars(first).values(), vars(second).values(), strict=True)
    )
    return MappedPoints(*parts)
