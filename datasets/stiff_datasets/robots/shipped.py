"""The robots that a command can name, with the tool and the payload that they are used with."""

from __future__ import annotations

from dataclasses import dataclass

from stiff_datasets.robots.robot import ChainModel, robot_of, shipped_chain
from stiff_protocols.contract.errors import unknown_name
from stiff_protocols.contract.types import Robot


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

    def chain(self, tcp: tuple[float, float, float] | None = None) -> ChainModel:
        """Read it for Pinocchio, with another TCP if one is given."""
        return shipped_chain(self.urdf, tcp=tcp or self.tcp)

    def robot(self) -> Robot:
        """Read it for models."""
        return robot_of(self.chain())


ROBOTS = {
    "kr10-r1100-2": ShippedRobot("kr10_r1100_2", (0.06, 0.0, 0.08), 10.0),
    "fanuc-r2000ic": ShippedRobot("fanuc_r2000ic", (0.0069, 0.2453, 0.3193), None),
    "ur5": ShippedRobot("ur5", (0.0, 0.06, 0.08), 5.0),
    "irb120-3-06": ShippedRobot("irb120_3_06", (0.04, 0.0, 0.054), 3.0),
    "tx60": ShippedRobot("tx60", (0.034, 0.025, 0.056), 3.5),
    "lr-mate-200id": ShippedRobot("lr_mate_200id", (0.016, 0.051, 0.071), 7.0),
    "gp12": ShippedRobot("gp12", (-0.02, 0.061, 0.085), 12.0),
    "kr16-r1610-2": ShippedRobot("kr16_r1610_2", (-0.057, 0.041, 0.094), 16.0),
    "m20ib-25": ShippedRobot("m20ib_25", (-0.081, 0.0, 0.109), 25.0),
    "irb4600-40-255": ShippedRobot("irb4600_40_255", (-0.077, -0.056, 0.127), 40.0),
    "kr70-r2100": ShippedRobot("kr70_r2100", (-0.035, -0.109, 0.153), 70.0),
    "gp180": ShippedRobot("gp180", (0.049, -0.15, 0.21), 180.0),
    "kr240-r2900-2": ShippedRobot("kr240_r2900_2", (0.14, -0.102, 0.231), 240.0),
}
DEFAULT_ROBOT = "kr10-r1100-2"


def named_robot(name: str) -> ShippedRobot:
    """Return the robot of a name.

    Raises:
        ConfigError: there is none.
    """
    if name not in ROBOTS:
        raise unknown_name("robot", name, ROBOTS)
    return ROBOTS[name]
