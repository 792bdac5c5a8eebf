"""Model files, opened and changed without their reader, as a crafted file may be."""

from __future__ import annotations

import io
import json
import zipfile
from collections.abc import Callable, Mapping
from pathlib import Path
from types import MappingProxyType
from typing import Any

from helpers.quick_models import quick_model


def saved_model(folder: Path, key: str) -> Path:
    """Return the file of a quick model."""
    path = folder / "model.stiff"
    quick_model(key).save(path)
    return path


def changed(
    path: Path,
    change: Callable[[dict[str, Any]], object],
    more: Mapping[str, bytes] = MappingProxyType({}),
) -> Path:
    """Change the tree of a file, give it more members, and return it."""
    parts = members(path.read_bytes())
    content = json.loads(parts["model.json"])
    change(content)
    path.write_bytes(archived({**parts, **more, "model.json": json.dumps(content).encode()}))
    return path


def npy_header(shape: tuple[int, ...], dtype: str) -> bytes:
    """Return the head of an array file."""
    text = f"{{'descr': '{dtype}', 'fortran_order': False, 'shape': {shape}, }}\n".encode()
    return b"\x93NUMPY\x01\x00" + len(text).to_bytes(2, "little") + text


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
