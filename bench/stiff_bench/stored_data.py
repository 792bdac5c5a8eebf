"""The samples behind the results of a folder: what a comparison needs to say where models differ.

::

    OUTPUT/data/<sha256>.npz       samples, robot's name, joint torques of the loads, TCP positions

Once a data set, so that a folder of results can be judged without the data set's own files.
"""

from __future__ import annotations

import lzma
import re
import zipfile
import zlib
from collections.abc import Mapping
from dataclasses import dataclass, fields
from pathlib import Path
from typing import Any

import numpy as np

from stiff_protocols.errors import DataError, StoreError
from stiff_protocols.files import written_whole
from stiff_protocols.types import BenchmarkData, FloatArray, Samples, frozen_array

LARGEST_BYTES = 4 * 2**30
"""What a file may unpack to: ten million samples. Few bytes can stand for many."""
_HASH = re.compile(r"[0-9A-Za-z]+")


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
    if is_whole(folder, sha256):
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


def is_whole(folder: Path, sha256: str) -> bool:
    """Say whether the data set is there, undamaged and with all that is stored now."""
    try:
        return read_data(folder, sha256).tcp is not None
    except StoreError:
        return False


def read_data(folder: Path, sha256: str) -> StoredData:
    """Read a stored data set.

    Raises:
        StoreError: there is none, it is damaged or too large, or its name is no hash.
    """
    if not _HASH.fullmatch(sha256):
        raise StoreError(f"{folder}: {sha256!r} is no hash of a data set")
    path = folder / f"{sha256}.npz"
    try:
        _check_size(path)
        with path.open("rb") as file, np.load(file, allow_pickle=False) as found:
            return _stored(found)
    except OSError as error:
        raise StoreError(f"{path}: cannot be read: {error.strerror or error}") from error
    except _DAMAGES as error:
        raise StoreError(f"{path}: damaged: {error}") from error


def _check_size(path: Path) -> None:
    """See that a file is a plain one (a pipe would never end) and unpacks to no more than said."""
    if path.exists() and not path.is_file():
        raise StoreError(f"{path}: no plain file")
    with zipfile.ZipFile(path) as parts:
        size = sum(part.file_size for part in parts.infolist())
    if size > LARGEST_BYTES:
        raise StoreError(f"{path}: unpacks to {size} bytes (valid: up to {LARGEST_BYTES})")


def _stored(found: Mapping[str, Any]) -> StoredData:
    samples = Samples(**{item.name: found[item.name] for item in fields(Samples)})
    joint_names = tuple(str(name) for name in found["joint_names"])
    types = found["joint_types"] if "joint_types" in found else ["revolute"] * len(joint_names)
    if len(types) != len(joint_names):
        raise DataError(f"{len(types)} joint_types for {len(joint_names)} joint_names")
    tcp = found["tcp"] if "tcp" in found else None
    return StoredData(
        samples=samples,
        torque=frozen_array(found["torque"], "torque", (len(samples), len(joint_names))),
        joint_names=joint_names,
        robot=str(found["robot"]),
        tcp=None if tcp is None else frozen_array(tcp, "tcp", (len(samples), 3)),
        torque_units=tuple("N" if kind == "prismatic" else "Nm" for kind in types),
    )


_DAMAGES = (
    *(ValueError, KeyError, TypeError, EOFError, MemoryError, RuntimeError, NotImplementedError),
    *(zlib.error, lzma.LZMAError, zipfile.BadZipFile, DataError),
)
"""What a file that is none of ours can raise, or one that somebody made to do so."""
