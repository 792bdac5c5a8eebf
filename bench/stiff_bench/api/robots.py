"""Robots by name and by description."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import numpy as np

from stiff_bench.console import say
from stiff_datasets.robots.shipped_robots import DEFAULT_ROBOT as DEFAULT_ROBOT
from stiff_datasets.robots.shipped_robots import named_robot, shipped_robots
from stiff_datasets.robots.urdf_reader import read_chain
from stiff_protocols.contract.types import Robot


def load_robot(name: str = DEFAULT_ROBOT, *, tcp: Sequence[float] | None = None) -> Robot:
    """Return a robot that stiffbench ships.

    Args:
        name: "kr10-r1100-2", "ur5", "fanuc-r2000ic" or an arm of `arm-family` such as "gp12".
        tcp: (3,) tool centre point in the frame of the last link, m; None: that of its data set.

    Raises:
        ConfigError: there is no such robot.
    """
    return named_robot(name).robot(tcp)


def read_robot(
    urdf: Path | str, *, tcp: Sequence[float] | None = None, tip: str | None = None
) -> Robot:
    """Read a robot description; its meshes are not needed.

    Args:
        urdf: the file.
        tcp: (3,) tool centre point in the frame of the last link, m; None: its origin.
        tip: last link of the chain; None: the end of the longest one, which is printed where the
            description leaves a choice.

    Raises:
        ConfigError: no link is called `tip`.
        DataError: it is not a URDF, or the chain has a joint that is not supported.
    """
    chain = read_chain(Path(urdf), tcp=(0.0, 0.0, 0.0) if tcp is None else tcp, tip=tip)
    for note in chain.notes:
        say(f"note: {note}")
    return chain.robot


def as_robot(robot: str | Robot | None) -> Robot:
    """Return a robot that is named, a robot itself, or the KR10 for None."""
    return robot if isinstance(robot, Robot) else load_robot(robot or DEFAULT_ROBOT)


def shipped_name(robot: Robot) -> str:
    """Return the name of the shipped robot that one is, with any tool; "" for another robot."""
    for name, shipped in shipped_robots().items():
        if shipped.urdf == robot.name:
            own = shipped.robot()
            geometry = ("placements", "axes", "lower", "upper")
            if all(np.array_equal(getattr(own, one), getattr(robot, one)) for one in geometry):
                return name
    return ""


def payload_of(robot: Robot) -> float | None:
    """Return the rated payload of a robot, kg; None where it is not known."""
    name = shipped_name(robot)
    return named_robot(name).payload_kg if name else None


def robot_words(robot: Robot) -> str:
    """Return what stands behind a command that names a robot, with a space before."""
    if not (name := shipped_name(robot)):
        return " with the same --urdf, --tip and --tcp"
    tcp = robot.tcp_on_flange
    tool = f" --tcp {','.join(f'{number:g}' for number in tcp)}"
    words = "" if name == DEFAULT_ROBOT else f" --robot {name}"
    return words if np.allclose(tcp, named_robot(name).tcp, atol=1e-9) else words + tool
