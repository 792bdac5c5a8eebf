"""A cell's result as a row of the results file, and back.

Numbers are in SI units at full precision. What has no fixed shape is strict JSON. All arrays of a
cell are one blob of float64 in little-endian order; the column `arrays` has their names and shapes.
"""

from __future__ import annotations

import hashlib
import json
import math
import sqlite3
from collections.abc import Mapping, Sequence
from dataclasses import fields
from typing import Any

import numpy as np
import orjson

from stiff_protocols.contract.errors import DataError
from stiff_protocols.contract.record import Cell, CellResult, Cost, Presentation
from stiff_protocols.contract.types import BOUND_NAMES, TRUTH, FloatArray, Interval, Prediction

_NAMES = ("model", "dataset", "protocol")
"""In the file these are names with options; the columns `model_key` ... have only keys."""
_OF_CELL = tuple(item.name for item in fields(Cell) if item.name not in _NAMES)
_OF_RESULT = ("run_id", "status", "n_splits", "n_train", "calibration_samples", "cause", "failure")
_PRESENTATION_FIELDS = tuple(item.name for item in fields(Presentation) if item.name not in _NAMES)
_ABOUT = ("diagnostics", "warnings", "log", "chosen", "n_labels", "n_poses")
_JSON = (*(f"{name}_params" for name in _NAMES), "shown", "about", "arrays")
_KEYS = tuple(f"{name}_key" for name in _NAMES)
_COLUMNS = ("key", *_NAMES, *_KEYS, *_OF_CELL, *_OF_RESULT, *Cost._fields, *_JSON[-3:], "numbers")

_INTEGERS = ("split_index", "seed", "interval_version", "n_splits", "n_train")
_REALS = ("coverage", "fit_s", "predict_s", "latency_s", "throughput_per_s")
COLUMN_TYPES = dict.fromkeys(_COLUMNS, "TEXT") | {
    **dict.fromkeys((*_INTEGERS, "calibration_samples", "memory_bytes"), "INTEGER"),
    **dict.fromkeys(_REALS, "REAL"),
    "numbers": "BLOB",
}
"""Column of a cell -> SQLite's type, in the order of the table; its checksum follows."""

_CURVE = "curve "
"""How the names of the arrays of training curves begin."""
_FLOAT = np.dtype("<f8")


def cell_row(result: CellResult) -> dict[str, Any]:
    """Return column -> what is stored of a result."""
    cell, arrays = result.cell, _arrays(result)
    row: dict[str, Any] = {"key": cell.key}
    row |= {name: getattr(result.presentation, name) for name in _NAMES}
    row |= {f"{name}_key": getattr(cell, name) for name in _NAMES}
    row |= {name: getattr(cell, name) for name in _OF_CELL}
    row |= {name: getattr(result, name) for name in _OF_RESULT}
    row |= {name: getattr(result.cost, name, None) for name in Cost._fields}
    row["shown"] = {name: getattr(result.presentation, name) for name in _PRESENTATION_FIELDS}
    row["about"] = {name: getattr(result, name) for name in _ABOUT}
    # JSON has no infinity (a rigid joint) and no NaN (one that cannot be identified)
    row["about"]["diagnostics"] = {
        name: value if math.isfinite(value) else str(value)
        for name, value in result.diagnostics.items()
    }
    row["arrays"] = {name: array.shape for name, array in arrays.items()}
    row["numbers"] = b"".join(array.astype(_FLOAT).tobytes() for array in arrays.values())
    row |= {name: json_text(row[name]) for name in _JSON}
    return {name: _as_stored(row[name], kind) for name, kind in COLUMN_TYPES.items()}


def _as_stored(value: Any, kind: str) -> Any:
    """Return a value as it comes back from a column of this type."""
    if value is None or kind == "BLOB":
        return value
    return storable(value) if kind == "TEXT" else {"REAL": float, "INTEGER": int}[kind](value)


