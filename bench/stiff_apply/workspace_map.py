"""Deflections or compliances that a model predicts at points of the workspace.

At each point the tool has a given orientation. The arm has the configuration nearest to the
training poses (`reached_poses`).
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Literal

import numpy as np

from stiff_apply.reached_poses import ReachedPoses, reached_poses
from stiff_protocols.contract.arrays import BoolArray, FloatArray, TextArray
from stiff_protocols.contract.progress import report
from stiff_protocols.contract.robot import Robot
from stiff_protocols.contract.training_range import TrainingRange
from stiff_protocols.contract.types import AXES
from stiff_protocols.springs.cartesian_stiffness import (
    cartesian_compliance,
    largest_compliance,
)

Quantity = Literal["deflection", "compliance"]
QUANTITIES: tuple[Quantity, ...] = ("deflection", "compliance")
TOOL_AXIS = "tool"
MAP_AXES = (*AXES, TOOL_AXIS)
"""Directions of a component: axes of the base frame, and the tool's own z axis."""


@dataclass(frozen=True, eq=False)
class MappedPoints:
    """Predictions at n points of the workspace.

    Attributes:
        q: (n, n_joints) joint positions, rad or m; NaN where blank.
        vectors: (n, 3) deflections, m, or (n, 3, 3) translational compliances, m/N, base frame; NaN
            where blank.
        values: (n,) mapped quantity, m or m/N; NaN where blank.
        blank: (n,) reason why a point has no value, of `BLANK_REASONS`; "" for a point that has.
        extrapolates: (n,) difference from the training samples, see `TrainingRange.extrapolates`.
    """

    q: FloatArray
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
        joint_compliance: (n_joints,) rad/(N m) or m/N of a model of joint springs, for compliances;
            None: of any other model.
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

    @property
    def wrench(self) -> FloatArray:
        """The (6,) load, N and N m, base frame."""
        if not self.in_tool_frame:
            return self.load
        return np.asarray((self.load.reshape(2, 3) @ self.orientation.T).ravel())

    def reached(self, points: FloatArray) -> ReachedPoses:
        """Return the joint positions at (n_rows, n_columns, 3) points."""
        rotation = self.orientation @ self.tool.T
        return reached_poses(self.robot, points, rotation, self.training_range, self.held)

    def are_reached(self, points: FloatArray) -> BoolArray:
        """Return (n_rows, n_columns) true for points that the tool reaches."""
        return np.asarray(self.reached(points).reached.reshape(points.shape[:2]))

    def predictions(self, q: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Return values and vectors of `MappedPoints` at (n, n_joints) q."""
        wrench = np.tile(self.wrench, (len(q), 1))
        if self.quantity == "deflection":
            deflection = self.predict(q, wrench)
            if self.axis is None:
                return np.linalg.norm(deflection, axis=1), deflection
            return deflection @ self._direction, deflection
        assert self.joint_compliance is not None
        compliance = cartesian_compliance(self.robot.jacobian(q)[:, :3], self.joint_compliance)
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


def mapped_points(task: WorkspaceTask, planes: FloatArray) -> MappedPoints:
    """Return a task's predictions at the n points of parallel planes, plane by plane, row by row.

    Args:
        task: the tool, its load and the quantity.
        planes: (n_planes, n_rows, n_columns, 3) points of the TCP, base frame, m.
    """
    mapped_planes = []
    for number, points in enumerate(planes, start=1):
        mapped_planes.append(vars(_mapped(task, points)).values())
        report("map", number, len(planes))
    return MappedPoints(*map(np.concatenate, zip(*mapped_planes, strict=True)))


def _mapped(task: WorkspaceTask, points: FloatArray) -> MappedPoints:
    """Return the predictions at (n_rows, n_columns, 3) points."""
    poses = task.reached(points)
    reached, n = poses.reached, len(poses.q)
    values, extrapolates = np.full(n, np.nan), np.full(n, "", "<U32")
    shape = (n, 3) if task.quantity == "deflection" else (n, 3, 3)
    vectors, q = np.full(shape, np.nan), poses.q[reached]
    if len(q):
        values[reached], vectors[reached] = task.predictions(q)
        wrench = np.tile(task.wrench, (len(q), 1))
        extrapolates[reached] = task.training_range.extrapolates(q, wrench)
    return MappedPoints(poses.q, vectors, values, poses.blank, extrapolates)
