"""URDF -> `Robot`, through Pinocchio."""

from __future__ import annotations

import os
import re
import tempfile
from collections import Counter
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from importlib.resources import as_file, files
from pathlib import Path
from xml.etree import ElementTree

import numpy as np
import pinocchio as pin

from stiff_protocols.contract.errors import DataError
from stiff_protocols.contract.types import FloatArray, JointType, Robot

LONGEST_TCP_M = 5.0
"""No tool is longer; a larger number was written in mm."""


LARGEST_URDF = 2**24
"""Bytes; a twin's file may name any file, and some (/dev/zero) have no end."""
DEEPEST_XML, MOST_JOINTS = 50, 1000
"""Of a URDF; more ends the C++ parser's stack, and with it the process."""


@dataclass(frozen=True)
class ChainModel:
    """Pinocchio's model of a serial chain.

    Attributes:
        model: Pinocchio model, fixed base.
        name: name of the robot.
        tcp: (3,) tool centre point in the last joint's frame, m.
        flange: pose of the URDF's last link in the last joint's frame, m.
    """

    model: pin.Model
    name: str
    tcp: FloatArray
    flange: pin.SE3


def read_chain(urdf: Path, *, tcp: Sequence[float] = (0.0, 0.0, 0.0)) -> ChainModel:
    """Read a URDF whose moving joints form one serial chain.

    Args:
        urdf: the file; its meshes are not needed.
        tcp: (3,) tool centre point in the frame of the URDF's last link, m.

    Raises:
        DataError: the file is no URDF, its joints are no single serial chain, or limits are
            reversed.
    """
    model = _parse(urdf)
    if model.njoints < 2:
        raise DataError(f"{urdf}: no moving joint; a stiffness model needs at least one")
    for joint in range(1, model.njoints):
        if model.parents[joint] != joint - 1:
            raise DataError(
                f"{urdf}: joint {model.names[joint]!r} branches off {model.names[joint - 1]!r}; "
                "only one serial chain of revolute or prismatic joints is supported"
            )
    for name, low, high in zip(list(model.names)[1:], *_limits(model), strict=True):
        if not low < high:
            raise DataError(
                f"{urdf}: joint {name!r} has limits {low:g}..{high:g}; expected "
                "lower below upper (or type continuous, which has none)"
            )
    offset = np.asarray(tcp, dtype=np.float64)
    if offset.shape != (3,) or not np.isfinite(offset).all() or abs(offset).max() > LONGEST_TCP_M:
        raise DataError(
            f"tcp {list(tcp)} is no tool centre point: three finite lengths in m, "
            f"each within +-{LONGEST_TCP_M:g}"
        )
    flange = _tip_placement(model, urdf)
    chain = ChainModel(model, model.name, flange.act(offset), flange)
    try:
        robot_of(chain)  # Pinocchio takes what no robot has: NaN, an axis without direction
    except DataError as error:
        raise DataError(f"{urdf}: {error}") from error
    return chain


def load_robot(urdf: Path, *, tcp: Sequence[float] = (0.0, 0.0, 0.0)) -> Robot:
    """Read a URDF into a frozen `Robot`; arguments and errors as `read_chain`."""
    return robot_of(read_chain(urdf, tcp=tcp))


def robot_of(chain: ChainModel) -> Robot:
    """Return the same robot without Pinocchio.

    Raises:
        DataError: a joint has more than one degree of freedom.
    """
    model = chain.model
    joints = range(1, model.njoints)
    kinds_and_axes = [joint_type_and_axis(model, joint) for joint in joints]
    lower, upper = _limits(model)
    return Robot(
        name=chain.name,
        joint_names=tuple(model.names[joint] for joint in joints),
        joint_types=tuple(kind for kind, _ in kinds_and_axes),
        placements=np.stack([model.jointPlacements[joint].homogeneous for joint in joints]),
        axes=np.stack([axis for _, axis in kinds_and_axes]),
        lower=lower,
        upper=upper,
        masses=np.array([model.inertias[joint].mass for joint in joints]),
        centres_of_mass=np.stack([model.inertias[joint].lever for joint in joints]),
        tcp=chain.tcp,
        flange=chain.flange.homogeneous,
    )


def shipped_names() -> tuple[str, ...]:
    """Return the names of stiffbench's own URDF files, without their ending."""
    folder = files("stiff_datasets.robots")
    return tuple(sorted(f.name[:-5] for f in folder.iterdir() if f.name.endswith(".urdf")))


def shipped_chain(name: str, *, tcp: Sequence[float]) -> ChainModel:
    """Read one of stiffbench's own URDF files, named without its ending."""
    with as_file(files("stiff_datasets.robots") / f"{name}.urdf") as path:
        return read_chain(path, tcp=tcp)


def shipped_robot(name: str, *, tcp: Sequence[float]) -> Robot:
    """Read one of stiffbench's own URDF files, named without its ending, into a `Robot`."""
    return robot_of(shipped_chain(name, tcp=tcp))


