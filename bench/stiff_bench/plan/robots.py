"""The words of a command line that name a robot."""

from __future__ import annotations

import math
import shlex
from dataclasses import dataclass
from pathlib import Path

from stiff_datasets.robots.robot import ChainModel, read_chain, robot_of
from stiff_datasets.robots.shipped import DEFAULT_ROBOT, named_robot
from stiff_protocols.contract.errors import ConfigError
from stiff_protocols.contract.types import Robot


@dataclass(frozen=True)
class RobotWords:
    """The three options that name a robot; empty ones were not given."""

    robot: str | None
    urdf: Path | None
    tcp: str

    @property
    def given(self) -> bool:
        """Whether any of them was given."""
        return bool(self.robot or self.urdf or self.tcp)

    @property
    def text(self) -> str:
        """The same words for another command line, with a space before; "" for none."""
        pairs = (("--robot", self.robot), ("--urdf", self.urdf), ("--tcp", self.tcp))
        return "".join(f" {name} {shlex.quote(str(value))}" for name, value in pairs if value)

    @property
    def is_papers(self) -> bool:
        """Whether it is the shipped KR10 of the source paper."""
        return self.urdf is None and (self.robot or DEFAULT_ROBOT) == DEFAULT_ROBOT

    def read(self) -> tuple[Robot, ChainModel, float | None]:
        """Return the robot, its chain, and its payload in kg if it is known.

        Raises:
            ConfigError: two robots were named, or an unknown one.
            DataError: the URDF cannot be read.
        """
        if self.urdf is not None:
            if self.robot is not None:
                raise ConfigError(f"--robot {self.robot} and --urdf {self.urdf}: give one of them")
            chain, payload_kg = read_chain(self.urdf, tcp=parse_tcp(self.tcp)), None
        else:
            shipped = named_robot(self.robot or DEFAULT_ROBOT)
            chain = shipped.chain(parse_tcp(self.tcp) if self.tcp else None)
            payload_kg = shipped.payload_kg
        return robot_of(chain), chain, payload_kg


def parse_tcp(text: str) -> tuple[float, float, float]:
    """Read the "x,y,z" of a TCP, m; an empty text is the origin.

    Raises:
        ConfigError: it is no such text.
    """
    words = (text or "0,0,0").split(",")
    try:
        x, y, z = (float(word) for word in words)
    except ValueError:
        raise ConfigError(f"--tcp {text!r}: expected three lengths in m, x,y,z") from None
    if not all(math.isfinite(value) for value in (x, y, z)):
        raise ConfigError(f"--tcp {text!r}: expected three finite lengths in m, x,y,z")
    return x, y, z
