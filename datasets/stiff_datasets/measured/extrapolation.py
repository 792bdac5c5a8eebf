"""Rows of a file beyond a model's training range, and the one warning of them all."""

from __future__ import annotations

import numpy as np

from stiff_protocols.contract.training_range import TrainingRange
from stiff_protocols.contract.types import FloatArray, Robot


class RowsBeyond:
    """What of rows lies beyond a model's training range.

    Attributes:
        known: the range; None: it is not known.
        robot: of the joints.
        n_rows, n_beyond: how many rows were seen, and how many of them lie beyond.
        ends: (2, n_joints + 2) smallest and largest of each quantity, of `TrainingRange`.
    """

    def __init__(self, known: TrainingRange | None, robot: Robot) -> None:
        """Store the arguments."""
        self.known, self.robot, self.n_rows, self.n_beyond = known, robot, 0, 0
        self.ends = np.outer([np.inf, -np.inf], np.ones(robot.n_joints + 2))

    def of(self, q: FloatArray, wrench: FloatArray) -> list[str]:
        """Return what of each row extrapolates; see `TrainingRange.extrapolates`."""
        values = TrainingRange.quantities(q, wrench)
        self.ends[0] = np.minimum(self.ends[0], values.min(axis=0, initial=np.inf))
        self.ends[1] = np.maximum(self.ends[1], values.max(axis=0, initial=-np.inf))
        known = self.known
        extrapolates = ["unknown"] * len(q) if known is None else known.extrapolates(q, wrench)
        self.n_rows += len(q)
        self.n_beyond += sum(map(bool, extrapolates))
        return extrapolates

    @property
    def warning(self) -> str:
        """One line with numbers of all rows; "" where none extrapolates."""
        if self.known is None:
            return (
                "the training range is unknown: the model's file was written before files held one "
                "(fit the model again)"
            )
        if not self.n_beyond:
            return ""
        from stiff_datasets.measured.sample_files import file_units, joint_columns  # pandas

        units = np.r_[file_units(self.robot), 1.0, 1.0]
        lower, upper = (end * units for end in self.known.ends)
        far, texts = self.known.are_beyond(self.ends), []
        for i, column in enumerate((*joint_columns(self.robot), "force_N", "torque_Nm")):
            if far[:, i].any():
                lowest, highest = self.ends[:, i] * units[i]
                farthest = lowest if lower[i] - lowest > highest - upper[i] else highest
                name, _, unit = column.partition("_")
                learned = f"{lower[i]:.4g} to" if i < self.robot.n_joints else "up to"
                texts.append(f"{name} {farthest:.4g} {unit} (training: {learned} {upper[i]:.4g})")
        return f"extrapolation in {self.n_beyond} of {self.n_rows} rows: {', '.join(texts)}"
