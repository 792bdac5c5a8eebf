"""Packs: many cells' results in one Parquet file, which is soon read.

::

    OUTPUT/packs/<number>-<sha256>.parquet   the higher the number, the newer

One row a result, the same content as in a cell's own file: a column for each field of the cell
(dictionary encoded, to be looked at with any Parquet reader), metric values and predictions as
lists of doubles, the rest as JSON text. Names, axes and units of the metric values are one text
(`measures`), since rows share it. The file's name holds the hash of its bytes, so that
damage anywhere is found before it is read.
"""

from __future__ import annotations

import hashlib
import io
import re
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, fields
from pathlib import Path
from typing import Any

import orjson
import pyarrow as pa
import pyarrow.parquet as pq

from stiff_bench.cell_content import cell_content, cell_result
from stiff_bench.checked_json import DamagedFile, json_text, refuse_other_format
from stiff_protocols.errors import DataError, StoreError
from stiff_protocols.files import read_plain, written_whole
from stiff_protocols.record import SCHEMA, Cell, CellResult

CELLS_A_PACK, BYTES_A_PACK = 5000, 2**26
"""At most, counted in cells and bytes of their files, so that a pack takes little memory."""

_HASH_LENGTH = 32
_NAME = re.compile(rf"(\d{{6,}})-[0-9a-f]{{{_HASH_LENGTH}}}\.parquet", re.ASCII)
_TEXTS = ("run_id", "status", "failure", "cause")
_COUNTS = ("calibration_samples", "n_train", "n_splits")
_JSON = ("shown", "cost", "diagnostics", "warnings", "log", "chosen", "curves")
_VECTORS = ("predicted_m", "measured_m", "reference_m", "lower_m", "upper_m")
_OPTIONS = ("model_params", "dataset_params", "protocol_params")
_CELL = tuple(item.name for item in fields(Cell))
_NUMBERS_OF_CELL: dict[str, pa.DataType] = {
    "split_index": pa.int64(),
    "seed": pa.int64(),
    "coverage": pa.float64(),
}
_COLUMNS: dict[str, pa.DataType] = {
    "key": pa.string(),
    **{name: _NUMBERS_OF_CELL.get(name, pa.string()) for name in _CELL},
    **dict.fromkeys((*_TEXTS, *_JSON), pa.string()),
    **dict.fromkeys(_COUNTS, pa.int64()),
    "measures": pa.string(),
    "values": pa.list_(pa.float64()),
    "rows": pa.list_(pa.int64()),
    **dict.fromkeys(_VECTORS, pa.list_(pa.float64())),
}
_PLAIN = {"key", "values", "rows", "curves", *_VECTORS}
"""Columns of which every row is another's: no dictionary makes them smaller."""


def write_pack(folder: Path, results: Sequence[CellResult]) -> Path:
    """Write results as the newest pack of a folder; whoever may pack it at once must be kept out.

    Args:
        folder: of the results.
        results: of each key at most one that is ok and one that is not.

    Raises:
        StoreError: it cannot be written.
    """
    rows = [_row(result) for result in results]
    file = io.BytesIO()
    pq.write_table(
        pa.Table.from_pylist(rows, schema=pa.schema(_COLUMNS, {"schema": str(SCHEMA)})),
        file,
        compression="zstd",
        use_dictionary=[*(_COLUMNS.keys() - _PLAIN)],  # type: ignore[arg-type] # is bool in its stub
        write_statistics=False,
    )
    content = file.getvalue()
    number = 1 + max(_numbered(folder).values(), default=0)
    path = folder / "packs" / f"{number:06d}-{_hash(content)}.parquet"
    with written_whole(path) as temporary:
        temporary.write_bytes(content)
    return path


def pack_files(folder: Path) -> list[Path]:
    """Return the packs of a folder of results, the newest first; other files there are none."""
    numbers = _numbered(folder)
    return sorted(numbers, key=lambda path: (numbers[path], path.name), reverse=True)


def _numbered(folder: Path) -> dict[Path, int]:
    """Return the packs of a folder of results with their numbers."""
    names = ((path, _NAME.fullmatch(path.name)) for path in (folder / "packs").glob("*"))
    return {path: int(name[1]) for path, name in names if name}


