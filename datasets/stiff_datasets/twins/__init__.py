"""Constants of the shipped digital twins, one TOML file a robot."""

from __future__ import annotations

from importlib.resources import as_file, files

from stiff_datasets.twin_constants import TwinConstants, read_constants


def shipped_constants(name: str) -> TwinConstants:
    """Read one of stiffbench's own TOML files, named without its ending."""
    with as_file(files("stiff_datasets.twins") / f"{name}.toml") as path:
        return read_constants(path)


def shipped_twins() -> dict[str, str]:
    """Return the names of stiffbench's own twins on the command line -> their TOML files."""
    names = [
        f.name[:-5] for f in files("stiff_datasets.twins").iterdir() if f.name.endswith(".toml")
    ]
    return {name.replace("_", "-"): name for name in sorted(names)}
