"""Write records as files: JSON lines, CSV or Parquet."""

from __future__ import annotations

import csv
import json
from collections.abc import Callable, Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any, Literal, get_args

from stiff_bench.submissions.record import Record
from stiff_protocols.contract.extras import require
from stiff_protocols.contract.files import written_whole

ExportFormat = Literal["jsonl", "csv", "parquet"]
FORMATS: tuple[str, ...] = get_args(ExportFormat)
SPREAD = ("metrics", "cost")
"""Fields whose entries become columns."""


def export_records(records: Sequence[Record], path: Path, fmt: ExportFormat) -> None:
    """Write one record per fit; an existing file is replaced.

    In CSV and Parquet each metric is a column. CSV has lists and options as JSON, Parquet has
    options as JSON.

    Raises:
        ConfigError: the package for Parquet is not installed.
        StoreError: the file cannot be written.
    """
    if fmt == "parquet":
        require("--format parquet", "pyarrow")
    with written_whole(path) as temporary:
        _WRITERS[fmt](records, temporary)


def _write_jsonl(records: Sequence[Record], path: Path) -> None:
    with path.open("w", encoding="utf-8") as file:
        file.writelines(f"{record.model_dump_json()}\n" for record in records)


def _write_csv(records: Sequence[Record], path: Path) -> None:
    rows = [
        {
            name: json.dumps(value) if isinstance(value, list) else value
            for name, value in _flat(record).items()
        }
        for record in records
    ]
    with path.open("w", encoding="utf-8", newline="") as file:
        writer = csv.DictWriter(file, _columns(rows))
        writer.writeheader()
        writer.writerows(rows)


def _write_parquet(records: Sequence[Record], path: Path) -> None:
    import pyarrow
    from pyarrow import parquet

    rows = [_flat(record) for record in records]
    columns = {name: [row.get(name) for row in rows] for name in _columns(rows)}
    parquet.write_table(pyarrow.table(columns), path)


_WRITERS: dict[str, Callable[[Sequence[Record], Path], None]] = {
    "jsonl": _write_jsonl,
    "csv": _write_csv,
    "parquet": _write_parquet,
}


def _flat(record: Record) -> dict[str, Any]:
    """Return the columns of a record."""
    return dict(_entries(record.model_dump(mode="json")))


def _entries(fields: Mapping[str, Any]) -> Iterator[tuple[str, Any]]:
    for name, value in fields.items():
        if name in SPREAD:
            yield from (value or {}).items()
        else:
            yield name, json.dumps(value) if isinstance(value, dict) else value


def _columns(rows: Sequence[Mapping[str, Any]]) -> list[str]:
    """Return the names of all columns, in the order of their appearance."""
    return list(dict.fromkeys(name for row in rows for name in row)) or list(Record.model_fields)
