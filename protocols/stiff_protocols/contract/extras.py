"""Packages that only one optional feature needs: which extra of stiffbench installs each."""

from __future__ import annotations

import importlib.util

from stiff_protocols.contract.errors import ConfigError

EXTRAS = {
    "distributed": "cluster",
    "onnx": "onnx",
    "onnxscript": "onnx",
    "openpyxl": "data",
    "optuna": "tune",
    "pyarrow": "data",
    "pytabkit": "tabular",
    "tabicl": "tabicl",
    "tabpfn": "tabpfn",
    "tomli_w": "data",
}
"""Import name of each package -> the extra, as in pyproject.toml."""


def missing(*packages: str) -> str:
    """Return why what needs these packages cannot be used; "" where they are installed.

    They are import names in `EXTRAS`. Nothing is imported, so that lists come at once.
    """
    absent = [name for name in packages if importlib.util.find_spec(name) is None]
    if not absent:
        return ""
    kind = "package" if len(absent) == 1 else "packages"
    extra = EXTRAS[absent[0]]
    return f"needs the {kind} {' and '.join(absent)}: pip install 'stiffbench[{extra}]'"


def require(feature: str, *packages: str) -> None:
    """Raise ConfigError, which names the extra, where a package of the feature is missing."""
    if reason := missing(*packages):
        raise ConfigError(f"{feature} {reason}")
