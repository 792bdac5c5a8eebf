"""List the shipped robots with their tool and payload.

The file of the twin's constants, ``twins/URDF.toml``, contains a robot's tool and payload. For a
robot without a twin they are defined here.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cache
from importlib.resources import as_file, files
from typing import TYPE_CHECKING

from stiff_protocols.contract.errors import unknown_name
from stiff_protocols.contract.files import read_toml
from stiff_protocols.contract.types import Robot

if TYPE_CHECKING:
    from stiff_datasets.robots.urdf_reader import ChainModel

DEFAULT_ROBOT = "kr10-r1100-2"
TITLES = {
    **{"fanuc_r2000ic": "FANUC R-2000iC", "kr10_r1100_2": "KR 10", "ur5": "UR5"},
    **{"irb120_3_06": "IRB 120", "tx60": "TX60", "lr_mate_200id": "LR Mate 200iD"},
    **{"gp12": "GP12", "kr16_r1610_2": "KR 16", "m20ib_25": "M-20iB/25"},
    **{"irb4600_40_255": "IRB 4600", "kr70_r2100": "KR 70", "gp180": "GP180"},
    "kr240_r2900_2": "KR 240",
}
"""Names of shipped robots as people say them, by the name in the URDF file."""


@dataclass(frozen=True)
class ShippedRobot:
    """A shipped URDF file.

    Attributes:
        urdf: file name without extension.
        tcp: (3,) tool centre point in the frame of the URDF's last link, m.
        payload_kg: None if the data's source does not name the robot's variant.
    """

    urdf: str
    tcp: tuple[float, float, float]
    payload_kg: float | None

    def robot(self, tcp: Sequence[float] | None = None) -> Robot:
        """Read the robot for models, with another TCP if `tcp` is given."""
        return shipped_robot(self.urdf, tcp=self.tcp if tcp is None else tcp)


WITHOUT_TWIN = (ShippedRobot("fanuc_r2000ic", (0.0069, 0.2453, 0.3193), None),)


@cache
def shipped_robots() -> dict[str, ShippedRobot]:
    """Return the shipped robots: command-line name -> robot, the default first."""
    robots_by_urdf = {}
    for file in (files("stiff_datasets") / "twins").iterdir():
        with as_file(file) as path:
            constants = read_toml(path)
        if constants["urdf"] == path.stem:  # the other files are twins of the same robots
            x, y, z = constants["tcp_m"]
            robots_by_urdf[path.stem] = ShippedRobot(path.stem, (x, y, z), constants["payload_kg"])
    robots_by_urdf |= {robot.urdf: robot for robot in WITHOUT_TWIN}
    robots_by_name = {
        urdf.replace("_", "-"): robot for urdf, robot in sorted(robots_by_urdf.items())
    }
    return {DEFAULT_ROBOT: robots_by_name[DEFAULT_ROBOT], **robots_by_name}


def named_robot(name: str) -> ShippedRobot:
    """Return the robot with a name.

    Raises:
        ConfigError: no robot has this name.
    """
    robots = shipped_robots()
    if name not in robots:
        listed = f"{', '.join(sorted(robots))}; a URDF file by read_robot or --urdf"
        raise unknown_name("robot", name, robots, listed if name.endswith(".urdf") else "")
    return robots[name]


@cache
def shipped_chain(name: str, tcp: tuple[float, ...]) -> ChainModel:
    """Read a shipped URDF file, named without its extension."""
    from stiff_datasets.robots.urdf_reader import read_chain  # imports Pinocchio

    with as_file(files("stiff_datasets.robots") / f"{name}.urdf") as path:
        return read_chain(path, tcp=tcp)


def shipped_robot(name: str, *, tcp: Sequence[float]) -> Robot:
    """Read a shipped URDF file, named without its extension, into a `Robot`."""
    return shipped_chain(name, tuple(tcp)).robot
