"""Why an optional model cannot be used here; imports nothing heavy, so that lists come at once."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

from stiff_protocols.contract.extras import missing


def missing_pytabkit() -> str:
    """Return why `realmlp` and `tabm` cannot be used here; "" where they can."""
    return missing("pytabkit")


def missing_tabpfn(model_path: str = "") -> str:
    """Return why `tabpfn` cannot be used here: no package, or no weights; "" where it can.

    `model_path` is the file of weights; "": the package's default in its own cache folder.
    """
    return missing("tabpfn") or _missing_weights("tabpfn", model_path, _tabpfn_weights)


def missing_tabicl(model_path: str = "") -> str:
    """Return why `tabicl` cannot be used here: no package, or no weights; "" where it can.

    `model_path` is the file of weights; "": the package's default in Hugging Face's cache folder.
    """
    return missing("tabicl") or _missing_weights("tabicl", model_path, _tabicl_weights)


def _missing_weights(key: str, model_path: str, default: Callable[[], Path]) -> str:
    file = Path(model_path) if model_path else default()
    if file.is_file():
        return ""
    return (
        f"needs its weights, {file} is not there (nothing is downloaded at run time): "
        f"set {key}.model_path to a file of weights of the package's regressor"
    )


def _tabpfn_weights() -> Path:
    from tabpfn.model_loading import resolve_model_path, resolve_model_version

    version = resolve_model_version(None)
    (path,), *_ = resolve_model_path(None, "regressor", version.value)
    return Path(path)


def _tabicl_weights() -> Path:
    from huggingface_hub import try_to_load_from_cache
    from tabicl import TabICLRegressor

    name = TabICLRegressor().checkpoint_version
    cached_file = try_to_load_from_cache("jingang/TabICL", name)  # a path, or why there is none
    return Path(cached_file if isinstance(cached_file, str) else name)
