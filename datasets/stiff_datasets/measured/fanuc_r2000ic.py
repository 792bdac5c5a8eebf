"""Load `fanuc-r2000ic`: 43 MEASURED deflections of a robot (card: data/fanuc_r2000ic.md)."""

from __future__ import annotations

from importlib.resources import as_file, files

from stiff_datasets.measured.sample_file import read_samples
from stiff_datasets.robots.shipped_robots import named_robot
from stiff_protocols.contract.types import BenchmarkData


class FanucR2000iC:
    """The shipped measurement."""

    def load(self) -> BenchmarkData:
        """Read the shipped file."""
        robot = named_robot("fanuc-r2000ic").robot()  # TCP: the drill tip, as published
        with as_file(files("stiff_datasets") / "data" / "fanuc_r2000ic.csv") as path:
            return BenchmarkData(read_samples(path, robot), robot)
