"""Write records as files: JSON lines, CSV or Parquet."""

from __future__ import annotations

import json
from collections.abc import Sequence
from pathlib import Path
from typing import Any, Literal

from stiff_bench.submissions.record import Record
from stiff_protocols.contract.extras import require
from stiff_protocols.contract.files import written_whole

ExportFormat = Literal["jsonl", "csv", "parquet"]
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
        if fmt == "jsonl":
            lines = [f"{record.model_dump_json()}\n" for record in records]
            temporary.write_text("".join(lines), encoding="utf-8")
            return
        from pandas import DataFrame  # 0.5 s

        as_json = (dict, list) if fmt == "csv" else (dict,)
        frame = DataFrame([_columns(record, as_json) for record in records], dtype=object)
        if fmt == "csv":
            frame.to_csv(temporary, index=False, lineterminator="\r\n")
        else:
            frame.to_parquet(temporary, index=False)


def _columns(record: Record, as_json: tuple[type, ...]) -> dict[str, Any]:
    """Return the columns of a record; values of the types `as_json` are JSON."""
    columns: dict[str, Any] = {}
    for name, value in record.model_dump(mode="json").items():
        if name in SPREAD:
            columns |= value or {}
        else:
            columns[name] = json.dumps(value) if isinstance(value, as_json) else value
    return columns