def cell_result(row: Mapping[str, Any]) -> CellResult:
    """Return the result that was stored as this row."""
    row = {**row, **{name: orjson.loads(row[name]) for name in _JSON}}
    about, labels, arrays = row["about"], row["shown"], _arrays_in(row["arrays"], row["numbers"])
    about["diagnostics"] = {name: float(value) for name, value in about["diagnostics"].items()}
    about |= {name: tuple(about[name]) for name in ("warnings", "log")}
    labels["caveats"] = tuple(labels["caveats"])
    cost = [row[name] for name in Cost._fields]
    curves = {name: arrays.pop(name) for name in [*arrays] if name.startswith(_CURVE)}
    keys = {name: row[f"{name}_key"] for name in _NAMES}
    return CellResult(
        cell=Cell(**keys, **{name: row[name] for name in _OF_CELL}),
        presentation=Presentation(**{name: row[name] for name in _NAMES}, **labels),
        **{name: row[name] for name in _OF_RESULT},
        **about,
        prediction=_prediction(arrays, row["coverage"]) if arrays else None,
        cost=None if cost[0] is None else Cost(*cost),
        curves={name.removeprefix(_CURVE): curve for name, curve in curves.items()},
    )


def _arrays(result: CellResult) -> dict[str, FloatArray]:
    """Return name -> array: of the prediction, (n,) row numbers and (n, 3) m each; the curves."""
    arrays: dict[str, FloatArray] = {}
    if (prediction := result.prediction) is not None:
        arrays |= {"rows": prediction.rows.astype(_FLOAT), "predicted": prediction.predicted}
        arrays |= {"measured": prediction.measured, **prediction.bound_deflections}
        if prediction.reference is not None:
            arrays["reference"] = prediction.reference
        if prediction.interval is not None:  # its coverage is the cell's
            arrays |= {"lower": prediction.interval.lower, "upper": prediction.interval.upper}
    return arrays | {f"{_CURVE}{name}": curve for name, curve in result.curves.items()}


def _arrays_in(shapes: Mapping[str, Sequence[int]], numbers: bytes) -> dict[str, FloatArray]:
    arrays, start = {}, 0
    for name, shape in shapes.items():
        arrays[name] = np.ndarray(shape, _FLOAT, numbers, start)
        start += arrays[name].nbytes
    return arrays


def _prediction(arrays: Mapping[str, FloatArray], coverage: float | None) -> Prediction:
    interval = None
    if "lower" in arrays and coverage is not None:
        interval = Interval(arrays["lower"], arrays["upper"], coverage)
    return Prediction.of_stored(
        rows=arrays["rows"].astype(np.int64),
        predicted=arrays["predicted"],
        measured=arrays["measured"],
        interval=interval,
        reference=arrays.get("reference"),
        bound_deflections={name: arrays[name] for name in (*BOUND_NAMES, TRUTH) if name in arrays},
    )


def write_row(db: sqlite3.Connection, result: CellResult) -> None:
    """Replace what is stored of a cell; a failure does not replace a result."""
    row = cell_row(result)
    there = db.execute("SELECT status FROM cell WHERE key = ?", (row["key"],)).fetchone()
    if there == ("ok",) and result.status != "ok":
        return
    values = [*row.values(), checksum([*row.values()])]
    db.execute(f"INSERT OR REPLACE INTO cell VALUES {marks(values)}", values)


def read_row(values: Sequence[Any]) -> CellResult:
    """Return the result in a row of the table `cell`.

    Raises:
        DataError: it is not what was stored.
    """
    *content, sha256 = values
    try:
        if checksum(content) != sha256:
            raise DataError("its checksum does not match its content")
    except TypeError as error:  # bytes for a text
        raise DataError(str(error)) from error
    return cell_result(dict(zip(COLUMN_TYPES, content, strict=True)))


def checksum(values: Sequence[Any]) -> str:
    """Return the SHA-256 of a cell's columns, of which the last are bytes."""
    return hashlib.sha256(orjson.dumps(values[:-1]) + b"\0" + values[-1]).hexdigest()


def json_text(content: Any) -> str:
    """Return strict JSON that is `storable`."""
    return storable(json.dumps(content, ensure_ascii=False, allow_nan=False, separators=(",", ":")))


def storable(text: str) -> str:
    """Return a text with question marks for invalid characters, as in some file names."""
    return text if text.isascii() else text.encode(errors="replace").decode()


def marks(entries: Sequence[object]) -> str:
    """Return "(?, ?)": a place in a statement for each entry."""
    return f"({', '.join('?' * len(entries))})"