@dataclass(frozen=True)
class Pack:
    """A pack whose bytes are as they were written.

    Attributes:
        path: of it.
        file: its content.
        keys: (n,) of its results' cells.
        ok: (n,) whether a result succeeded.
    """

    path: Path
    file: pq.ParquetFile
    keys: Sequence[str]
    ok: Sequence[bool]

    def results(self, rows: Sequence[int]) -> Iterator[CellResult]:
        """Yield the results of some rows.

        Raises:
            DamagedFile: a row holds no result.
        """
        table = self.file.read(use_threads=False)
        if len(rows) < len(table):
            table = table.take(pa.array(rows, pa.int64()))
        try:
            for key, content in _contents(table):
                result = cell_result(content)
                if result.cell.key != key:
                    raise DataError(f"the cell {result.cell.key} stands under the key {key}")
                yield result
        except (KeyError, TypeError, AttributeError, ValueError, DataError) as error:
            raise DamagedFile(self.path, f"{type(error).__name__}: {error}") from error


def read_pack(path: Path) -> Pack:
    """Check a pack and read which cells it holds.

    Raises:
        DamagedFile: it is damaged.
        StoreError: it cannot be read, or is of another format.
    """
    try:
        content = read_plain(path)
    except OSError as error:
        raise StoreError(f"{path}: cannot be read: {error.strerror or error}") from error
    if path.stem.partition("-")[2] != _hash(content):
        raise DamagedFile(path, "the checksum in its name does not match its content")
    try:
        file = pq.ParquetFile(pa.BufferReader(content))
        schema = (file.schema_arrow.metadata or {}).get(b"schema", b"").decode()
        refuse_other_format(path, int(schema) if schema.isdecimal() else schema)
        index = file.read(columns=["key", "status"], use_threads=False)
        keys = [str(key) for key in index["key"].to_pylist()]
        ok = [status == "ok" for status in index["status"].to_pylist()]
    except (pa.ArrowException, KeyError, OSError, ValueError) as error:
        raise DamagedFile(path, str(error)) from error
    return Pack(path, file, keys, ok)


def _row(result: CellResult) -> dict[str, Any]:
    content = cell_content(result)
    cell, prediction = content["cell"], content["prediction"] or {}
    arrays = {name: array.ravel() for name, array in prediction.items()}
    plain = {name: content[name] for name in (*_TEXTS, *_COUNTS)}
    row = {"key": result.cell.key, **cell, **plain, **arrays}
    row |= {name: json_text(cell[name]) for name in _OPTIONS}
    row |= {name: json_text(content[name]) for name in _JSON}
    metrics, axes, values, units = zip(*result.records, strict=True) if result.records else [()] * 4
    return row | {"measures": json_text([metrics, axes, units]), "values": values}


def _contents(table: pa.Table) -> Iterator[tuple[str, Mapping[str, Any]]]:
    """Yield each row's key and its content as `cell_content` returned it."""
    columns = {name: _column(name, table[name].combine_chunks()) for name in table.column_names}
    in_cell = [name for name in _CELL if name in columns]
    beside = [name for name in (*_TEXTS, *_COUNTS, *_JSON) if name in columns]
    of_prediction = [name for name in ("rows", *_VECTORS) if name in columns]
    for index, key in enumerate(columns["key"]):
        prediction = {
            name: found for name in of_prediction if (found := columns[name][index]) is not None
        }
        values = columns["values"][index].tolist()
        content = {name: columns[name][index] for name in beside}
        content["cell"] = {name: columns[name][index] for name in in_cell}
        content["prediction"] = prediction or None
        metrics, axes, units = columns["measures"][index]
        content["records"] = zip(metrics, axes, values, units, strict=True)
        yield key, content


def _column(name: str, column: pa.Array[Any]) -> Sequence[Any]:
    """Return a column's entries; what many rows share is one object."""
    if isinstance(column, pa.ListArray):
        return _arrays(column, width=3 if name in _VECTORS else None)
    entries: list[Any] = column.to_pylist()
    if name in (*_JSON, *_OPTIONS, "measures"):
        known = {text: orjson.loads(text) for text in set(entries)}
        return [known[text] for text in entries]
    return entries


def _arrays(column: pa.ListArray[Any], width: int | None) -> list[Any]:
    """Return each row's list as an array, (n,) or (n, width); None where there is none."""
    flat = column.values.to_numpy()
    ends = column.offsets.to_numpy()
    pairs = zip(ends[:-1].tolist(), ends[1:].tolist(), column.is_valid().to_pylist(), strict=True)
    arrays = [flat[start:end] if valid else None for start, end, valid in pairs]
    if width is None:
        return arrays
    return [None if array is None else array.reshape(-1, width) for array in arrays]


def _hash(content: bytes) -> str:
    return hashlib.sha256(content).hexdigest()[:_HASH_LENGTH]
