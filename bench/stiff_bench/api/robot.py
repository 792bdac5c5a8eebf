"""Robots by their descriptions."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

from stiff_protocols.contract import robot as contract


class _EveryRobot(type):
    """Takes every robot for an instance: the loaders of data sets know the contract's class alone.

    The contract cannot have the ways to get one, which are of the data sets above it.
    """

    def __instancecheck__(cls, instance: object) -> bool:
        return isinstance(instance, contract.Robot)


class Robot(contract.Robot, metaclass=_EveryRobot):
    """A serial robot, see `stiff_protocols.contract.robot.Robot`, with the ways to get one."""

    @staticmethod
    def from_urdf(
        file: Path | str, *, tcp: Sequence[float] = (0.0, 0.0, 0.0), tip: str | None = None
    ) -> contract.Robot:
        """Read a robot description; its meshes are not needed.

        Args:
            file: URDF.
            tcp: (3,) tool centre point in the frame of the last link, m.
            tip: last link of the chain; None: the end of the longest one, which is printed where
                the description leaves a choice.

        Raises:
            ConfigError: no link is called `tip`.
            DataError: it is not a URDF, or the chain has a joint that is not supported.
        """
        from stiff_bench.plan.robot_words import RobotWords

        return RobotWords(urdf=file, tcp=tcp, tip=tip).read()[0]

    @staticmethod
    def shipped(name: str) -> contract.Robot:
        """Return a robot that stiffbench ships, with the tool of its data set.

        Args:
            name: "kr10-r1100-2", "ur5", "fanuc-r2000ic" or an arm of `arm-family` such as "gp12".

        Raises:
            ConfigError: there is no such robot.
        """
        from stiff_datasets.robots.shipped import named_robot

        return named_robot(name).robot()
