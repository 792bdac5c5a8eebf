"""Rows of a file far from a model's training samples, and the one warning of them all."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from stiff_datasets.measured.sample_columns import counted, file_units, joint_columns
from stiff_protocols.contract.training_range import TrainingRange
from stiff_protocols.contract.types import FloatArray, Robot


class RowsBeyond:
    """Rows beyond a model's training range, or far from its training samples.

    Attributes:
        training_range: of the model.
        robot: of the joints.
        n_rows, n_beyond: how many rows were seen, and how many of them extrapolate.
        ends: (2, n_joints + 2) smallest and largest of each quantity, of `TrainingRange`.
        n_gap_poses, n_gap_loads: rows marked "pose-gap" and "load-gap".
        gap_pose, gap_load: the largest `pose_distance` and `load_distance` of these.
    """

    def __init__(self, training_range: TrainingRange, robot: Robot) -> None:
        """Store the arguments."""
        self.training_range, self.robot, self.n_rows, self.n_beyond = training_range, robot, 0, 0
        self.ends = np.outer([np.inf, -np.inf], np.ones(robot.n_joints + 2))
        self.n_gap_poses, self.n_gap_loads = 0, 0
        self.gap_pose, self.gap_load = 0.0, 0.0

    def of(self, q: FloatArray, wrench: FloatArray) -> list[str]:
        """Return what of each row extrapolates; see `TrainingRange.extrapolates`."""
        values = TrainingRange.quantities(q, wrench)
        self.ends[0] = np.minimum(self.ends[0], values.min(axis=0, initial=np.inf))
        self.ends[1] = np.maximum(self.ends[1], values.max(axis=0, initial=-np.inf))
        extrapolates = self.training_range.extrapolates(q, wrench)
        self.n_rows += len(q)
        self.n_beyond += sum(map(bool, extrapolates))
        poses = np.array(["pose-gap" in words for words in extrapolates], dtype=bool)
        loads = np.array(["load-gap" in words for words in extrapolates], dtype=bool)
        self.n_gap_poses += int(poses.sum())
        self.n_gap_loads += int(loads.sum())
        far = self.training_range.pose_distance(q[poses]).max(initial=0.0)
        self.gap_pose = max(self.gap_pose, float(far))
        far = self.training_range.load_distance(wrench[loads]).max(initial=0.0)
        self.gap_load = max(self.gap_load, float(far))
        return extrapolates

    @property
    def warning(self) -> str:
        """One line with numbers of all rows; "" where none extrapolates."""
        if not self.n_beyond:
            return ""
        texts = [*self._beyond(), *self._gaps()]
        return f"extrapolation in {self.n_beyond} of {self.n_rows} rows: {', '.join(texts)}"

    def _beyond(self) -> Iterator[str]:
        """Yield the farthest value of each quantity that lies beyond the range."""
        units = np.r_[file_units(self.robot), 1.0, 1.0]
        lower, upper = (end * units for end in self.training_range.ends)
        far = self.training_range.are_beyond(self.ends)
        for i, column in enumerate((*joint_columns(self.robot), "force_N", "torque_Nm")):
            if far[:, i].any():
                lowest, highest = self.ends[:, i] * units[i]
                farthest = lowest if lower[i] - lowest > highest - upper[i] else highest
                name, _, unit = column.partition("_")
                learned = f"{lower[i]:.4g} to" if i < self.robot.n_joints else "up to"
                yield f"{name} {farthest:.4g} {unit} (training: {learned} {upper[i]:.4g})"

    def _gaps(self) -> Iterator[str]:
        """Yield how far the farthest pose and load are from the nearest in training."""
        usual_pose, usual_load = self.training_range.usual_distances
        if self.n_gap_poses:
            unit, factor = ("deg", 180.0 / np.pi) if self.robot.turns.all() else ("rad and m", 1.0)
            yield (
                f"pose-gap in {counted(self.n_gap_poses, 'row')} (up to "
                f"{factor * self.gap_pose:.3g} {unit} from the nearest training pose, usual: "
                f"{factor * usual_pose:.3g})"
            )
        if self.n_gap_loads:
            yield (
                f"load-gap in {counted(self.n_gap_loads, 'row')} (direction up to "
                f"{self.gap_load:.2g} from the nearest training load, usual: {usual_load:.2g})"
            )
