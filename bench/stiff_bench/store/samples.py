"""The samples behind the results of a folder: what a comparison needs to say where models differ.

Samples, robot, joint torques of the loads and TCP positions, as a NumPy archive (`.npz`): so a
folder of results can be judged, and its models fitted anew, without the data set's own files.
"""

from __future__ import annotations

import io
import lzma
import zipfile
import zlib
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, fields
from typing import Any

import numpy as np

from stiff_protocols.contract.errors import DataError
from stiff_protocols.contract.types import (
    PATH_GROUP,
    BenchmarkData,
    FloatArray,
    Robot,
    Samples,
    frozen_array,
)


def load_torque(data: BenchmarkData) -> FloatArray:
    """Return J^T w: the (n, n_joints) torque [N m] (force [N]) that the loads exert on joints."""
    # what only reads data needs no kinematics
    from stiff_protocols.kinematics.serial_chain import joint_torque

    rows = data.robot.jacobian(data.samples.q)  # (n, 6, n_joints)
    return joint_torque(rows, data.samples.wrench)


LARGEST_BYTES = 4 * 2**30
"""What an archive may unpack to: ten million samples. Few bytes can stand for many."""


@dataclass(frozen=True, eq=False)
class StoredData:
    """A data set as a results folder keeps it.

    Attributes:
        samples: all of them.
        torque: (n, n_joints) N m (N), of the loads on the joints.
        joint_names: base to tip.
        robot: its name.
        tcp: (n, 3) m, where the unloaded TCP is in the base frame.
        torque_units: one a joint, "Nm" of a revolute one, "N" of a prismatic one.
        tcp_on_flange: (3,) m, the TCP in the frame of the robot description's last link; None in a
            file of a stiffbench that did not store it.
        geometry: the robot as models are told that it is; None likewise.
    """

    samples: Samples
    torque: FloatArray
    joint_names: tuple[str, ...]
    robot: str
    tcp: FloatArray
    torque_units: tuple[str, ...]
    tcp_on_flange: FloatArray | None = None
    geometry: Robot | None = None

    @property
    def measured(self) -> Samples:
        """The samples without the points of tool paths that a protocol added."""
        return self.samples.take(np.flatnonzero(self.samples.group != PATH_GROUP))

    @property
    def stiffness_units(self) -> tuple[str, ...]:
        """Unit of the stiffness of each joint."""
        return tuple("Nm/rad" if unit == "Nm" else "N/m" for unit in self.torque_units)


_ROBOT_NAMES = ("name", "joint_names", "joint_types")
_ROBOT_ARRAYS = tuple(item.name for item in fields(Robot) if item.name not in _ROBOT_NAMES)
_OF_ROBOT = "robot "
"""How the names of the robot's arrays begin: `tcp` alone is another array."""


def what_differs(found: Sequence[StoredData]) -> str:
    """Return in what data sets of one name differ, for people; TCPs in their order."""
    tcps = ["" if one.tcp_on_flange is None else _place(one.tcp_on_flange) for one in found]
    if not all(tcps):
        return "data or TCP"
    changed = [tcp for tcp, before in zip(tcps, ["", *tcps[:-1]], strict=True) if tcp != before]
    parts = [f"TCP {' -> '.join(changed)} m"] if len(changed) > 1 else []
    if len({_samples_bytes(one.samples) for one in found}) > 1:
        parts.append("samples")
    return " and ".join(parts) or "robot's geometry"


def _place(point: FloatArray) -> str:
    return f"({', '.join(f'{length:g}' for length in point)})"


def _samples_bytes(samples: Samples) -> bytes:
    return b"".join(np.asarray(getattr(samples, item.name)).tobytes() for item in fields(Samples))


def data_content(data: BenchmarkData) -> bytes:
    """Return what is stored of a data set."""
    arrays = {item.name: getattr(data.samples, item.name) for item in fields(Samples)}
    file = io.BytesIO()
    np.savez_compressed(
        file,
        torque=load_torque(data),
        tcp=data.robot.tcp_position(data.samples.q),
        tcp_on_flange=data.robot.tcp_on_flange,
        joint_types=np.array(data.robot.joint_types),
        joint_names=np.array(data.robot.joint_names),
        robot=np.array(data.robot.name),
        **arrays,
        **{f"{_OF_ROBOT}{name}": getattr(data.robot, name) for name in _ROBOT_ARRAYS},
    )
    return file.getvalue()


def stored_data(content: bytes) -> StoredData:
    """Return the data set whose content this is.

    Raises:
        DataError: it is none, or unpacks to too much.
    """
    try:
        with zipfile.ZipFile(io.BytesIO(content)) as parts:
            size = sum(part.file_size for part in parts.infolist())
        if size > LARGEST_BYTES:
            raise DataError(f"unpacks to {size} bytes (valid: up to {LARGEST_BYTES})")
        with np.load(io.BytesIO(content), allow_pickle=False) as found:
            return _stored(found)
    except _DAMAGES as error:
        raise DataError(str(error)) from error


def _stored(found: Mapping[str, Any]) -> StoredData:
    # a file of a stiffbench that did not store the instrument's noise lacks it
    names = [item.name for item in fields(Samples) if item.name in found]
    samples = Samples(**{name: found[name] for name in names})
    joint_names = tuple(str(name) for name in found["joint_names"])
    types = found["joint_types"]
    if len(types) != len(joint_names):
        raise DataError(f"{len(types)} joint_types for {len(joint_names)} joint_names")
    tcp_on_flange = geometry = None
    if "tcp_on_flange" in found:
        tcp_on_flange = frozen_array(found["tcp_on_flange"], "tcp_on_flange", (3,))
    if f"{_OF_ROBOT}tcp" in found:
        arrays = {name: found[f"{_OF_ROBOT}{name}"] for name in _ROBOT_ARRAYS}
        joint_types: Any = tuple(str(kind) for kind in types)
        geometry = Robot(str(found["robot"]), joint_names, joint_types=joint_types, **arrays)
    return StoredData(
        samples=samples,
        torque=frozen_array(found["torque"], "torque", (len(samples), len(joint_names))),
        joint_names=joint_names,
        robot=str(found["robot"]),
        tcp=frozen_array(found["tcp"], "tcp", (len(samples), 3)),
        torque_units=tuple("N" if kind == "prismatic" else "Nm" for kind in types),
        tcp_on_flange=tcp_on_flange,
        geometry=geometry,
    )


_DAMAGES = (
    *(ValueError, KeyError, TypeError, EOFError, MemoryError, RuntimeError, NotImplementedError),
    *(zlib.error, lzma.LZMAError, zipfile.BadZipFile, DataError),
)
"""What a file that is none of ours can raise, or one that somebody made to do so."""
