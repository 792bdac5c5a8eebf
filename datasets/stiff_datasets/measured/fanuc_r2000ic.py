"""`fanuc-r2000ic`: 43 MEASURED deflections of a FANUC R-2000iC (card: data/fanuc_r2000ic.md)."""

from __future__ import annotations

from hashlib import sha256
from importlib.resources import as_file, files

from stiff_datasets.measured.sample_file import read_samples
from stiff_datasets.robots.shipped_robots import named_robot
from stiff_protocols.contract.errors import DataError
from stiff_protocols.contract.types import BenchmarkData

CSV_SHA256 = "dd5552afc40c6be927677e640449d75c9ba29891c2d0dfb1e5db721ef531f94c"
"""Of data/fanuc_r2000ic.csv; also in its data card."""


class FanucR2000iC:
    """The shipped measurement."""

    def load(self) -> BenchmarkData:
        """Read the shipped files.

        Raises:
            DataError: the shipped CSV is not the one its card describes.
        """
        robot = named_robot("fanuc-r2000ic").robot()  # TCP: the drill tip, as published
        with as_file(files("stiff_datasets") / "data" / "fanuc_r2000ic.csv") as path:
            found = sha256(path.read_bytes()).hexdigest()
            if found != CSV_SHA256:
                raise DataError(f"{path}: sha256 {found}, expected {CSV_SHA256}: reinstall")
            return BenchmarkData(read_samples(path, robot), robot)
