"""Optional packages, and the extra of stiffbench that installs each."""

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
    """Return the reason why a feature with these packages cannot be used; "" if installed.

    They are import names in `EXTRAS`. Nothing is imported, so that lists appear at once.
    """
    absent = [name for name in packages if importlib.util.find_spec(name) is None]
    if not absent:
        return ""
    kind = "package" if len(absent) == 1 else "packages"
    extra = EXTRAS[absent[0]]
    return f"needs the {kind} {' and '.join(absent)}: pip install 'stiffbench[{extra}]'"


def require(feature: str, *packages: str) -> None:
    """Raise ConfigError with the missing extra if a package of the feature is missing."""
    if reason := missing(*packages):
        raise ConfigError(f"{feature} {reason}")
