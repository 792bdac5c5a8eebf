"""Why an optional model cannot be used here; imports nothing heavy, so that lists come at once."""

from __future__ import annotations

from pathlib import Path

from stiff_protocols.contract.extras import missing


def missing_pytabkit() -> str:
    """Return why `realmlp` and `tabm` cannot be used here; "" where they can."""
    return missing("pytabkit")


def missing_tabpfn(model_path: str = "") -> str:
    """Return why `tabpfn` cannot be used here: no package, or no weights; "" where it can.

    `model_path` is the file of weights; "": the package's default in its own cache folder.
    """
    if reason := missing("tabpfn"):
        return reason
    file = Path(model_path) if model_path else _default_weights()
    if file.is_file():
        return ""
    return (
        f"needs its weights, {file} is not there (nothing is downloaded at run time): "
        "set tabpfn.model_path to a file of a TabPFN regressor"
    )


def _default_weights() -> Path:
    from tabpfn.model_loading import resolve_model_path, resolve_model_version

    version = resolve_model_version(None)
    (path,), *_ = resolve_model_path(None, "regressor", version.value)
    return Path(path)
