"""Files of several parts, taken apart and sealed again: damage that gets past checksums."""

from __future__ import annotations

import hashlib
import io
import json
from random import Random
from typing import Any

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
import safetensors.numpy
from fuzz.mutations import JSON_NONSENSE, NONSENSE, bytes_damaged, tree_damaged

from stiff_models.saved import _digest
from stiff_protocols.record import SCHEMA

DTYPES = ("f8", "f4", "f2", "i8", "u1", "b1", "c16", "U3", "S2", "M8[s]", ">f8")


def record_damaged(data: bytes, rng: Random) -> bytes:
    """Damage a stored record below its checksum, seldom in the part that its name hashes."""
    if rng.random() < 0.3:
        return bytes_damaged(data, rng)
    content = json.loads(data)["content"]
    kept = {} if "cell" not in content or rng.random() < 0.2 else {"cell": content["cell"]}
    return record_sealed(tree_damaged(content, rng) | kept if kept else tree_damaged(content, rng))


def record_sealed(content: Any) -> bytes:
    """Return a stored record with the right checksum."""
    text = json.dumps(content, separators=(",", ":")).encode()
    head = f'{{"schema":{SCHEMA},"sha256":"{hashlib.sha256(text).hexdigest()}","content":'
    return head.encode() + text + b"}\n"


def npz_damaged(data: bytes, rng: Random) -> bytes:
    """Damage the arrays of an npz file, or its bytes."""
    if rng.random() < 0.4:
        return bytes_damaged(data, rng)
    with np.load(io.BytesIO(data)) as found:
        arrays = dict(found)
    for name in rng.sample(sorted(arrays), rng.randint(1, 3)):
        arrays[name] = array_damaged(arrays[name], rng)
        if rng.random() < 0.1:
            del arrays[name]
    file = io.BytesIO()
    np.savez_compressed(file, **arrays)
    return file.getvalue()


def array_damaged(array: Any, rng: Random) -> Any:
    """Return an array of another type, shape or content."""
    match rng.randrange(6):
        case 0:
            raw = np.resize(np.frombuffer(array.tobytes(), np.uint8), 16 * max(array.size, 1))
            dtype = np.dtype(rng.choice(DTYPES))
            return raw[: len(raw) // dtype.itemsize * dtype.itemsize].view(dtype)
        case 1:
            return array.reshape(-1)
        case 2:
            return array[: rng.randrange(3)] if array.ndim else array.reshape(1)
        case 3:
            return np.resize(array, rng.choice([(0,), (1, 1), (2, 3, 4), (0, 3), ()]))
        case 4:
            return np.array([rng.choice(NONSENSE)[:9] or "x"])
        case _:
            damaged = np.array(array)
            if damaged.size and damaged.dtype.kind == "f":
                damaged.flat[rng.randrange(damaged.size)] = rng.choice((np.nan, np.inf, -1.0))
            return damaged


def parquet_damaged(data: bytes, rng: Random) -> bytes:
    """Damage columns of a Parquet table, or its bytes."""
    if rng.random() < 0.5:
        return bytes_damaged(data, rng)
    table = pq.read_table(io.BytesIO(data))
    for _ in range(rng.randint(1, 2)):
        at = rng.randrange(table.num_columns)
        name = rng.choice((table.column_names[at], rng.choice(table.column_names), "", "é\x00"))
        column = _column_damaged(table.column(at).to_pylist(), rng)
        if rng.random() < 0.1:
            table = table.append_column(name, column)
        else:
            table = table.set_column(at, name, column)
    if rng.random() < 0.1:
        table = table.remove_column(rng.randrange(table.num_columns))
    file = io.BytesIO()
    pq.write_table(table, file)
    return file.getvalue()


def _column_damaged(values: list[Any], rng: Random) -> pa.Array:
    n = len(values)
    fills = (None, float("nan"), 1e308, 2**63 - 1, True, "x", b"\xff", [1.0], {"a": 1}, *NONSENSE)
    match rng.randrange(4):
        case 0:
            return pa.array([rng.choice(fills)] * n)
        case 1:
            return pa.array([str(value) for value in values])
        case 2:
            values[rng.randrange(n)] = None
            return pa.array(values)
        case _:
            kind = rng.choice((pa.timestamp("s"), pa.uint64(), pa.date32(), pa.duration("ns")))
            return pa.array(range(n), pa.int64() if kind != pa.date32() else pa.int32()).cast(kind)


def model_damaged(data: bytes, rng: Random) -> bytes:
    """Damage a model file: its structure or its arrays with the right checksum, or its bytes."""
    if rng.random() < 0.2:
        return bytes_damaged(data, rng)
    head, arrays = model_opened(data)
    if rng.random() < 0.75:
        head["model"] = tree_damaged(head["model"], rng)
    elif rng.random() < 0.1:
        head[rng.choice(("format", "model", "stiffbench"))] = rng.choice(JSON_NONSENSE)
    else:
        name = rng.choice(sorted(arrays))
        if arrays[name].dtype == np.uint8:  # an archive
            raw = bytes_damaged(arrays[name].tobytes(), rng)
            arrays[name] = np.frombuffer(raw, np.uint8)
        else:
            damaged = array_damaged(arrays[name], rng)
            arrays[name] = damaged if damaged.dtype.kind in "fiub" else arrays[name].ravel()
            arrays[name] = np.ascontiguousarray(
                arrays[name].astype(arrays[name].dtype.newbyteorder("="))
            )
    return model_sealed(head, arrays)


def model_opened(data: bytes) -> tuple[Any, dict[str, Any]]:
    """Return the head and the arrays of a model file."""
    size = int.from_bytes(data[:8], "little")
    metadata = json.loads(data[8 : 8 + size])["__metadata__"]
    return json.loads(metadata["stiffbench_model"]), safetensors.numpy.load(data)


def model_sealed(head: Any, arrays: dict[str, Any]) -> bytes:
    """Return a model file with the right checksum."""
    text = json.dumps(head)
    metadata = {"stiffbench_model": text, "sha256": _digest(text, arrays)}
    return safetensors.numpy.save(arrays, metadata)
