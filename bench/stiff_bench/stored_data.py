"""The samples behind the results of a folder: what a comparison needs to say where models differ.

::

    OUTPUT/data/<sha256>.npz       samples, robot's name, joint torques of the loads, TCP positions

Once a data set, so that a folder of results can be judged without the data set's own files.
"""

from __future__ import annotations

import zipfile
import zlib
from dataclasses import dataclass, fields
from pathlib import Path

import numpy as np

from stiff_protocols.errors import StoreError
from stiff_protocols.files import written_whole
from stiff_protocols.types import BenchmarkData, FloatArray, Samples


@dataclass(frozen=True, eq=False)
class StoredData:
    """A data set as a results folder keeps it.

    Attributes:
        samples: all of them.
        torque: (n, n_joints) N m (N), of the loads on the joints.
        joint_names: base to tip.
        robot: its name.
        tcp: (n, 3) m, where the unloaded TCP is in the base frame; None in a folder from before it
            was stored.
        torque_units: one a joint, "Nm" of a revolute one, "N" of a prismatic one.
    """

    samples: Samples
    torque: FloatArray
    joint_names: tuple[str, ...]
    robot: str
    tcp: FloatArray | None
    torque_units: tuple[str, ...]


def write_data(folder: Path, data: BenchmarkData, sha256: str) -> None:
    """Store a data set under its hash, unless it is there; a damaged or older file is replaced."""
    path = folder / f"{sha256}.npz"
    if _is_whole(folder, sha256):
        return
    from stiff_bench.statics import load_torque  # what only reads data needs no kinematics
    from stiff_protocols.forward_kinematics import tcp_position

    arrays = {item.name: getattr(data.samples, item.name) for item in fields(Samples)}
    with written_whole(path) as temporary, temporary.open("wb") as file:
        np.savez_compressed(
            file,
            torque=load_torque(data),
            tcp=tcp_position(data.robot, data.samples.q),
            joint_types=np.array(data.robot.joint_types),
            joint_names=np.array(data.robot.joint_names),
            robot=np.array(data.robot.name),
            **arrays,
        )


def _is_whole(folder: Path, sha256: str) -> bool:
    """Say whether the data set is there, undamaged and with all that is stored now."""
    try:
        return read_data(folder, sha256).tcp is not None
    except StoreError:
        return False


def read_data(folder: Path, sha256: str) -> StoredData:
    """Read a stored data set.

    Raises:
        StoreError: there is none, or it is damaged.
    """
    path = folder / f"{sha256}.npz"
    try:
        with path.open("rb") as file, np.load(file, allow_pickle=False) as found:
            samples = Samples(**{item.name: found[item.name] for item in fields(Samples)})
            joint_names = tuple(found["joint_names"].tolist())
            types = (
                found["joint_types"].tolist()
                if "joint_types" in found
                else ["revolute"] * len(joint_names)
            )
            return StoredData(
                samples=samples,
                torque=found["torque"],
                joint_names=joint_names,
                robot=str(found["robot"]),
                tcp=found["tcp"] if "tcp" in found else None,
                torque_units=tuple("N" if kind == "prismatic" else "Nm" for kind in types),
            )
    except OSError as error:
        raise StoreError(f"{path}: cannot be read: {error.strerror or error}") from error
    except (ValueError, KeyError, EOFError, zlib.error, zipfile.BadZipFile) as error:
        raise StoreError(f"{path}: damaged: {error}") from error
