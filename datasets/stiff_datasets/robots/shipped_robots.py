"""The robots that a command can name, with the tool and the payload that they are used with.

A robot's tool and payload stand in the file of its twin's constants, ``twins/URDF.toml``. A robot
without a twin has them here.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cache
from importlib.resources import as_file, files

from stiff_datasets.robots.urdf_reader import ChainModel, read_chain
from stiff_protocols.contract.errors import unknown_name
from stiff_protocols.contract.files import read_toml
from stiff_protocols.contract.types import Robot

DEFAULT_ROBOT = "kr10-r1100-2"


@dataclass(frozen=True)
class ShippedRobot:
    """One of stiffbench's own URDF files.

    Attributes:
        urdf: its name without the ending.
        tcp: (3,) tool centre point in the frame of the URDF's last link, m.
        payload_kg: None where the data's source does not name the robot's variant.
    """

    urdf: str
    tcp: tuple[float, float, float]
    payload_kg: float | None

    def robot(self, tcp: Sequence[float] | None = None) -> Robot:
        """Read it for models, with another TCP if one is given."""
        return shipped_robot(self.urdf, tcp=self.tcp if tcp is None else tcp)


WITHOUT_TWIN = (ShippedRobot("fanuc_r2000ic", (0.0069, 0.2453, 0.3193), None),)


@cache
def shipped_robots() -> dict[str, ShippedRobot]:
    """Return the names of the robots on the command line -> the robots, the default one first."""
    found = {}
    for file in (files("stiff_datasets") / "twins").iterdir():
        with as_file(file) as path:
            constants = read_toml(path)
        if constants["urdf"] == path.stem:  # the others are twins of the same robots
            x, y, z = constants["tcp_m"]
            found[path.stem] = ShippedRobot(path.stem, (x, y, z), constants["payload_kg"])
    found |= {robot.urdf: robot for robot in WITHOUT_TWIN}
    named = {urdf.replace("_", "-"): robot for urdf, robot in sorted(found.items())}
    return {DEFAULT_ROBOT: named[DEFAULT_ROBOT], **named}


def named_robot(name: str) -> ShippedRobot:
    """Return the robot of a name.

    Raises:
        ConfigError: there is none.
    """
    robots = shipped_robots()
    if name not in robots:
        raise unknown_name("robot", name, robots)
    return robots[name]


@cache
def shipped_chain(name: str, tcp: tuple[float, ...]) -> ChainModel:
    """Read one of stiffbench's own URDF files, named without its ending."""
    with as_file(files("stiff_datasets.robots") / f"{name}.urdf") as path:
        return read_chain(path, tcp=tcp)


def shipped_robot(name: str, *, tcp: Sequence[float]) -> Robot:
    """Read one of stiffbench's own URDF files, named without its ending, into a `Robot`."""
    return shipped_chain(name, tuple(tcp)).robot
