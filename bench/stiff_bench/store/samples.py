"""The samples behind the results of a folder: what a comparison needs to say where models differ.

A folder of results can so be judged without the data set's own files.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, fields
from functools import cached_property

import numpy as np

from stiff_protocols.contract.types import PATH_GROUP, FloatArray, Robot, Samples


def load_torque(robot: Robot, samples: Samples) -> FloatArray:
    """Return J^T w: the (n, n_joints) torque [N m] (force [N]) that the loads exert on joints."""
    # what only reads data needs no kinematics
    from stiff_protocols.kinematics.serial_chain import joint_torque

    rows = robot.jacobian(samples.q)  # (n, 6, n_joints)
    return joint_torque(rows, samples.wrench)


@dataclass(frozen=True, eq=False)
class StoredData:
    """A data set as a results folder keeps it.

    Attributes:
        samples: all of them.
        robot: as models are told that it is.
    """

    samples: Samples
    robot: Robot

    @cached_property
    def torque(self) -> FloatArray:
        """(n, n_joints) N m (N), of the loads on the joints."""
        return load_torque(self.robot, self.samples)

    @cached_property
    def tcp(self) -> FloatArray:
        """(n, 3) m, where the unloaded TCP is in the base frame."""
        return self.robot.tcp_position(self.samples.q)

    @property
    def torque_units(self) -> tuple[str, ...]:
        """Unit of the torque of each joint: "Nm" of a revolute one, "N" of a prismatic one."""
        return tuple("N" if kind == "prismatic" else "Nm" for kind in self.robot.joint_types)

    @property
    def stiffness_units(self) -> tuple[str, ...]:
        """Unit of the stiffness of each joint."""
        return tuple("Nm/rad" if unit == "Nm" else "N/m" for unit in self.torque_units)

    @property
    def measured(self) -> Samples:
        """The samples without the points of tool paths that a protocol added."""
        return self.samples.take(np.flatnonzero(self.samples.group != PATH_GROUP))


def what_differs(data_sets: Sequence[StoredData]) -> str:
    """Return in what data sets of one name differ, for people; TCPs in their order."""
    tcps = dict.fromkeys(_place(data.robot.tcp_on_flange) for data in data_sets)
    parts = [f"TCP {' -> '.join(tcps)} m"] if len(tcps) > 1 else []
    if len({_samples_bytes(data.samples) for data in data_sets}) > 1:
        parts.append("samples")
    return " and ".join(parts) or "robot's geometry"


def _place(point: FloatArray) -> str:
    return f"({', '.join(f'{length:g}' for length in point)})"


def _samples_bytes(samples: Samples) -> bytes:
    return b"".join(np.asarray(getattr(samples, item.name)).tobytes() for item in fields(Samples))
