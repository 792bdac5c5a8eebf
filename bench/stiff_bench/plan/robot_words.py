"""The options of a command that name a robot."""

from __future__ import annotations

import shlex
from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path

from stiff_bench.console import say
from stiff_datasets.robots.robot import ChainModel, read_chain, robot_of
from stiff_datasets.robots.shipped import DEFAULT_ROBOT, named_robot
from stiff_protocols.contract.errors import ConfigError
from stiff_protocols.contract.types import Robot


@dataclass(frozen=True)
class RobotWords:
    """What names a robot; None was not given.

    Attributes:
        robot: name of a shipped one.
        urdf: file of another one.
        tcp: (3,) tool centre point in the frame of the last link, m.
        tip: last link of the chain in `urdf`.

    Raises:
        ConfigError: there is a tip and no URDF.
    """

    robot: str | None = None
    urdf: Path | str | None = None
    tcp: Sequence[float] | None = None
    tip: str | None = None

    def __post_init__(self) -> None:
        if self.urdf is None and self.tip is not None:
            raise ConfigError(f"{self.tip}: names a link of a URDF; give --urdf too", "tip")

    @property
    def given(self) -> bool:
        """Whether any of them was given."""
        return self != NO_ROBOT

    @property
    def text(self) -> str:
        """The same as words of a command line, with a space before; "" for none."""
        tcp = None if self.tcp is None else ",".join(map(str, self.tcp))
        pairs = (
            *(("--robot", self.robot), ("--urdf", self.urdf)),
            *(("--tip", self.tip), ("--tcp", tcp)),
        )
        return "".join(f" {name} {shlex.quote(str(value))}" for name, value in pairs if value)

    @property
    def is_papers(self) -> bool:
        """Whether it is the shipped KR10 of the source paper."""
        return self.urdf is None and self.robot in (None, DEFAULT_ROBOT)

    def read(self) -> tuple[Robot, ChainModel, float | None]:
        """Return the robot, its chain, and its payload in kg if it is known.

        The first call prints what was chosen in a description that leaves a choice.

        Raises:
            ConfigError: two robots were named, an unknown one, or an unknown tip.
            DataError: the URDF cannot be read.
        """
        return self._read

    @cached_property
    def _read(self) -> tuple[Robot, ChainModel, float | None]:
        if self.urdf is not None:
            if self.robot is not None:
                raise ConfigError(f"{self.robot} and urdf {self.urdf}: give one of them", "robot")
            tcp = (0.0, 0.0, 0.0) if self.tcp is None else self.tcp
            chain, payload_kg = read_chain(Path(self.urdf), tcp=tcp, tip=self.tip), None
            for note in chain.notes:
                say(f"note: {note}")
        else:
            shipped = named_robot(DEFAULT_ROBOT if self.robot is None else self.robot)
            chain, payload_kg = shipped.chain(self.tcp), shipped.payload_kg
        return robot_of(chain), chain, payload_kg


NO_ROBOT = RobotWords()
"""No robot was named."""
