"""Model files, opened and changed without their reader, as a crafted file may be."""

from __future__ import annotations

import io
import zipfile
from collections.abc import Callable
from pathlib import Path
from typing import Any

import skops.io

from helpers.quick_models import quick_model
from stiff_models.io.model_file import TRUSTED


def saved_model(folder: Path, key: str) -> Path:
    """Return the file of a quick model."""
    path = folder / "model.stiff"
    quick_model(key).save(path)
    return path


def opened(path: Path) -> dict[str, Any]:
    """Return what a file holds, as `save` gave it to skops."""
    content: dict[str, Any] = skops.io.loads(path.read_bytes(), trusted=list(TRUSTED))
    return content


def changed(path: Path, change: Callable[[dict[str, Any]], object]) -> Path:
    """Change what a file holds, write it as skops does, and return it."""
    content = opened(path)
    change(content)
    path.write_bytes(skops.io.dumps(content))
    return path


def members(data: bytes) -> dict[str, bytes]:
    """Return the members of a zip archive."""
    with zipfile.ZipFile(io.BytesIO(data)) as archive:
        return {name: archive.read(name) for name in archive.namelist()}


def archived(parts: dict[str, bytes], compression: int = zipfile.ZIP_STORED) -> bytes:
    """Return a zip archive of members, with the right checksums."""
    file = io.BytesIO()
    with zipfile.ZipFile(file, "w", compression) as archive:
        for name, content in parts.items():
            archive.writestr(name, content)
    return file.getvalue()
