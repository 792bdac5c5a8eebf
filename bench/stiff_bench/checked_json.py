"""JSON files that say whether they are whole.

A file is one line, ``{"schema":3,"sha256":"...","content":{...}}``; the checksum is over the bytes
of the content as they stand there, so that nothing need be written anew to check it.
"""

from __future__ import annotations

import hashlib
import json
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np
import orjson

from stiff_protocols.errors import StoreError
from stiff_protocols.files import read_plain, written_whole
from stiff_protocols.record import SCHEMA

_CONTENT, _END = b'"content":', b"}\n"
"""What stands before and behind the content of a file."""


class DamagedFile(StoreError):
    """A file does not hold what was once written there.

    Attributes:
        path: of it.
    """

    def __init__(self, path: Path, why: str) -> None:
        """Store the path and say why."""
        super().__init__(f"{path}: damaged: {why}")
        self.path = path


def write_checked(path: Path, content: Mapping[str, Any]) -> None:
    """Write a file, whole or not at all.

    Raises:
        StoreError: it cannot be written.
    """
    stored = json_text(content).encode()
    head = f'{{"schema":{SCHEMA},"sha256":"{_checksum(stored)}",'.encode()
    with written_whole(path) as temporary:
        temporary.write_bytes(b"".join((head, _CONTENT, stored, _END)))


def json_text(content: Any) -> str:
    """Return strict JSON, arrays as lists.

    What is no character becomes a question mark: a file's name may hold such bytes.
    """
    text = json.dumps(
        content,
        ensure_ascii=False,
        allow_nan=False,
        separators=(",", ":"),
        default=np.ndarray.tolist,
    )
    return text.encode(errors="replace").decode()


def read_checked(path: Path) -> dict[str, Any]:
    """Read a file's content.

    Raises:
        DamagedFile: it is damaged.
        StoreError: it cannot be read, or is of another format.
    """
    try:
        raw = read_plain(path)
        stored = orjson.loads(raw)
        content, checksum, schema = stored["content"], stored["sha256"], stored["schema"]
    except OSError as error:
        raise StoreError(f"{path}: cannot be read: {error.strerror or error}") from error
    except (ValueError, KeyError, TypeError) as error:
        raise DamagedFile(path, str(error)) from error
    refuse_other_format(path, schema)
    if _checksum(raw.partition(_CONTENT)[2].removesuffix(_END)) != checksum:
        raise DamagedFile(path, "its checksum does not match its content")
    if not isinstance(content, dict):
        raise DamagedFile(path, "its content is no table of names and values")
    return content


def refuse_other_format(path: Path, schema: object) -> None:
    """See that a file has the format that this stiffbench reads.

    Raises:
        StoreError: it has not.
    """
    if schema != SCHEMA:
        raise StoreError(
            f"{path}: stored format {schema}, this stiffbench reads {SCHEMA}; run again into a new "
            "folder"
        )


def _checksum(content: bytes) -> str:
    return hashlib.sha256(content).hexdigest()
