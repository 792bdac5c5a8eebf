"""Warn of rows that are far from a model's training samples."""

from __future__ import annotations

from collections.abc import Iterator, Sequence

import numpy as np

from stiff_datasets.measured.sample_columns import counted, file_units, joint_columns
from stiff_protocols.contract.training_range import TrainingRange
from stiff_protocols.contract.types import FloatArray, Robot


def extrapolation_warning(
    training_range: TrainingRange,
    robot: Robot,
    q: FloatArray,
    wrench: FloatArray,
    extrapolates: Sequence[str],
) -> str:
    """Return one line about the rows that extrapolate; "" if there are none."""
    n_beyond = sum(map(bool, extrapolates))
    if not n_beyond:
        return ""
    details = extrapolation_details(training_range, robot, q, wrench, extrapolates)
    return f"extrapolation in {n_beyond} of {len(q)} rows: {details}"


def extrapolation_details(
    training_range: TrainingRange,
    robot: Robot,
    q: FloatArray,
    wrench: FloatArray,
    extrapolates: Sequence[str],
) -> str:
    """Return the largest distances from the training range; "" if no row extrapolates.

    Args:
        training_range: training range of the model.
        robot: robot of the joints.
        q: (n, n_joints) rad or m.
        wrench: (n, 6) N and N m at the TCP.
        extrapolates: (n,) quantities of a row beyond the range, see `TrainingRange.extrapolates`.
    """
    if not any(extrapolates):
        return ""
    texts = [*_beyond(training_range, robot, q, wrench)]
    usual_pose, usual_load = training_range.usual_distances
    poses = np.array(["pose-gap" in words for words in extrapolates], dtype=bool)
    loads = np.array(["load-gap" in words for words in extrapolates], dtype=bool)
    if poses.any():
        unit, factor = ("deg", 180.0 / np.pi) if robot.turns.all() else ("rad and m", 1.0)
        max_distance = factor * training_range.pose_distance(q[poses]).max()
        texts.append(
            f"pose-gap in {counted(poses.sum(), 'row')} (up to {max_distance:.3g} {unit} from the "
            f"nearest training pose, usual: {factor * usual_pose:.3g})"
        )
    if loads.any():
        max_distance = training_range.load_distance(wrench[loads]).max()
        texts.append(
            f"load-gap in {counted(loads.sum(), 'row')} (direction up to {max_distance:.2g} from "
            f"the nearest training load, usual: {usual_load:.2g})"
        )
    return ", ".join(texts)


def _beyond(
    training_range: TrainingRange, robot: Robot, q: FloatArray, wrench: FloatArray
) -> Iterator[str]:
    """Yield the farthest value of each quantity that lies beyond the range."""
    values = training_range.quantities(q, wrench)
    ends = np.stack([values.min(axis=0), values.max(axis=0)])
    units = np.r_[file_units(robot), 1.0, 1.0]
    lower, upper = (end * units for end in training_range.ends)
    is_beyond = training_range.are_beyond(ends)
    for i, column in enumerate((*joint_columns(robot), "force_N", "torque_Nm")):
        if is_beyond[:, i].any():
            lowest, highest = ends[:, i] * units[i]
            farthest = lowest if lower[i] - lowest > highest - upper[i] else highest
            name, _, unit = column.partition("_")
            training_text = f"{lower[i]:.4g} to" if i < robot.n_joints else "up to"
            yield f"{name} {farthest:.4g} {unit} (training: {training_text} {upper[i]:.4g})"
