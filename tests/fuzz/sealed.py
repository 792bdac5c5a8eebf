"""Damage parts of a file and seal it again, so that the damage passes checksums."""

from __future__ import annotations

import io
import json
from random import Random
from typing import Any

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
from fuzz.mutations import NONSENSE, damage_bytes, damage_tree

from helpers.model_files import archived, members

DTYPES = ("f8", "f4", "f2", "i8", "u1", "b1", "c16", "U3", "S2", "M8[s]", ">f8")


def damage_array(array: Any, rng: Random) -> Any:
    """Return an array of another type, shape or content."""
    raw = np.resize(np.frombuffer(array.tobytes(), np.uint8), 16 * max(array.size, 1))
    dtype = np.dtype(rng.choice(DTYPES))
    array_with_gap = np.array(array)
    if array_with_gap.size and array_with_gap.dtype.kind == "f":
        array_with_gap.flat[rng.randrange(array_with_gap.size)] = rng.choice((np.nan, np.inf, -1.0))
    damaged_arrays = (
        raw[: len(raw) // dtype.itemsize * dtype.itemsize].view(dtype),
        array.reshape(-1),
        array[: rng.randrange(3)] if array.ndim else array.reshape(1),
        np.resize(array, rng.choice([(0,), (1, 1), (2, 3, 4), (0, 3), ()])),
        np.array([rng.choice(NONSENSE)[:9] or "x"]),
        array_with_gap,
    )
    return rng.choice(damaged_arrays)


def damage_parquet(data: bytes, rng: Random) -> bytes:
    """Replace a column of a Parquet table, or damage the file's bytes."""
    if rng.random() < 0.5:
        return damage_bytes(data, rng)
    table = pq.read_table(io.BytesIO(data))
    index, n = rng.randrange(table.num_columns), len(table)
    fills = (None, float("nan"), 1e308, 2**63 - 1, True, b"\xff", [1.0], {"a": 1}, *NONSENSE)
    column = [
        pa.array([rng.choice(fills)] * n),
        pa.array([None, *table.column(index).to_pylist()[1:]]),
        pa.array(range(n)).cast(rng.choice((pa.timestamp("s"), pa.uint64(), pa.duration("ns")))),
    ]
    name = rng.choice((table.column_names[index], rng.choice(table.column_names), "", "é\x00"))
    table = table.set_column(index, name, rng.choice(column))
    if rng.random() < 0.1:
        table = table.remove_column(rng.randrange(table.num_columns))
    file = io.BytesIO()
    pq.write_table(table, file)
    return file.getvalue()


def damage_model(data: bytes, rng: Random) -> bytes:
    """Damage a model file's bytes, or its structure or an array with valid checksums."""
    if rng.random() < 0.2:
        return damage_bytes(data, rng)
    parts = members(data)
    if rng.random() < 0.6:
        schema = json.loads(parts["schema.json"])
        # the model, more often than the whole: most damage of skops' own nodes is refused alike
        tree = schema if rng.random() < 0.3 else schema["content"]["model"]["content"]
        name = rng.choice(sorted(key for key in tree if isinstance(tree[key], dict)))
        tree[name] = damage_tree(tree[name], rng)
        parts["schema.json"] = json.dumps(schema).encode()
    else:
        name = rng.choice(sorted(set(parts) - {"schema.json"}))
        file = io.BytesIO()
        np.save(file, damage_array(np.load(io.BytesIO(parts[name])), rng))
        parts[name] = damage_bytes(parts[name], rng) if rng.random() < 0.2 else file.getvalue()
    return archived(parts)
