"""An example path in front of a robot, within its reach, to try corrections."""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike
from scipy.spatial.transform import Rotation

from stiff_protocols.contract.arrays import FloatArray
from stiff_protocols.contract.errors import DataError
from stiff_protocols.contract.robot import Robot
from stiff_protocols.paths.inverse import evenly_spaced, follow
from stiff_protocols.paths.path import ToolPath, shaped

PLACES = ((0.6, 0.4), (0.5, 0.3), (0.7, 0.4), (0.5, 0.6), (0.4, 0.3))
"""Of the path's centre, in front of the base and above it, as shares of the robot's reach."""


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
    reach = np.linalg.norm(robot.placements[robot.n_slides + 1 :, :3, 3], axis=1).sum()
    stands = robot.forward(np.zeros((1, robot.n_joints)) if held is None else np.nan_to_num([held]))
    (base,) = robot.arm_base(stands.points)
    outwards = robot.axes[-1] * (-1.0 if robot.axes[-1] @ robot.tcp < 0.0 else 1.0)
    down, _ = Rotation.align_vectors([[0.0, 0.0, -1.0]], [outwards])  # where the last joint points
    sample_rows = evenly_spaced(n_points)
    for x, z in PLACES:
        driven: list[tuple[float, ToolPath]] = []
        for angle in (0.0, 90.0, 180.0, 270.0):
            turned = (Rotation.from_euler("z", angle, degrees=True) * down).as_matrix()
            centre = base + reach * np.array([x, 0.0, z])
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
