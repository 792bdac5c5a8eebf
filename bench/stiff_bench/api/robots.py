"""Load robots by name or from a description."""

from __future__ import annotations

import shlex
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any
from weakref import WeakKeyDictionary

import numpy as np

from stiff_bench.console import say
from stiff_datasets.measured.data_card import tcp_option
from stiff_datasets.robots.shipped_robots import DEFAULT_ROBOT as DEFAULT_ROBOT
from stiff_datasets.robots.shipped_robots import named_robot, shipped_robots
from stiff_protocols.contract.types import Robot

URDF_OPTIONS: WeakKeyDictionary[Robot, dict[str, Any]] = WeakKeyDictionary()
"""Robot that was read from a URDF -> the arguments of `read_robot` that read it again."""


def load_robot(name: str = DEFAULT_ROBOT, *, tcp: Sequence[float] | None = None) -> Robot:
    """Return a shipped robot.

    Args:
        name: "kr10-r1100-2", "ur5", "fanuc-r2000ic" or an arm of `arm-family` such as "gp12".
        tcp: (3,) tool centre point in the frame of the last link, m; None: as in its data set.

    Raises:
        ConfigError: the name is unknown.
    """
    return named_robot(name).robot(tcp)


def read_robot(
    urdf: Path | str,
    *,
    tcp: Sequence[float] | None = None,
    tip: str | None = None,
    base: str | None = None,
    hold: Mapping[str, float | None] | None = None,
) -> Robot:
    """Read a robot description; its meshes are not needed.

    Args:
        urdf: URDF file.
        tcp: (3,) tool centre point in the frame of the last link, m; None: its origin.
        tip: last link of the chain; None: end of the longest chain, which is printed if there are
            several.
        base: link that the chain starts from, and the base frame; None: the URDF's first link.
        hold: joints that do not move, such as a rail: deg or mm by name or number (rail, J3, 3).
            The robot has the other joints; mimic joints follow.

    Raises:
        ConfigError: no link is called `tip` or `base`, or a joint cannot be held.
        DataError: the file is not a URDF, or the chain has an unsupported joint.
    """
    from stiff_datasets.robots.urdf_reader import read_chain  # imports Pinocchio

    offset = (0.0, 0.0, 0.0) if tcp is None else tcp
    chain = read_chain(Path(urdf), tcp=offset, tip=tip, base=base, hold=hold)
    for note in chain.notes:
        say(f"note: {note}")
    URDF_OPTIONS[chain.robot] = {
        "urdf": Path(urdf),
        "tcp": tcp,
        "tip": tip,
        "base": base,
        "hold": hold,
    }
    return chain.robot


def as_robot(robot: str | Robot | None) -> Robot:
    """Return the robot for a name or a robot; the KR10 for None."""
    return robot if isinstance(robot, Robot) else load_robot(robot or DEFAULT_ROBOT)


def shipped_name(robot: Robot) -> str:
    """Return the shipped robot's name for any tool; "" if the robot is not shipped."""
    for name, shipped in shipped_robots().items():
        if shipped.urdf == robot.name:
            shipped_robot = shipped.robot()
            geometry = ("placements", "axes", "lower", "upper", "mimics")
            if all(
                np.array_equal(getattr(shipped_robot, attribute), getattr(robot, attribute))
                for attribute in geometry
            ):
                return name
    return ""


def same_geometry(robot: Robot, model_robot: Robot) -> bool:
    """Return whether two robots have the same joints, links and TCP."""
    joints = [(of.joint_types, of.mimics) for of in (robot, model_robot)]
    return joints[0] == joints[1] and all(
        np.allclose(getattr(robot, name), getattr(model_robot, name), atol=1e-9)
        for name in ("placements", "axes", "tcp")
    )


def payload_of(robot: Robot) -> float | None:
    """Return the rated payload of a robot, kg; None: unknown."""
    name = shipped_name(robot)
    return named_robot(name).payload_kg if name else None


def robot_words(robot: Robot) -> str:
    """Return the command line options that name a robot, after a space."""
    if given := URDF_OPTIONS.get(robot):
        pairs = [(name, given[name]) for name in ("urdf", "tip", "base")]
        pairs += [("hold", f"{name}={value:.15g}") for name, value in (given["hold"] or {}).items()]
        options = [word for name, value in pairs if value for word in (f"--{name}", str(value))]
        tool = "" if given["tcp"] is None else f" {tcp_option(given['tcp'])}"
        return f" {shlex.join(options)}{tool}"
    if not (name := shipped_name(robot)):
        return " with the same --urdf, --tip, --base, --hold and --tcp"
    tcp = robot.tcp_on_flange
    tool = f" {tcp_option(tcp)}"
    words = "" if name == DEFAULT_ROBOT else f" --robot {name}"
    return words if np.allclose(tcp, named_robot(name).tcp, atol=1e-9) else words + tool
