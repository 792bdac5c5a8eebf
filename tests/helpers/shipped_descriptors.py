"""The CSV data files of stiffbench, and a program that writes their descriptors.

After a change of a file, its card or the code: ``python tests/helpers/shipped_descriptors.py``.
"""

from __future__ import annotations

from pathlib import Path

from stiff_datasets.measured.descriptors import Descriptor, describe, write_descriptors
from stiff_datasets.robots.shipped_robots import named_robot

FOLDER = Path(__file__).parents[2] / "datasets" / "stiff_datasets" / "data"
ROBOTS = {"fanuc_r2000ic.csv": "fanuc-r2000ic", "fanuc_drilling.csv": "fanuc-r2000ic"}
"""Name of the file -> its robot."""


def described(name: str) -> Descriptor:
    return describe(FOLDER / name, named_robot(ROBOTS[name]).robot())


if __name__ == "__main__":
    for file in ROBOTS:
        print(*write_descriptors(FOLDER / file, described(file)))
