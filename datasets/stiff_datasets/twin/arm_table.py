"""The table in the card of `arm-family`: ``python -m stiff_datasets.twin.arm_table`` prints it.

The deflections are the twins', links included, under the full payload that hangs from the hook, at
the data set's poses and without noise.
"""

from __future__ import annotations

import numpy as np
from tabulate import tabulate

from stiff_datasets.planning.loads import G, hook_wrenches
from stiff_datasets.twin.constants import TwinConstants, shipped_constants, specimen_beams
from stiff_datasets.twin.robot_twin import ARMS, POSES, random_poses
from stiff_datasets.twin.twin import DigitalTwin
from stiff_protocols.contract.types import FloatArray, Robot

HEADINGS = (
    "robot",
    "maker",
    "type",
    "payload kg",
    "reach m",
    "moving mass kg",
    "masses",
    "deflection mm",
    "largest mm",
)


def arm_table() -> str:
    """Return the table in GitHub's Markdown, a row a robot."""
    rows = []
    for number, arm in enumerate(ARMS):
        constants = shipped_constants(arm.name)
        robot = constants.robot()
        deflection = payload_deflection(constants, random_poses(constants, POSES, 0).q) * 1000
        rows.append(
            (
                number,
                arm.maker,
                f"`{arm.type}`",
                f"{constants.payload_kg:g}",
                f"{wrist_reach(robot):.2f}",
                f"{robot.masses.sum():.3g}",
                arm.masses,
                f"{np.median(deflection):.2f}",
                f"{deflection.max():.1f}",
            )
        )
    return tabulate(rows, HEADINGS, tablefmt="github", disable_numparse=True)


def payload_deflection(constants: TwinConstants, q: FloatArray) -> FloatArray:
    """Return (n,) deflections [m] at (n, n_joints) `q` [rad] by the payload that hangs there."""
    robot = constants.robot()
    beams = specimen_beams(constants, robot, 0, asked=True)
    twin = DigitalTwin(robot, constants.springs, beams=beams)
    weight = np.tile([0.0, 0.0, -constants.payload_kg * G], (len(q), 1))
    wrench = hook_wrenches(weight, robot.forward(q).rotation @ np.array(constants.hook_m))
    return np.asarray(np.linalg.norm(twin.readings(q, wrench), axis=1))


def wrist_reach(robot: Robot) -> float:
    """Return how far from joint 1's axis the wrist (joint 5) comes, the arm stretched, m.

    Joint 1 is vertical; joints 2, 3 and 5 turn about one direction at zero joint angles.
    """
    origins = robot.forward(np.zeros((1, robot.n_joints))).points[0]
    across = robot.axes[1]
    shoulder, elbow, wrist = (point - across * (across @ point) for point in origins[[1, 2, 4]])
    offset = np.linalg.norm((shoulder - origins[0])[:2])
    return float(offset + np.linalg.norm(elbow - shoulder) + np.linalg.norm(wrist - elbow))


if __name__ == "__main__":
    print(arm_table())