def _parse(urdf: Path) -> pin.Model:
    try:
        with urdf.open("rb") as file:
            content = file.read(LARGEST_URDF + 1)
        text = content.decode()
    except UnicodeDecodeError as error:
        raise DataError(f"{urdf}: cannot read the URDF: no text in UTF-8") from error
    except (OSError, ValueError) as error:  # ValueError: a name that holds NUL
        reason = getattr(error, "strerror", None) or error
        raise DataError(f"{urdf}: cannot read the URDF: {reason}") from error
    if len(content) > LARGEST_URDF:
        raise DataError(f"{urdf}: larger than {LARGEST_URDF} bytes, which no robot's URDF is")
    try:
        _check_description(ElementTree.fromstring(text), urdf)
        with _captured_stderr() as printed:
            model = pin.buildModelFromXML(text)
        if any("Could not parse inertial" in line for line in printed):
            raise ValueError  # the parser leaves such a link without mass
        return model
    except ElementTree.ParseError as error:
        raise DataError(f"{urdf}: not a robot description (URDF): not XML: {error}") from error
    except (ValueError, RuntimeError) as error:
        found = [re.sub(r"^Error: +|^at line \d+ in \S+$", "", line.strip()) for line in printed]
        reason = next(filter(None, found), str(error))  # the first message is the cause
        reason += "".join(f"; {line}" for line in found if "inertial element for Link" in line)
        raise DataError(f"{urdf}: not a robot description (URDF): {reason}") from error


def _check_description(root: ElementTree.Element, urdf: Path) -> None:
    """Refuse what the C++ parser follows until the stack ends, and what no model here has."""
    if root.find(".//mimic") is not None:
        raise DataError(f"{urdf}: has a mimic joint; only independent joints are supported")
    level = [root]
    for _ in range(DEEPEST_XML):
        level = [child for element in level for child in element]
    if level:
        raise DataError(f"{urdf}: more than {DEEPEST_XML} elements inside each other")
    if len(root.findall("joint")) > MOST_JOINTS:
        raise DataError(f"{urdf}: more than {MOST_JOINTS} joints")
    children = Counter(child.get("link") for child in root.findall("joint/child"))
    for link, count in children.items():
        if count > 1:
            raise DataError(f"{urdf}: link {link!r} is the child of {count} joints (valid: one)")


@contextmanager
def _captured_stderr() -> Iterator[list[str]]:
    """Catch what the C++ parser prints on standard error, and give it as lines afterwards."""
    lines: list[str] = []
    with tempfile.TemporaryFile() as file:
        kept = os.dup(2)
        os.dup2(file.fileno(), 2)
        try:
            yield lines
        finally:
            os.dup2(kept, 2)
            os.close(kept)
            file.seek(0)
            lines += file.read().decode(errors="replace").split("\n")


def joint_type_and_axis(model: pin.Model, joint: int) -> tuple[JointType, FloatArray]:
    """Read a joint's kind and (3,) unit axis off its motion subspace (linear part first).

    Raises:
        DataError: the joint has more than one degree of freedom.
    """
    joint_model = model.joints[joint]
    if joint_model.nv != 1:
        raise DataError(
            f"{model.name}: joint {model.names[joint]!r} has {joint_model.nv} degrees of freedom; "
            "only revolute, continuous and prismatic joints are supported"
        )
    data = joint_model.createData()
    at_zero = np.zeros(joint_model.nq)
    if joint_model.nq == 2:  # a continuous joint is stored as cosine and sine
        at_zero[0] = 1.0
    joint_model.calc(data, at_zero)
    subspace = np.asarray(data.S, dtype=np.float64).reshape(6)
    if np.abs(subspace[:3]).max() > 0.0:
        return "prismatic", subspace[:3]
    return "revolute", subspace[3:]


def _limits(model: pin.Model) -> tuple[FloatArray, FloatArray]:
    """Return (n_joints,) lower and upper limits, infinite where there are none."""
    lower, upper = [], []
    for joint in range(1, model.njoints):
        entry = model.joints[joint].idx_q
        bounded = model.joints[joint].nq == 1
        lower.append(model.lowerPositionLimit[entry] if bounded else -np.inf)
        upper.append(model.upperPositionLimit[entry] if bounded else np.inf)
    return np.array(lower), np.array(upper)


def _tip_placement(model: pin.Model, urdf: Path) -> pin.SE3:
    """Return the pose of the last link in the last joint's frame."""
    parents = {frame.parentFrame for frame in model.frames}
    tips = [
        frame
        for index, frame in enumerate(model.frames)
        if frame.parentJoint == model.njoints - 1
        and frame.type == pin.FrameType.BODY
        and index not in parents
    ]
    if len(tips) != 1:
        names = ", ".join(frame.name for frame in tips)
        raise DataError(
            f"{urdf}: the last link is not unique ({names}); keep one of them, so that the "
            "tool centre point has a frame"
        )
    return tips[0].placement
